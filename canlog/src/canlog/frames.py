"""FrameBatch: the one columnar type that every source yields, and how several become one."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import BoolArray, Int64Array, UInt8Array, UInt32Array

EXTENDED_FLAG = 0x8000_0000  # bit 31 of ``can_id``: 29-bit identifier
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000

BRS_FLAG = 0x01  # bits of ``flags``, as Linux numbers them: the payload was sent at the faster bit rate
ESI_FLAG = 0x02  # the sender was error passive
FD_FLAG = 0x04  # a CAN FD frame
TX_FLAG = 0x08  # not of Linux: sent by the recorder itself

PAYLOAD_BYTES = 8  # of a classic frame
FD_PAYLOAD_BYTES = 64  # of a CAN FD frame

BEFORE_ALL_NS = -(2**62)  # in place of a time: before any that a frame can have
MAX_GAP_NS = 1_000_000_000  # a bus that was silent for longer starts a new segment


Rows = slice | Int64Array | npt.NDArray[np.bool_]


def _no_column() -> UInt8Array:
    return np.empty(0, np.uint8)


_BYTES = np.dtype(np.uint8)
_KINDS: dict[str, np.dtype[Any]] = {
    "t_ns": np.dtype(np.int64),
    "can_id": np.dtype(np.uint32),
    **dict.fromkeys(("length", "data", "flags", "channel"), _BYTES),
}
COLUMNS = tuple(_KINDS)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameBatch:
    """Frames in the order of arrival, as arrays; no Python object per frame.

    ``t_ns`` is bus time in whole microseconds (what a candump log keeps), so a live stream and its recording decode
    to the same bits. Payload bytes past ``length`` are zero. A batch of classic frames has payload rows of 8 bytes,
    one that may hold CAN FD frames has 64; ``flags`` and ``channel`` are zeros if they are left out.
    """

    t_ns: Int64Array  # (n,)
    can_id: UInt32Array  # (n,) with the flags above
    length: UInt8Array  # (n,) bytes, up to the width
    data: UInt8Array  # (n, 8) or (n, 64)
    flags: UInt8Array = field(default_factory=_no_column)  # (n,) of FD_FLAG, BRS_FLAG, ESI_FLAG, TX_FLAG
    channel: UInt8Array = field(default_factory=_no_column)  # (n,) bus number as the source counts; 0: it has but one

    def __post_init__(self) -> None:
        for name in ("flags", "channel"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(self.t_ns), np.uint8))

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: Rows) -> "FrameBatch":
        return FrameBatch(**{name: getattr(self, name)[rows] for name in COLUMNS})

    @property
    def width(self) -> int:
        """Bytes of a payload row."""
        return int(self.data.shape[1])

    def plain(self) -> "FrameBatch":
        """Return the same frames with every column in the one layout that loops are compiled for."""
        for name, kind in _KINDS.items():
            column: npt.NDArray[Any] = getattr(self, name)
            if not column.flags.carray or column.dtype != kind:
                whole = {name: np.require(getattr(self, name), kind, ("C", "W")) for name, kind in _KINDS.items()}
                return FrameBatch(**whole)
        return self

    def widened(self, width: int) -> "FrameBatch":
        """Return the same frames with payload rows of at least ``width`` bytes."""
        if self.width >= width:
            return self
        data = np.zeros((len(self), width), np.uint8)
        data[:, : self.width] = self.data
        return replace(self, data=data)


def empty_batch() -> FrameBatch:
    return FrameBatch(
        t_ns=np.empty(0, np.int64),
        can_id=np.empty(0, np.uint32),
        length=np.empty(0, np.uint8),
        data=np.empty((0, PAYLOAD_BYTES), np.uint8),
    )


class Frame(NamedTuple):
    """One frame, for readers that go through a source one by one."""

    t_ns: int
    can_id: int  # with the flags above
    length: int
    data: bytes  # up to the length
    flags: int = 0
    channel: int = 0


def batch_of(frames: Sequence[Frame]) -> FrameBatch:
    """Return some frames as columns."""
    if not frames:
        return empty_batch()
    t_ns, can_id, length, data, flags, channel = zip(*frames, strict=True)
    width = FD_PAYLOAD_BYTES if any(frame.flags & FD_FLAG for frame in frames) else PAYLOAD_BYTES
    return FrameBatch(
        t_ns=np.array(t_ns, np.int64),
        can_id=np.array(can_id, np.uint32),
        length=np.array(length, np.uint8),
        data=np.frombuffer(b"".join(payload.ljust(width, b"\0") for payload in data), np.uint8).reshape(-1, width),
        flags=np.array(flags, np.uint8),
        channel=np.array(channel, np.uint8),
    )


NS_PER_US = 1_000


def join(batches: Sequence[FrameBatch]) -> FrameBatch:
    """Return one batch with the frames of all, in their order, as wide as the widest."""
    if len(batches) == 1:
        return batches[0]
    width = max(batch.width for batch in batches)
    batches = [batch.widened(width) for batch in batches]
    return FrameBatch(**{name: np.concatenate([getattr(batch, name) for batch in batches]) for name in COLUMNS})


def merged_by_time(
    streams: Iterable[Iterator[FrameBatch]], marked: Callable[[int, FrameBatch], FrameBatch] = lambda _, batch: batch
) -> Iterator[FrameBatch]:
    """Yield the frames of all streams; of frames with the same time those of an earlier stream come first.

    Each stream is held one batch ahead. Where its time jumps back its frames stay in their order. A stream that ends
    is asked for more before another begins with frames of the same time.

    Parameters
    ----------
    marked :
        Returns frames of a stream, by its place, as they shall leave; called as they are due.
    """
    waiting = [(number, stream, batch) for number, stream in enumerate(streams) if (batch := _next(stream)) is not None]
    begun: set[int] = set()
    while len(waiting) > 1:
        horizon_ns, first = min((int(batch.t_ns[-1]), place) for place, (*_, batch) in enumerate(waiting))
        due = [
            0 if place > first and number not in begun and batch.t_ns[0] == horizon_ns else _due(batch, horizon_ns)
            for place, (number, _, batch) in enumerate(waiting)
        ]
        if not any(due):  # the time of every stream jumps back: the one that is behind goes on as it is
            behind = min(range(len(waiting)), key=lambda place: int(waiting[place][2].t_ns[0]))
            due[behind] = len(waiting[behind][2])
        parts = list(zip(waiting, due, strict=True))
        begun.update(number for (number, *_), count in parts if count)
        leaving = [marked(number, batch[:count]) for (number, _, batch), count in parts if count]
        together = join(leaving)
        yield together if len(leaving) == 1 else together[np.argsort(together.t_ns, kind="stable")]
        left = [(number, stream, batch[count:]) for (number, stream, batch), count in parts]
        refilled = [(number, stream, batch if len(batch) else _next(stream)) for number, stream, batch in left]
        waiting = [(number, stream, batch) for number, stream, batch in refilled if batch is not None]
    for number, stream, batch in waiting:
        yield marked(number, batch)
        yield from (marked(number, rest) for rest in stream if len(rest))


def _next(stream: Iterator[FrameBatch]) -> FrameBatch | None:
    return next((batch for batch in stream if len(batch)), None)


def _due(batch: FrameBatch, horizon_ns: int) -> int:
    """Return how many frames from the first come no later."""
    later = np.flatnonzero(batch.t_ns > horizon_ns)
    return int(later[0]) if len(later) else len(batch)


def clear_padding(data: UInt8Array, length: UInt8Array | Int64Array) -> UInt8Array:
    """Return payloads (n, width) with zeros past their length: a sender may leave anything there."""
    return np.where(np.arange(data.shape[1]) < length[:, None], data, 0).astype(np.uint8)


def rounded_to_us(t_ns: Int64Array) -> Int64Array:
    """Return times rounded to whole microseconds, still in nanoseconds."""
    return (t_ns + NS_PER_US // 2) // NS_PER_US * NS_PER_US


class BusTrouble(StrEnum):
    """A kind of trouble on the bus; one error frame may report several."""

    BUS_OFF = "bus_off"
    RESTARTED = "restarted"
    ERROR_PASSIVE = "error_passive"
    ERROR_WARNING = "error_warning"
    ERROR_ACTIVE = "error_active"  # the counters have fallen again: all is well
    ARBITRATION_LOST = "arbitration_lost"
    PROTOCOL = "protocol"
    NO_ACKNOWLEDGE = "no_acknowledge"
    TRANSCEIVER = "transceiver"
    TRANSMIT_TIMEOUT = "transmit_timeout"
    CONTROLLER_OVERFLOW = "controller_overflow"
    OTHER = "other"


_CONTROLLER: Final = 0x04  # class "controller", detailed in byte 1
_CLASSES: Final = {
    BusTrouble.TRANSMIT_TIMEOUT: 0x01,
    BusTrouble.ARBITRATION_LOST: 0x02,
    BusTrouble.PROTOCOL: 0x08 | 0x80,  # protocol violation, bus error
    BusTrouble.TRANSCEIVER: 0x10,
    BusTrouble.NO_ACKNOWLEDGE: 0x20,
    BusTrouble.BUS_OFF: 0x40,
    BusTrouble.RESTARTED: 0x100,
}
_CONTROLLER_STATES: Final = {
    BusTrouble.CONTROLLER_OVERFLOW: 0x01 | 0x02,  # receive, transmit
    BusTrouble.ERROR_WARNING: 0x04 | 0x08,
    BusTrouble.ERROR_PASSIVE: 0x10 | 0x20,
    BusTrouble.ERROR_ACTIVE: 0x40,
}
GOOD_NEWS: Final = frozenset({BusTrouble.RESTARTED, BusTrouble.ERROR_ACTIVE})


def is_error(batch: FrameBatch) -> BoolArray:
    """Return which frames are error frames, shape (n,)."""
    is_error_frame: BoolArray = (batch.can_id & np.uint32(ERROR_FLAG)) != 0
    return is_error_frame


def reports(batch: FrameBatch, error: BusTrouble) -> BoolArray:
    """Return which frames are error frames that report ``error``, shape (n,)."""
    is_report = is_error(batch)
    if error in _CLASSES:
        is_report &= (batch.can_id & np.uint32(_CLASSES[error])) != 0
    elif error in _CONTROLLER_STATES:
        is_report &= (batch.can_id & np.uint32(_CONTROLLER)) != 0
        is_report &= (batch.data[:, 1] & np.uint8(_CONTROLLER_STATES[error])) != 0
    else:
        for known in (*_CLASSES, *_CONTROLLER_STATES):
            is_report &= ~reports(batch, known)
    return is_report


def count_errors(batch: FrameBatch) -> Counter[BusTrouble]:
    """Return how many error frames of a batch report each kind of trouble; kinds that do not occur are left out."""
    if not is_error(batch).any():
        return Counter()
    return Counter({error: count for error in BusTrouble if (count := int(reports(batch, error).sum()))})
