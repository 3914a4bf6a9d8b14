"""The account of a decoded log: the fate of every frame and signal, in words and as a JSON object."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.database.addressing import NOBODY, parameter_group, why_wrong
from canlog.decode.codec import HAS_VALUES, Codec, FrameFate, MessageTable, MessageValues
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs import LogCounts
from canlog.logs.log_counts import assumed_texts, lost_texts, odd_texts
from canlog.tables.layouts import BARE_ID, Place, TableNames, flagged_id, identifier_text

MAX_IDS: Final = 65_536  # that are counted one by one: no bus has as many, a log of noise has
NEAREST_COUNT: Final = 3
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
    remark: str  # why it is not that message; empty if unknown


@dataclass(slots=True, kw_only=True)
class DecodeAccount:
    """The running account; ``frames`` of every fate add up to the frames of the log."""

    codec: Codec
    names: TableNames
    log: LogCounts = field(default_factory=LogCounts)
    row_count: int = 0
    counts: Int64Array = field(init=False)  # (messages + 1, fates)
    signals: defaultdict[Place, SignalCounts] = field(default_factory=lambda: defaultdict(SignalCounts))
    frames_of_id: Counter[int] = field(default_factory=Counter)  # data frames by identifier with its flags
    unlisted_count: int = 0  # data frames whose identifiers came when there were too many to be listed

    def __post_init__(self) -> None:
        self.counts = np.zeros((len(self.codec.tables) + 1, len(FrameFate)), np.int64)

    def decode(self, batch: FrameBatch) -> list[MessageValues]:
        """Return the signals of some frames, message by message; frames and values enter the account."""
        match = self.codec.match(batch)
        self.counts += match.counts
        self._count_ids(batch)
        messages = list(self.codec.decode(batch, match))
        for message in messages:
            for name, decoded in message.signals.items():
                counts, present = self.signals[message.slot, name], decoded.is_present
                counts.values += len(message.rows) if present is None else int(np.count_nonzero(present))
                counts.out_of_range += decoded.invalid.out_of_range
                counts.not_a_number += decoded.invalid.not_available
            for name, count in message.cut_off.items():
                self.signals[message.slot, name].cut_off += count
        return messages

    def _count_ids(self, batch: FrameBatch) -> None:
        can_ids, counts = np.unique(batch.can_id[(batch.can_id & _NO_DATA) == 0], return_counts=True)
        slots = self.codec.slots_of(can_ids.tolist())
        for can_id, count, slot in zip(can_ids.tolist(), counts.tolist(), slots, strict=True):
            if can_id in self.frames_of_id or len(self.frames_of_id) < MAX_IDS or slot != NOBODY:
                self.frames_of_id[can_id] += count
            else:
                self.unlisted_count += count

    def leave_out(self, count: int) -> None:
        self.counts[-1, FrameFate.LEFT_OUT] += count

    @property
    def fates(self) -> dict[FrameFate, int]:
        return dict(zip(FrameFate, self.counts.sum(axis=0).tolist(), strict=True))

    @property
    def present_slots(self) -> list[int]:
        """The messages that came, in the order of the database."""
        return np.flatnonzero(self.counts[:-1].any(axis=1)).tolist()

    @property
    def refused(self) -> dict[str, str]:
        """Why signals of messages that came cannot be decoded, by their names."""
        reasons: dict[str, str] = {}
        for slot in self.present_slots:
            table = self.codec.tables[slot]
            reasons |= {f"{self.names.messages[slot]}.{name}": why for name, why in table.refused.items()}
        return reasons

    @property
    def transported(self) -> dict[str, tuple[int, int]]:
        """Messages that no frame holds: their bytes, and how many frames came."""
        return {
            self.names.messages[slot]: (self.codec.tables[slot].message.length, count)
            for slot in self.present_slots
            if (count := int(self.counts[slot, FrameFate.TRANSPORTED]))
        }

    @property
    def overwritten(self) -> list[tuple[str, str]]:
        """Messages that came, but gave way to a later one of the same identifier."""
        slot_of = {id(self.codec.tables[slot].message): slot for slot in self.present_slots}
        return [
            (old.name, self.names.messages[slot_of[id(new)]])
            for old, new in self.codec.overwritten
            if id(new) in slot_of
        ]

    @property
    def unknown_ids(self) -> list[tuple[int, int]]:
        """Identifiers of no message, with flags, and how often they came; the most frequent first."""
        slots = self.codec.slots_of([*self.frames_of_id])
        unknown = [item for item, slot in zip(self.frames_of_id.items(), slots, strict=True) if slot == NOBODY]
        return sorted(unknown, key=lambda item: (-item[1], item[0]))

    @property
    def of_group_count(self) -> int:
        """How many frames would be of a message by their group; 0 if identifiers of 29 bits fit as they are."""
        long = [can_id for can_id in self.frames_of_id if can_id & EXTENDED_FLAG]
        if (self.codec.slots_of(long) != NOBODY).any():
            return 0
        messages = [table.message for table in self.codec.tables if table.message.is_extended_frame]
        groups = {parameter_group(message.frame_id) for message in messages} - TESTER_GROUPS
        return sum(self.frames_of_id[can_id] for can_id in long if parameter_group(can_id & BARE_ID) in groups)

    @property
    def known_count(self) -> int:
        """How many identifiers of the log are of messages of the database."""
        return int(np.count_nonzero(self.codec.slots_of([*self.frames_of_id]) != NOBODY))

    @property
    def why_wrong(self) -> str:
        """Why the database is probably that of another bus; empty if it may be the right one."""
        messages = {self.names.messages[slot] for slot in self.present_slots}
        return why_wrong(self.known_count, len(self.frames_of_id), len(messages), len(self.codec.tables))

    @property
    def knows_nothing(self) -> bool:
        """Whether there are data frames, and none is of the database."""
        return bool(self.frames_of_id) and not self.known_count

    def nearest(self) -> list[Nearest]:
        """Return the most frequent unknown identifiers, each with the message that comes nearest."""
        tables = self.codec.tables
        return [_nearest(can_id, tables, self.names) for can_id, _ in self.unknown_ids[:NEAREST_COUNT] if tables]


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


JsonObject = dict[str, object]

SCHEMA: Final = "clutchdiag/decode/v1"
SHOWN_COUNT: Final = 8  # of a list for people; a program gets all


def losses(account: DecodeAccount) -> Iterator[str]:
    """Yield for people what of the log is not in the table though it should be."""
    yield from lost_texts(account.log)
    if account.knows_nothing:
        yield _why_nothing(account)
    if count := account.of_group_count:
        yield (
            f"{count} frames have the parameter group (PGN) of a message of the database, but another identifier: "
            "--match group decodes them"
        )
    if cut_off := sum(counts.cut_off for counts in account.signals.values()):
        short_count = account.fates[FrameFate.SHORT]
        yield f"{short_count} frames are shorter than the database says: {cut_off} values are not in them"
    if transported := account.transported:
        sizes = {f"{name} ({size} bytes)": frames for name, (size, frames) in transported.items()}
        yield (
            f"{sum(sizes.values())} frames are pieces of messages longer than a frame, which are not put together: "
            f"{listing(sizes)}"
        )
    if refused := list(account.refused.values()):
        more = f"; and {len(refused) - SHOWN_COUNT} more" if len(refused) > SHOWN_COUNT else ""
        yield f"{len(refused)} signals cannot be decoded: {'; '.join(refused[:SHOWN_COUNT])}{more}"
    for old, new in account.overwritten:
        yield f"message {old} has the identifier of {new}, by which its frames are decoded"


def _why_nothing(account: DecodeAccount) -> str:
    near = [
        f"{identifier_text(near.can_id)} of the log to {identifier_text(near.message_id)} {near.message}"
        + (f" ({near.remark})" if near.remark else "")
        for near in account.nearest()
    ]
    head = f"0 of {len(account.frames_of_id)} identifiers are in this database"
    return f"{head}; nearest: {'; '.join(near)}" if near else head


def remarks(account: DecodeAccount) -> Iterator[str]:
    """Yield for people what is no loss but unusual: assumptions, unknown identifiers, values out of range."""
    yield from assumed_texts(account.log)
    yield from odd_texts(account.log)
    short_count, unknown = account.fates[FrameFate.SHORT], account.unknown_ids
    if short_count and not any(counts.cut_off for counts in account.signals.values()):
        yield f"{short_count} frames are shorter than their message, but hold all its signals"
    if account.why_wrong and not account.knows_nothing:
        yield account.why_wrong
    if unknown and not account.knows_nothing:
        frames = {identifier_text(can_id): count for can_id, count in unknown}
        yield f"{len(unknown)} of {len(account.frames_of_id)} identifiers are not in the database: {listing(frames)}"
    if account.unlisted_count:
        yield f"{account.unlisted_count} frames have identifiers beyond the first {MAX_IDS}, not listed one by one"
    for attribute, text in (("out_of_range", "outside [min|max]"), ("not_a_number", "that are not numbers")):
        counts = {account.names.columns[place]: getattr(signal, attribute) for place, signal in account.signals.items()}
        counts = {name: count for name, count in counts.items() if count}
        if counts:
            yield f"{sum(counts.values())} values {text}, written as sent: " + listing(counts)


def listing(counts: Mapping[str, int]) -> str:
    """Return the largest counts by name, and how many more there are."""
    largest = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    parts = [f"{name} {count}" for name, count in largest[:SHOWN_COUNT]]
    return ", ".join(parts + ([f"and {len(largest) - SHOWN_COUNT} more"] if len(largest) > SHOWN_COUNT else []))


def frame_texts(account: DecodeAccount) -> Iterator[str]:
    """Yield what became of the frames, in words; only what occurred."""
    words = {
        FrameFate.DECODED: "decoded",
        FrameFate.SHORT: "decoded in part",
        FrameFate.TRANSPORTED: "pieces of longer messages",
        FrameFate.WITHOUT_SIGNALS: "of messages without signals",
        FrameFate.UNKNOWN: "not in the database",
        FrameFate.REMOTE: "remote frames",
        FrameFate.ERROR: "error frames",
        FrameFate.LEFT_OUT: "not asked for",
    }
    for fate, count in account.fates.items():
        if count or fate is FrameFate.DECODED:
            yield f"{count} {words[fate]}"


def values_text(account: DecodeAccount) -> str:
    """Return how many values there are, in words."""
    values = [counts.values for counts in account.signals.values() if counts.values]
    message_count = np.count_nonzero(account.counts[:-1, list(HAS_VALUES)].any(axis=1))
    return f"{sum(values)} values of {len(values)} signals in {message_count} messages"


def account_record(account: DecodeAccount) -> JsonObject:
    """Return the account; ``frames`` without ``read`` add up to ``read``."""
    log = account.log
    return {
        "schema": SCHEMA,
        "rows": account.row_count,
        "frames": {"read": log.frames, **{fate.name.lower(): count for fate, count in account.fates.items()}},
        "unreadable": {reason.value: count for reason, count in log.rejected.items()},
        "first_unreadable": log.first_rejected,
        "truncated": log.truncated,
        "unfinished": log.unfinished,
        "jumps_back": log.jumps_back,
        "jumps_ahead": log.jumps_ahead,
        "first_jump": log.first_jump,
        "repeated": log.repeated,
        "notes": list(log.notes),
        "identifiers": {
            "seen": len(account.frames_of_id),
            "known": account.known_count,
            "unlisted_frames": account.unlisted_count,
            "unknown": [{**_identifier(can_id), "frames": count} for can_id, count in account.unknown_ids],
            "nearest": [
                {**_identifier(near.can_id), "message": near.message, "message_id": identifier_text(near.message_id)}
                for near in (account.nearest() if account.knows_nothing else ())
            ],
        },
        "messages": [_message(account, slot) for slot in account.present_slots],
        "refused": account.refused,
        "overwritten": [{"message": old, "by": new} for old, new in account.overwritten],
        "losses": list(losses(account)),
    }


def _message(account: DecodeAccount, slot: int) -> JsonObject:
    """Return one message that came, with all of its signals that were looked for."""
    message = account.codec.tables[slot].message
    return {
        "message": account.names.messages[slot],
        "id": identifier_text(flagged_id(message)),
        "is_extended": message.is_extended_frame,
        "bytes": message.length,
        "frames": {fate.name.lower(): int(count) for fate in FrameFate if (count := account.counts[slot, fate])},
        "signals": {
            name: {"column": account.names.columns[slot, name], **asdict(account.signals[slot, name])}
            for name in account.codec.tables[slot].signals
            if (slot, name) in account.signals
        },
    }


def _identifier(can_id: int) -> JsonObject:
    return {"id": identifier_text(can_id), "is_extended": bool(can_id & EXTENDED_FLAG)}
