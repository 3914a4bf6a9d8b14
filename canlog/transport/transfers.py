"""What transport protocols give: whole messages, why others are not whole, and which of them answer which requests."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from canlog.frames import EXTENDED_FLAG
from canlog.transport.reassembly import FUNCTIONAL, FUNCTIONAL_FORMAT, Reassembler

NS_PER_MS: Final = 1_000_000
MOST_OPEN: Final = 1_024  # transfers of one protocol at a time: every pair of J1939 addresses on a busy bus, and noise


class Protocol(StrEnum):
    """How a message is cut into frames."""

    ISO_TP = "iso_tp"  # ISO 15765-2
    J1939_TP = "j1939_tp"  # SAE J1939-21, BAM and RTS/CTS
    FAST_PACKET = "fast_packet"  # NMEA 2000


class Fault(StrEnum):
    """Why a message was not put together."""

    FRAME_MISSING = "frame_missing"  # the next frame was not the one that had to come
    NO_BEGINNING = "no_beginning"  # frames of a message whose first one is not in the log
    TIMEOUT = "timeout"  # nothing followed for longer than the standard allows
    INTERRUPTED = "interrupted"  # another message began, or a request came, before it was complete
    ABORTED = "aborted"  # one of the two sides gave up
    WRONG_LENGTH = "wrong_length"  # the first frame states a length that no message of its kind has
    CUT_OFF = "cut_off"  # the log ends inside it
    TOO_MANY = "too_many"  # so many at a time that the oldest was given up


def is_padding(data: bytes | bytearray) -> bool:
    """Return whether bytes behind a message say nothing: 0xFF, as the standards have it, or 0, as some devices do."""
    return not data.strip(b"\xff\0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """A whole message; ``destination`` is an address of J1939, -1 where the protocol has none."""

    protocol: Protocol
    channel: int
    can_id: (
        int  # of the sender's frames, with flags; of J1939 with the group of the message in place of the transport's
    )
    destination: int = -1
    first_ns: int  # when its first frame came
    last_ns: int  # when it was complete
    frames: int
    data: bytes


@dataclass(slots=True)
class TransferCounts:
    """What became of messages: those that are whole, and the others by why they are not."""

    whole: dict[Protocol, int] = field(default_factory=dict)
    incomplete: dict[tuple[Protocol, Fault], int] = field(default_factory=dict)

    def add_whole(self, protocol: Protocol) -> None:
        self.whole[protocol] = self.whole.get(protocol, 0) + 1

    def add_fault(self, protocol: Protocol, fault: Fault) -> None:
        """Count one that is not whole."""
        self.incomplete[protocol, fault] = self.incomplete.get((protocol, fault), 0) + 1

    @property
    def incomplete_count(self) -> int:
        """How many are not whole."""
        return sum(self.incomplete.values())

    def in_words(self) -> list[str]:
        """Return the counts for people, a line for each protocol that occurred."""
        lines = []
        for protocol in Protocol:
            faults = {fault: count for (one, fault), count in self.incomplete.items() if one is protocol}
            if not faults and protocol not in self.whole:
                continue
            reasons = ", ".join(f"{count} {fault.value.replace('_', ' ')}" for fault, count in sorted(faults.items()))
            name = protocol.value.replace("_", " ")
            what = f"{self.whole.get(protocol, 0)} whole messages, {sum(faults.values())} incomplete"
            lines.append(f"{name}: {what}{f' ({reasons})' if reasons else ''}")
        return lines


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
