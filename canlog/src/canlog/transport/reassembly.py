"""Transports that carry messages longer than a frame: each put together, whichever protocol carried it; and counted."""

from collections.abc import Collection
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, UInt32Array
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
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
    pairs
        Identifiers, with flags, of requests and of their answers, besides those of ISO 15765-4.
    """

    def __init__(self, pairs: Collection[tuple[int, int]] = ()) -> None:
        self.counts = TransferCounts()
        self._peers = {one: other for pair in pairs for one, other in (pair, pair[::-1])}
        self._isotp = IsoTp(self.counts)
        self._j1939 = J1939Transport(self.counts)
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
        return self._j1939.close()

    def _feed(self, t_ns: int, channel: int, can_id: int, data: bytes) -> Transfer | None:
        kind = self._kinds[can_id]
        if kind == "j1939":
            return self._j1939.feed(t_ns, channel, can_id & ~_EXTENDED, data)
        peer = self.peer_of(can_id)
        return self._isotp.feed(t_ns, (channel, can_id), None if peer is None else (channel, peer), data)

    def _is_part(self, can_ids: UInt32Array) -> BoolArray:
        """Return which frames may be parts of messages, shape (n,)."""
        distinct, place = np.unique(can_ids, return_inverse=True)
        kinds = []
        for can_id in distinct.tolist():
            if kind := self._kinds.get(can_id) or self._kind_of(can_id):
                self._kinds[can_id] = kind  # the others are not kept: noise has any number of them
            kinds.append(bool(kind))
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
