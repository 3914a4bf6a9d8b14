"""What became of a log that was decoded, to the frame."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.database.addressing import parameter_group
from canlog.decode.codec import HAS_VALUES, Codec, FrameFate, MessageTable, MessageValues
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from canlog.logs import LogCounts
from canlog.tables.long_rows import Stretch
from canlog.tables.names import BARE_ID, Place, TableNames, flagged_id
from canlog.transport import TransferCounts

MAX_IDS: Final = 65_536  # that are counted one by one: no bus has as many, a log of noise has
TESTER_GROUPS: Final = frozenset({0xDA00, 0xDB00})  # of ISO-TP, which is not J1939
_NO_DATA: Final = np.uint32(REMOTE_FLAG | ERROR_FLAG)


@dataclass(slots=True)
class SignalCounts:
    """What became of the values of one signal."""

    values: int = 0
    cut_off: int = 0  # behind the end of frames that are shorter than their message
    out_of_range: int = 0  # written, though outside [min|max]
    not_a_number: int = 0  # floats that are sent as NaN or infinite; written as they are


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """An identifier of a log, and the message of the database that comes nearest."""

    can_id: int  # with its flags
    message: str
    message_id: int  # likewise
    remark: str  # why it is not that message, if that can be told


@dataclass(slots=True, kw_only=True)
class DecodeAccount:
    """The running account; ``frames`` of every fate add up to the frames of the log."""

    codec: Codec
    names: TableNames
    log: LogCounts = field(default_factory=LogCounts)
    row_count: int = 0
    transfers: TransferCounts = field(default_factory=TransferCounts)  # messages longer than a frame
    long_counts: dict[int, int] = field(default_factory=dict)  # of these the ones with signals, by slot
    counts: Int64Array = field(init=False)  # (messages + 1, fates)
    signals: dict[Place, SignalCounts] = field(default_factory=dict)
    frames_of_id: Counter[int] = field(default_factory=Counter)  # data frames by identifier with its flags
    unlisted_count: int = 0  # data frames whose identifiers came when there were too many to be listed

    def __post_init__(self) -> None:
        self.counts = np.zeros((len(self.codec.tables) + 1, len(FrameFate)), np.int64)

    def add(self, stretch: Stretch) -> None:
        """Count the frames of a batch."""
        self.counts += stretch.match.counts
        sent = stretch.batch.can_id
        if stretch.long is not None:
            sent = np.delete(sent, stretch.long.rows)
        can_ids, counts = np.unique(sent[(sent & _NO_DATA) == 0], return_counts=True)
        for can_id, count in zip(can_ids.tolist(), counts.tolist(), strict=True):
            if can_id in self.frames_of_id or len(self.frames_of_id) < MAX_IDS or self.codec.knows(can_id):
                self.frames_of_id[can_id] += count
            else:
                self.unlisted_count += count

    def add_values(self, found: MessageValues) -> None:
        """Count the values of some frames of one message."""
        for name, decoded in found.signals.items():
            place = found.slot, name
            if (counts := self.signals.get(place)) is None:
                counts = self.signals[place] = SignalCounts()
            present = decoded.is_present
            counts.values += len(found.rows) if present is None else int(np.count_nonzero(present))
            counts.out_of_range += decoded.invalid.out_of_range
            counts.not_a_number += decoded.invalid.not_available
        for name, count in found.cut_off.items():
            self.of_signal(found.slot, name).cut_off += count

    def leave_out(self, count: int) -> None:
        """Count frames that were not asked for."""
        self.counts[-1, FrameFate.LEFT_OUT] += count

    def of_signal(self, slot: int, name: str) -> SignalCounts:
        """Return the counts of one signal, to be added to."""
        place = slot, name
        if place not in self.signals:
            self.signals[place] = SignalCounts()
        return self.signals[place]

    @property
    def fates(self) -> dict[FrameFate, int]:
        """What became of all frames."""
        total = self.counts.sum(axis=0).tolist()
        return {fate: total[fate] for fate in FrameFate}

    @property
    def is_balanced(self) -> bool:
        """Whether every frame is accounted for."""
        return sum(self.fates.values()) == self.log.frames

    def of_message(self, slot: int) -> dict[FrameFate, int]:
        return {fate: int(self.counts[slot, fate]) for fate in FrameFate if self.counts[slot, fate]}

    @property
    def seen_slots(self) -> list[int]:
        """The messages that came, in the order of the database."""
        return [slot for slot, row in enumerate(self.counts[:-1].tolist()) if any(row) or slot in self.long_counts]

    @property
    def valued_slots(self) -> list[int]:
        """The messages that have values, likewise."""
        counts = self.counts[:-1, list(HAS_VALUES)].sum(axis=1)
        return sorted({*np.flatnonzero(counts).tolist(), *self.long_counts})

    @property
    def refused(self) -> dict[str, str]:
        """Why signals of messages that came cannot be decoded; a message without any tells of each of its signals."""
        found: dict[str, str] = {}
        for slot in self.seen_slots:
            table = self.codec.tables[slot]
            found |= {f"{self.names.messages[slot]}.{name}": why for name, why in table.refused.items()}
        return found

    @property
    def transported(self) -> dict[str, tuple[int, int]]:
        """Messages that no frame holds and that no protocol put together: their bytes, and how many frames came."""
        return {
            self.names.messages[slot]: (self.codec.tables[slot].message.length, count)
            for slot in self.seen_slots
            if (count := int(self.counts[slot, FrameFate.TRANSPORTED])) and slot not in self.long_counts
        }

    @property
    def overwritten(self) -> list[tuple[str, str]]:
        """Messages that came, but gave way to a later one of the same identifier."""
        seen = {id(self.codec.tables[slot].message): slot for slot in self.seen_slots}
        return [
            (old.name, self.names.messages[seen[id(new)]]) for old, new in self.codec.overwritten if id(new) in seen
        ]

    @property
    def unknown_ids(self) -> list[tuple[int, int]]:
        """Identifiers of no message, with flags, and how often they came; the most frequent first."""
        unknown = [(can_id, count) for can_id, count in self.frames_of_id.items() if not self.codec.knows(can_id)]
        return sorted(unknown, key=lambda one: (-one[1], one[0]))

    @property
    def of_group_count(self) -> int:
        """How many frames would be of a message by their group; 0 if identifiers of 29 bits fit as they are."""
        long = {can_id for can_id in self.frames_of_id if can_id & EXTENDED_FLAG}
        if any(map(self.codec.knows, long)):
            return 0
        messages = [table.message for table in self.codec.tables if table.message.is_extended_frame]
        groups = {parameter_group(message.frame_id) for message in messages} - TESTER_GROUPS
        return sum(self.frames_of_id[can_id] for can_id in long if parameter_group(can_id & BARE_ID) in groups)

    @property
    def known_count(self) -> int:
        """How many identifiers of the log are of messages of the database."""
        return sum(self.codec.knows(can_id) for can_id in self.frames_of_id)

    def nearest(self, count: int = 3) -> list[Nearest]:
        """Return the most frequent unknown identifiers, each with the message that comes nearest."""
        tables = self.codec.tables
        return [_nearest(can_id, tables, self.names) for can_id, _ in self.unknown_ids[:count] if tables]


def _nearest(can_id: int, tables: tuple[MessageTable, ...], names: TableNames) -> Nearest:
    bare, is_extended = can_id & BARE_ID, bool(can_id & EXTENDED_FLAG)

    def distance(slot: int) -> tuple[int, int, int]:
        message = tables[slot].message
        is_same_kind = message.is_extended_frame == is_extended
        is_same_group = is_same_kind and is_extended and parameter_group(message.frame_id) == parameter_group(bare)
        rank = 0 if message.frame_id == bare or is_same_group else 1 if is_same_kind else 2
        return rank, abs(message.frame_id - bare), slot

    slot = min(range(len(tables)), key=distance)
    message = tables[slot].message
    remark = ""
    if distance(slot)[0] == 0:
        remark = (
            "the same J1939 parameter group, but the database does not call the message one of J1939"
            if message.is_extended_frame == is_extended
            else f"the same number, but the log's has {29 if is_extended else 11} bits"
        )
    return Nearest(can_id=can_id, message=names.messages[slot], message_id=flagged_id(message), remark=remark)
