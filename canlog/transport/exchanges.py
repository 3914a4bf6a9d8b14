"""Requests of testers and what controllers answered, out of whole messages (ISO 14229-1, SAE J1979)."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Final

from canlog.frames import EXTENDED_FLAG
from canlog.transport.reassembly import FUNCTIONAL, FUNCTIONAL_FORMAT, Reassembler
from canlog.transport.transfers import Protocol, Transfer

POSITIVE, NEGATIVE, PENDING = 0x40, 0x7F, 0x78
ANSWERS: Final = frozenset(range(0x40, 0x80)) | frozenset(range(0xC0, 0xD0))
MOST_KEPT: Final = 10_000
LONGEST_NS: Final = 60 * 1_000_000_000  # a controller that says "pending" may take its time
PATIENCE_NS: Final = 5 * 1_000_000_000  # for a first word; testers are told to wait 50 ms and gateways (ISO 14229-2)
OTHERS_NS: Final = 500_000_000  # in which others answer as well who were asked together
FUNCTIONAL_TARGET: Final = 0x33  # all controllers of emissions, as testers address them
_EXTENDED: Final = int(EXTENDED_FLAG)


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
