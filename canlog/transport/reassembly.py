"""Transports that carry messages longer than a frame: each put together, whichever protocol carried it; and counted."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from cantools.database import DecodeError
from cantools.database.can import Message

from canlog.arrays import BoolArray, UInt32Array
from canlog.database.addressing import NOBODY
from canlog.decode.codec import Codec
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.transport.isotp import IsoTp
from canlog.transport.j1939_tp import DATA, MANAGEMENT, J1939Transport
from canlog.transport.transfers import Protocol, Transfer, TransferCounts

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


@dataclass(frozen=True, slots=True, kw_only=True)
class LongMessage:
    """A message that was put together, and what it says in the units of the database; nothing if that knows it not."""

    transfer: Transfer
    name: str = ""
    values: dict[str, float | int] | None = None
    fault: str = ""  # why the database cannot decode it


class LongMessages:
    """The messages of a stream that are longer than a frame.

    ``pairs`` are further identifiers of requests and answers, as of `Reassembler`.
    """

    def __init__(self, messages: Sequence[Message], pairs: Collection[tuple[int, int]] = ()) -> None:
        self._codec = Codec(messages, has_long=True)
        self._reassembler = Reassembler(pairs)

    @property
    def counts(self) -> TransferCounts:
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


POSITIVE, NEGATIVE, PENDING = 0x40, 0x7F, 0x78
ANSWERS: Final = frozenset(range(0x40, 0x80)) | frozenset(range(0xC0, 0xD0))
MOST_KEPT: Final = 10_000
LONGEST_NS: Final = 60 * 1_000_000_000  # a controller that says "pending" may take its time
PATIENCE_NS: Final = 5 * 1_000_000_000  # for a first word; testers are told to wait 50 ms and gateways (ISO 14229-2)
OTHERS_NS: Final = 500_000_000  # in which others answer as well who were asked together
FUNCTIONAL_TARGET: Final = 0x33  # all controllers of emissions, as testers address them


@dataclass(slots=True, kw_only=True)
class Exchange:
    """A request and what came of it; ``pending`` is how often a controller asked for patience."""

    request: Transfer
    answers: list[Transfer] = field(default_factory=list)
    pending: int = 0

    @property
    def latency_ns(self) -> int | None:
        """From the end of the request to the beginning of the first answer that is one; None without."""
        return self.answers[0].first_ns - self.request.last_ns if self.answers else None


@dataclass(slots=True)
class Exchanges:
    """Pairs requests with answers, in the order of time; past ``MOST_KEPT`` the others are only counted.

    ``pairs`` are those of the `Reassembler` that made the messages. ``unasked`` counts answers to no request,
    ``more`` those exchanges that are not kept.
    """

    pairs: Collection[tuple[int, int]] = ()
    found: list[Exchange] = field(default_factory=list)
    unasked: int = 0
    more: int = 0
    _last: dict[tuple[int, int], Exchange] = field(default_factory=dict)  # of channel and identifier of the request

    def feed(self, transfers: Iterable[Transfer]) -> None:
        """Take messages that follow; those of other protocols are passed over."""
        for one in transfers:
            if one.protocol is not Protocol.ISO_TP or not one.data:
                continue
            if one.data[0] in ANSWERS:
                self._answer(one)
            else:
                self._ask(one)

    def settled(self, now_ns: int) -> list[Exchange]:
        """Take out, and return, the exchanges of which no more is to be expected at a time on the bus."""
        kept, done = list[Exchange](), list[Exchange]()
        for one in self.found:
            (done if self._is_settled(one, now_ns) else kept).append(one)
        self.found = kept
        return done

    def _is_settled(self, one: Exchange, now_ns: int) -> bool:
        if self._last[one.request.channel, one.request.can_id] is not one:
            return True
        if one.answers:
            return now_ns - one.answers[-1].last_ns >= OTHERS_NS
        return now_ns - one.request.last_ns >= (LONGEST_NS if one.pending else PATIENCE_NS)

    def _ask(self, request: Transfer) -> None:
        exchange = Exchange(request=request)
        self._last[request.channel, request.can_id] = exchange
        if len(self.found) < MOST_KEPT:
            self.found.append(exchange)
        else:
            self.more += 1

    def _answer(self, answer: Transfer) -> None:
        asked = [self._last.get((answer.channel, can_id)) for can_id in _askers(answer.can_id, self.pairs)]
        fitting = [one for one in asked if one is not None and _belongs(one.request, answer)]
        if not fitting:
            self.unasked += 1
            return
        exchange = max(fitting, key=lambda one: one.request.last_ns)
        if answer.data[0] == NEGATIVE and answer.data[2:3] == bytes([PENDING]):
            exchange.pending += 1
        else:
            exchange.answers.append(answer)


def _askers(can_id: int, pairs: Collection[tuple[int, int]]) -> tuple[int, ...]:
    """Return the identifiers of requests that an answer may belong to."""
    peer = Reassembler(pairs=pairs).peer_of(can_id)
    own = () if peer is None else (peer,)
    if not can_id & _EXTENDED:
        return (*own, FUNCTIONAL)
    tester = can_id >> 8 & 0xFF
    form = can_id & ~0xFFFFFF | FUNCTIONAL_FORMAT << 16
    return (*own, form | FUNCTIONAL_TARGET << 8 | tester, form | 0xFF << 8 | tester)


def _belongs(request: Transfer, answer: Transfer) -> bool:
    if not 0 <= answer.first_ns - request.first_ns <= LONGEST_NS:
        return False
    if answer.data[0] == NEGATIVE:
        return len(answer.data) >= 3 and answer.data[1] == request.data[0]
    return answer.data[0] == request.data[0] + POSITIVE
