"""Signals that a controller tells whoever asks: what requests and answers on the bus say, as samples in the stream.

Whoever asks, live or in a log, the dialogue is read in one way. A value becomes a frame of its own, as those of a
column of a table are (`canlog.database.signal_columns`), half-way between the end of its request and the beginning
of its answer: the controller read it some time between the two.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from canlog.database.signal_columns import column_id
from canlog.errors import DefinitionError
from canlog.frames import (
    BEFORE_ALL_NS,
    EXTENDED_FLAG,
    MAX_GAP_NS,
    NS_PER_US,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    FrameBatch,
    empty_batch,
    join,
)
from canlog.isotp import Reassembler, Transfer
from diag_service.errors import ConfigError

READ_DATA, READ_PID, READ_LOCAL = 0x22, 0x01, 0x21  # UDS, OBD (SAE J1979), KWP2000
DEFINE_DATA, BY_IDENTIFIER, FORGET = 0x2C, 0x01, 0x03  # UDS: a datum is made of others, and unmade
POSITIVE, NEGATIVE, PENDING = 0x40, 0x7F, 0x78
SUB_FUNCTION: Final = 0x7F  # without the bit that asks for no answer
LATEST_NS: Final = 250_000_000  # of a whole answer after its request: nobody knows when a later one was read
DISORDER_NS: Final = 1_000_000  # frames of one machine's own and of others are stamped in no exact order
FUNCTIONAL_ID: Final = 0x7DF
LARGEST_STANDARD_ID: Final = 0x7FF
LARGEST_ID: Final = 0x1FFF_FFFF
MOST_BITS: Final = 32
MOST_BYTES: Final = 4095  # of a message of ISO-TP
FIXED_FORMAT: Final = 0x18DA  # normal fixed addressing: target and source in the lower bytes
ANSWER_OFFSET: Final = 8
_LARGEST: Final = {READ_DATA: 0xFFFF, READ_PID: 0xFF, READ_LOCAL: 0xFF}
_EXTENDED: Final = int(EXTENDED_FLAG)


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedField:
    """Bits of a datum that a controller tells by its number.

    The ``length`` bits are those above the lowest ``bit`` of the whole number which the bytes from ``byte`` on are.
    """

    request_id: int  # without flags
    reply_id: int
    service: int
    number: int
    byte: int = 0  # after the datum's number
    bit: int = 0
    length: int = 16  # [bit]
    is_little: bool = False
    is_signed: bool = False
    size: int = 0  # of the whole datum [byte]; 0: up to the end of its last field

    def __post_init__(self) -> None:
        if not 0 <= self.number <= _LARGEST[self.service]:
            raise ConfigError(f"0x{self.number:X} is no number of service {self.service:02X}")
        if not (0 < max(self.request_id, self.reply_id) <= LARGEST_ID) or self.request_id == self.reply_id:
            raise ConfigError(f"requests on {self.request_id:X} and answers on {self.reply_id:X} cannot be")
        if not 1 <= self.length <= MOST_BITS or self.bit < 0 or self.byte < 0:
            raise ConfigError(f"length must be 1 to {MOST_BITS} bits; byte and bit not below 0")
        if self.end > (self.size or MOST_BYTES):
            raise ConfigError(f"ends at byte {self.end}, its datum has {self.size or MOST_BYTES}")

    @property
    def end(self) -> int:
        """How many bytes the datum has at least."""
        return self.byte + (self.bit + self.length + 7) // 8

    @property
    def name(self) -> str:
        """By which it is known among columns, and to people."""
        place = f".{self.byte}.{self.bit}.{self.length}{'L' * self.is_little}{'S' * self.is_signed}"
        return (
            f"{self.request_id:03X} {self.service:02X} {self.number:0{4 if self.service == READ_DATA else 2}X}{place}"
        )

    @property
    def data_id(self) -> "DatumId":
        return DatumId(self.request_id, self.service, self.number)

    def value(self, data: bytes) -> int:
        count = (self.bit + self.length + 7) // 8
        number = int.from_bytes(data[self.byte : self.byte + count], "little" if self.is_little else "big")
        raw = number >> self.bit & (1 << self.length) - 1
        return raw - (1 << self.length) if self.is_signed and raw >> self.length - 1 else raw


@dataclass(frozen=True, slots=True)
class DatumId:
    """One datum of one controller."""

    request_id: int
    service: int
    number: int

    def __str__(self) -> str:
        return f"{self.number:0{4 if self.service == READ_DATA else 2}X} at {self.request_id:03X}"


def usual_reply_id(request_id: int) -> int:
    """Return the identifier of the answers to a request, as most controllers have it; raises ConfigError."""
    if request_id <= LARGEST_STANDARD_ID - ANSWER_OFFSET:
        return request_id + ANSWER_OFFSET
    if request_id >> 16 == FIXED_FORMAT:
        return FIXED_FORMAT << 16 | (request_id & 0xFF) << 8 | request_id >> 8 & 0xFF
    raise ConfigError(f"reply is needed: how {request_id:X} is answered cannot be derived from it")


def flagged(can_id: int) -> int:
    """Return an identifier with the flag that says how long it is."""
    return can_id | _EXTENDED if can_id > LARGEST_STANDARD_ID else can_id


def sizes_of(fields: Iterable[AskedField]) -> dict[DatumId, int]:
    """Return how many bytes each datum has; raises DefinitionError if its fields contradict each other."""
    sizes: dict[DatumId, int] = {}
    stated: dict[DatumId, int] = {}
    for field in fields:
        sizes[field.data_id] = max(sizes.get(field.data_id, 0), field.end)
        if field.size and stated.setdefault(field.data_id, field.size) != field.size:
            raise DefinitionError(f"{field.data_id} has two sizes")
    for datum, size in stated.items():
        if sizes[datum] > size:
            raise DefinitionError(f"{datum} has {size} bytes, a field of it ends at {sizes[datum]}")
    return {**sizes, **stated}


@dataclass(slots=True)
class _Asked:
    """A request that is open."""

    request: Transfer
    service: int
    is_answered: bool = False  # one that was asked of all waits for others


@dataclass(frozen=True, slots=True)
class _Sample:
    t_ns: int
    channel: int
    column: int
    value: float


class Overheard:
    """Puts what is told in dialogues into the stream of frames; what comes out does not depend on how that was cut.

    Frames are held back while an answer is awaited, up to ``LATEST_NS``: a sample may lie before them.

    Parameters
    ----------
    fields
        What is looked for; raises DefinitionError if they contradict each other.
    """

    def __init__(self, fields: Sequence[AskedField]) -> None:
        self._sizes = sizes_of(fields)
        self._fields: dict[DatumId, dict[int, AskedField]] = {}  # by the column's identifier: two signals may share one
        for field in fields:
            self._fields.setdefault(field.data_id, {})[column_id(field.name) | _EXTENDED] = field
        self._pairs = {flagged(field.reply_id): flagged(field.request_id) for field in fields}
        self._ids = np.array(sorted({*self._pairs, *self._pairs.values(), FUNCTIONAL_ID}), np.uint32)
        self._begin()
        self._defined: dict[DatumId, list[tuple[DatumId, int, int]]] = {}  # data that testers made of others
        self.frame_count = 0  # of requests and answers that gave samples
        self.answered: Counter[DatumId] = Counter()
        self.faults: Counter[str] = Counter()  # of dialogues that gave no sample, by why, for people

    def _begin(self) -> None:
        self._reassembler = Reassembler(pairs=[(request, reply) for reply, request in self._pairs.items()])
        self._open: dict[tuple[int, int], _Asked] = {}  # by channel and identifier of requests
        self._held = empty_batch()
        self._samples: list[_Sample] = []
        self._stamp_ns: int | None = None  # of the last frame, as it came
        self._now_ns = BEFORE_ALL_NS  # the latest of them

    @property
    def kernel_filters(self) -> tuple[tuple[int, int], ...]:
        """Identifier and mask, as SocketCAN wants them, of what is looked at."""
        flags = _EXTENDED | int(REMOTE_FLAG)
        return tuple(
            (can_id, (LARGEST_ID if can_id & _EXTENDED else LARGEST_STANDARD_ID) | flags)
            for can_id in self._ids.tolist()
        )

    def feed(self, batch: FrameBatch) -> Iterator[FrameBatch]:
        """Yield the frames that follow with the samples among them, in the order of time, as far as that is known."""
        if not len(batch):
            return
        before_ns = int(batch.t_ns[0]) if self._stamp_ns is None else self._stamp_ns
        steps_ns = np.diff(batch.t_ns, prepend=before_ns)
        breaks = np.flatnonzero((steps_ns < -DISORDER_NS) | (steps_ns > MAX_GAP_NS)).tolist()
        for start, stop in zip([0, *breaks], [*breaks, len(batch)], strict=True):
            if start in breaks:
                yield from self.drain()
            if stop > start:
                yield from self._go_on(batch[start:stop])

    def drain(self) -> Iterator[FrameBatch]:
        """Yield what is held back, and wait for no answer any more."""
        self._open.clear()
        if len(self._held):
            yield from self._release(int(self._held.t_ns[-1]))
        self._begin()

    def _go_on(self, piece: FrameBatch) -> Iterator[FrameBatch]:
        """Take frames without a jump of time between them."""
        rows = np.isin(piece.can_id, self._ids)
        self._stamp_ns = int(piece.t_ns[-1])
        ordered_ns = np.maximum.accumulate(np.maximum(piece.t_ns, self._now_ns))
        if (ordered_ns != piece.t_ns).any():
            piece = replace(piece, t_ns=ordered_ns)
        now_ns = self._now_ns = int(ordered_ns[-1])
        if not rows.any() and not self._open and not len(self._held):
            yield piece
            return
        for transfer in self._reassembler.feed(piece[rows]):
            self._take(transfer)
        self._held = join([self._held, piece]) if len(self._held) else piece
        late = [key for key, asked in self._open.items() if now_ns - asked.request.last_ns > LATEST_NS]
        for key in late:
            self.faults["no answer in time"] += not self._open.pop(key).is_answered
        yield from self._release(min([now_ns, *(asked.request.last_ns for asked in self._open.values())]))

    def _release(self, until_ns: int) -> Iterator[FrameBatch]:
        """Yield what is held back up to a time."""
        stop = int(np.searchsorted(self._held.t_ns, until_ns, "right"))
        due = sorted((sample for sample in self._samples if sample.t_ns <= until_ns), key=lambda sample: sample.t_ns)
        self._samples = [sample for sample in self._samples if sample.t_ns > until_ns]
        frames, self._held = self._held[:stop], self._held[stop:]
        if due:
            frames = join([frames, _frames_of(due)])
            frames = frames[np.argsort(frames.t_ns, kind="stable")]
        if len(frames):
            yield frames

    def _take(self, transfer: Transfer) -> None:
        data = transfer.data
        if not data:
            return
        if transfer.can_id not in self._pairs:
            if data[0] in _LARGEST or data[0] == DEFINE_DATA:
                self._open[transfer.channel, transfer.can_id] = _Asked(transfer, data[0])
            return
        keys = [(transfer.channel, can_id) for can_id in (self._pairs[transfer.can_id], FUNCTIONAL_ID)]
        candidates = [(key, self._open[key]) for key in keys if key in self._open]
        for key, asked in candidates:
            if data[0] == NEGATIVE and len(data) > 2 and data[1] == asked.service:
                if data[2] != PENDING:
                    self._close(key)
                    self.faults[f"refused with {data[2]:02X}"] += 1
                return
            if data[0] == asked.service + POSITIVE:
                self._close(key)
                self._answer(asked.request, transfer)
                return
        self.faults["an answer to no request"] += 1

    def _close(self, key: tuple[int, int]) -> None:
        self._open[key].is_answered = True
        if key[1] != FUNCTIONAL_ID:
            del self._open[key]

    def _answer(self, request: Transfer, answer: Transfer) -> None:
        if not 0 <= answer.last_ns - request.last_ns <= LATEST_NS:
            self.faults["no answer in time"] += 1
            return
        request_id = self._pairs[answer.can_id] & ~_EXTENDED
        if request.data[0] == DEFINE_DATA:
            self._define(request.data, request_id)
            return
        pieces = data_in(request.data, answer.data, request_id, self._sizes)
        if isinstance(pieces, str):
            self.faults[pieces] += 1
            return
        middle_ns = (request.last_ns + max(answer.first_ns, request.last_ns)) // 2 // NS_PER_US * NS_PER_US
        t_ns = max(middle_ns, request.last_ns)
        self.frame_count += (request.frames + answer.frames) * bool(pieces)
        for datum, data in [part for piece in pieces for part in self._parts(*piece)]:
            self.answered[datum] += 1
            for column, field in self._fields.get(datum, {}).items():
                self._samples.append(_Sample(t_ns, answer.channel, column, float(field.value(data))))

    def _define(self, request: bytes, request_id: int) -> None:
        """Keep what a datum is made of from now on; a definition is added to what there is of it."""
        datum = DatumId(request_id, READ_DATA, int.from_bytes(request[2:4]))
        if datum in self._fields:
            return  # the profile knows better
        if request[1] & SUB_FUNCTION == BY_IDENTIFIER and len(request) > 4:
            self._defined.setdefault(datum, []).extend(
                (DatumId(request_id, READ_DATA, int.from_bytes(piece[:2])), piece[2] - 1, piece[3])
                for piece in (request[at : at + 4] for at in range(4, len(request) - 3, 4))
            )
            self._sizes[datum] = sum(size for _, _, size in self._defined[datum])
        elif request[1] & SUB_FUNCTION == FORGET:
            for defined in [datum] if len(request) > 2 else list(self._defined):
                if self._defined.pop(defined, None) is not None:
                    del self._sizes[defined]

    def _parts(self, datum: DatumId, data: bytes) -> Iterator[tuple[DatumId, bytes]]:
        """Yield a datum, or the whole data that it is made of."""
        if datum not in self._defined:
            yield datum, data
            return
        at = 0
        for source, start, size in self._defined[datum]:
            if start == 0 and size == self._sizes.get(source):
                yield source, data[at : at + size]
            at += size


def data_in(
    request: bytes, answer: bytes, request_id: int, sizes: dict[DatumId, int]
) -> list[tuple[DatumId, bytes]] | str:
    """Return the data of an answer, or why it cannot be read; data that nobody looks for are none."""
    asked, width = _asked_data(request, request_id), 2 if request[0] == READ_DATA else 1
    known = {name: datum for name, datum in asked.items() if datum in sizes}
    if not known:
        return []
    if len(known) < len(asked):
        return "data of unknown length beside those that are looked for"
    pieces, at = list[tuple[DatumId, bytes]](), 1
    while at < len(answer):
        datum = known.pop(answer[at : at + width], None)
        if datum is None:
            return "an answer with other numbers than were asked for, or of another length than the profile says"
        at += width + sizes[datum]
        if at > len(answer):
            return "an answer of another length than the profile says"
        pieces.append((datum, answer[at - sizes[datum] : at]))
    return pieces


@lru_cache(maxsize=256)  # a tester asks for the same again and again
def _asked_data(request: bytes, request_id: int) -> Mapping[bytes, DatumId]:
    """Return the data that a request names, by their numbers as an answer repeats them."""
    width = 2 if request[0] == READ_DATA else 1
    numbers = (request[at : at + width] for at in range(1, len(request) + 1 - width, width))
    return {number: DatumId(request_id, request[0], int.from_bytes(number)) for number in numbers}


def _frames_of(samples: Sequence[_Sample]) -> FrameBatch:
    values = np.array([sample.value for sample in samples], "<f8")
    return FrameBatch(
        t_ns=np.array([sample.t_ns for sample in samples], np.int64),
        can_id=np.array([sample.column for sample in samples], np.uint32),
        length=np.full(len(samples), PAYLOAD_BYTES, np.uint8),
        data=values.view(np.uint8).reshape(-1, PAYLOAD_BYTES).copy(),
        channel=np.array([sample.channel for sample in samples], np.uint8),
    )
