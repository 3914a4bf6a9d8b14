"""Transports that carry messages longer than a frame: each put together, whichever protocol carried it; and counted."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from cantools.database import DecodeError
from cantools.database.can import Message

from canlog.arrays import BoolArray, UInt32Array
from canlog.database.addressing import FIRST_FAST_GROUP, J1939, NOBODY, parameter_group
from canlog.decode.codec import Codec, MessageTable
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from canlog.transport.fast_packet import LONGEST as LONGEST_FAST
from canlog.transport.fast_packet import FastPackets
from canlog.transport.isotp import IsoTp
from canlog.transport.j1939_tp import DATA, MANAGEMENT, J1939Transport
from canlog.transport.transfers import Transfer, TransferCounts

FUNCTIONAL, FIRST_DIAGNOSTIC, LAST_DIAGNOSTIC = 0x7DF, 0x7E0, 0x7EF  # ISO 15765-4, 11 bits
ANSWER_OFFSET: Final = 8
PHYSICAL_FORMAT, FUNCTIONAL_FORMAT = 0xDA, 0xDB  # ISO 15765-2, 29 bits: source and destination in the identifier
_EXTENDED: Final = int(EXTENDED_FLAG)
_NO_DATA: Final = np.uint32(REMOTE_FLAG | ERROR_FLAG)


class Reassembler:
    """Puts messages together, batch by batch; ``counts`` says what became of them.

    Parameters
    ----------
    fast_groups
        Parameter groups of NMEA 2000 that come as fast packets: nothing in a frame says so.
    pairs
        Identifiers, with flags, of requests and of their answers, besides those of ISO 15765-4.
    """

    def __init__(self, fast_groups: Collection[int] = (), pairs: Collection[tuple[int, int]] = ()) -> None:
        self.counts = TransferCounts()
        self._fast_groups = frozenset(fast_groups)
        self._peers = {one: other for pair in pairs for one, other in (pair, pair[::-1])}
        self._isotp = IsoTp(self.counts)
        self._j1939 = J1939Transport(self.counts)
        self._fast = FastPackets(self.counts)
        self._kinds: dict[int, str] = {}

    def feed(self, batch: FrameBatch) -> list[Transfer]:
        """Take the frames that follow; return the messages that are whole by them, in the order in which they are."""
        rows = np.flatnonzero(self._is_part(batch.can_id))
        found: list[Transfer] = []
        for row in rows.tolist():
            t_ns, channel, can_id = int(batch.t_ns[row]), int(batch.channel[row]), int(batch.can_id[row])
            data = batch.data[row, : batch.length[row]].tobytes()
            found += self._j1939.due(t_ns)
            one = self._feed(t_ns, channel, can_id, data)
            found += [one] if one is not None else []
        return found + (self._j1939.due(int(batch.t_ns[-1])) if len(batch) else [])

    def close(self) -> list[Transfer]:
        """End; return what is whole now, and count what is not."""
        self._isotp.close()
        self._fast.close()
        return self._j1939.close()

    def _feed(self, t_ns: int, channel: int, can_id: int, data: bytes) -> Transfer | None:
        kind = self._kinds[can_id]
        if kind == "j1939":
            return self._j1939.feed(t_ns, channel, can_id & ~_EXTENDED, data)
        if kind == "fast":
            return self._fast.feed(t_ns, (channel, can_id), data)
        peer = self.peer_of(can_id)
        return self._isotp.feed(t_ns, (channel, can_id), None if peer is None else (channel, peer), data)

    def _is_part(self, can_ids: UInt32Array) -> BoolArray:
        """Return which frames may be parts of messages, shape (n,)."""
        distinct, place = np.unique(can_ids, return_inverse=True)
        kinds = []
        for can_id in distinct.tolist():
            if can_id not in self._kinds:
                self._kinds[can_id] = self._kind_of(can_id)
            kinds.append(bool(self._kinds[can_id]))
        is_part: BoolArray = np.array(kinds, np.bool_)[place]
        return is_part

    def _kind_of(self, can_id: int) -> str:
        if can_id & int(_NO_DATA):
            return ""
        if can_id in self._peers:
            return "isotp"
        if not can_id & _EXTENDED:
            return "isotp" if FUNCTIONAL <= can_id <= LAST_DIAGNOSTIC else ""
        form, page = can_id >> 16 & 0xFF, can_id >> 24 & 3
        if page == 0 and form in {DATA, MANAGEMENT}:
            return "j1939"
        if parameter_group(can_id) in self._fast_groups:
            return "fast"
        return "isotp" if page == 0 and form in {PHYSICAL_FORMAT, FUNCTIONAL_FORMAT} else ""

    def peer_of(self, can_id: int) -> int | None:
        """Return the identifier of the other side of a conversation; None where all are meant."""
        if can_id in self._peers:
            return self._peers[can_id]
        if not can_id & _EXTENDED:
            if can_id == FUNCTIONAL:
                return None
            is_answer = can_id >= FIRST_DIAGNOSTIC + ANSWER_OFFSET
            return can_id - ANSWER_OFFSET if is_answer else can_id + ANSWER_OFFSET
        if can_id >> 16 & 0xFF != PHYSICAL_FORMAT:
            return None
        source, destination = can_id & 0xFF, can_id >> 8 & 0xFF
        return can_id & ~0xFFFF | source << 8 | destination


@dataclass(frozen=True, slots=True, kw_only=True)
class LongMessage:
    """A message that was put together, and what it says in the units of the database; nothing if that knows it not."""

    transfer: Transfer
    name: str = ""
    values: dict[str, float | int] | None = None
    fault: str = ""  # why the database cannot decode it


class LongMessages:
    """The messages of a stream that are longer than a frame.

    A group of J1939 of more than eight bytes whose own identifier comes is taken for a fast packet of NMEA 2000.
    ``pairs`` are further identifiers of requests and answers, as of `Reassembler`.
    """

    def __init__(self, messages: Sequence[Message], pairs: Collection[tuple[int, int]] = ()) -> None:
        self._codec = Codec(messages, has_long=True)
        self._reassembler = Reassembler(fast_groups=fast_groups(self._codec.tables), pairs=pairs)

    @property
    def counts(self) -> TransferCounts:
        """What became of all messages until now."""
        return self._reassembler.counts

    def feed(self, batch: FrameBatch) -> Iterator[LongMessage]:
        """Yield the messages that are whole by the frames that follow."""
        yield from map(self._decoded, self._reassembler.feed(batch))

    def close(self) -> Iterator[LongMessage]:
        """End, and yield what is whole now."""
        yield from map(self._decoded, self._reassembler.close())

    def _decoded(self, transfer: Transfer) -> LongMessage:
        slot = self._codec.slot_of(transfer.can_id)
        if slot == NOBODY:
            return LongMessage(transfer=transfer)
        message = self._codec.tables[slot].message
        try:
            decoded = message.decode(transfer.data, decode_choices=False, allow_truncated=True)
        except (DecodeError, ValueError) as exc:
            return LongMessage(transfer=transfer, name=message.name, fault=str(exc))
        if not isinstance(decoded, dict):
            return LongMessage(transfer=transfer, name=message.name, fault="a container of other messages")
        values = {name: value for name, value in decoded.items() if isinstance(value, int | float)}
        if not values and len(transfer.data) < message.length:
            return LongMessage(transfer=transfer, name=message.name, fault="shorter than the database says")
        return LongMessage(transfer=transfer, name=message.name, values=values)


def fast_groups(tables: Sequence[MessageTable]) -> frozenset[int]:
    """Return the groups whose own frames can be no more than pieces: fast packets of NMEA 2000, all of data page 1."""
    messages = [table.message for table in tables if PAYLOAD_BYTES < table.needed_bytes <= LONGEST_FAST]
    groups = {parameter_group(one.frame_id) for one in messages if one.is_extended_frame and one.protocol == J1939}
    return frozenset(group for group in groups if group >= FIRST_FAST_GROUP)
