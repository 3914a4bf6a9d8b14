"""The objects inside BLF containers, which kinds hold frames and where, and what is carried from one to the next."""

import struct
from dataclasses import astuple, dataclass

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FrameBatch
from canlog.logs.blf_kernel import (
    DAMAGED,
    FIRST_DAMAGED,
    IS_LOST,
    IS_TOO_WIDE,
    LONGEST_PADDING,
    MAGIC_WORD,
    MOST_KINDS,
    OBJECTS,
    POSITION,
    REPORT_FIELDS,
    ROWS,
    SKIPPED,
    STAMPED_HEADER_BYTES,
    parse_objects,
)
from canlog.logs.frame_buffer import FrameBuffer
from canlog.logs.log_counts import LogCounts, LogReject

OBJECT_MAGIC = MAGIC_WORD.to_bytes(4, "little")
OBJECT_HEADER = struct.Struct("<4sHHLL")  # magic, header size, header version, object size, object type
NS_PER_US = 1_000

__all__ = ["LONGEST_PADDING", "OBJECT_HEADER", "OBJECT_MAGIC", "ObjectStream"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where the fields of a frame object are, counted from the end of its header; -1: it has none.

    In the order of the columns that the compiled reader takes.
    """

    data: int
    channel_bytes: int = 2
    remote: int = 0
    remote_mask: int = 0
    length: int = 0
    fd: int = -1
    fd_mask: int = 0
    brs_mask: int = 0
    esi_mask: int = 0
    extension: int = -1  # of a field that says where the data ends, from the start of the object
    is_error: bool = False
    sent: int = 2  # of a field whose lowest bit says that the recorder sent the frame


MESSAGE = Layout(length=3, remote=2, remote_mask=0x80, data=8)
FD_MESSAGE = Layout(
    length=3, remote=2, remote_mask=0x80, fd=13, fd_mask=0x01, brs_mask=0x02, esi_mask=0x04, data=20
)  # fmt: skip
FD_MESSAGE_64 = Layout(
    length=1, remote=12, remote_mask=0x10, fd=13, fd_mask=0x10, brs_mask=0x20, esi_mask=0x40, data=40, extension=35,
    channel_bytes=1, sent=34,
)  # fmt: skip
ERROR = Layout(is_error=True, data=2)
FD_ERROR = Layout(is_error=True, data=1, channel_bytes=1)
LAYOUTS = {1: MESSAGE, 86: MESSAGE, 100: FD_MESSAGE, 101: FD_MESSAGE_64, 2: ERROR, 73: ERROR, 104: FD_ERROR}
ABSENT = Layout(data=-1)


LAYOUT_TABLE: Int64Array = np.array(
    [astuple(LAYOUTS.get(kind, ABSENT)) for kind in range(MOST_KINDS)], np.int64
)  # a row for each kind of object


class ObjectStream:
    """Objects of successive containers, which may be cut anywhere, to batches of frames.

    Parameters
    ----------
    start_us : int
        Start of measurement since the epoch.
    counts : LogCounts
        Takes the counts.
    rows : int
        How many frames are added, as a rule, before they are taken; more find room, too.
    """

    def __init__(self, start_us: int, counts: LogCounts, rows: int) -> None:
        self._start_ns = start_us * NS_PER_US
        self._counts = counts
        self._frames = FrameBuffer(rows)
        self._buffer = np.empty(0, np.uint8)
        self._tail = np.empty(0, np.uint8)  # the beginning of an object that the next container continues
        self._report = np.zeros(REPORT_FIELDS, np.int64)

    def __len__(self) -> int:
        return int(self._report[ROWS])

    def feed(self, data: bytes | bytearray) -> None:
        """Add the frames of the objects that end in this piece."""
        raw, report = self._joined(data), self._report
        report[POSITION] = report[SKIPPED] = report[DAMAGED] = 0
        self._frames.reserve(len(self) + len(raw) // STAMPED_HEADER_BYTES + 1, len(self))
        while True:
            parse_objects(raw, LAYOUT_TABLE, self._start_ns, self._frames.rows, report)
            if not report[IS_TOO_WIDE]:
                break
            self._frames.widen(len(self))
        self._tail = raw[report[POSITION] :].copy()
        if not self._tail.any():
            self._tail = self._tail[:0]
        self._counts.skipped += int(report[SKIPPED])
        if report[DAMAGED]:
            self._counts.reject(LogReject.DAMAGED, f"object {report[FIRST_DAMAGED]}", int(report[DAMAGED]))

    def hand_over(self) -> FrameBatch:
        """Return the frames added since the last time."""
        batch = self._frames.handed_over(len(self))
        self._counts.frames += len(self)
        self._report[ROWS] = 0
        return batch

    def _joined(self, data: bytes | bytearray) -> UInt8Array:
        """Return a piece behind what is left of the one before it."""
        piece, kept = np.frombuffer(data, np.uint8), len(self._tail)
        if not kept:
            return piece
        if len(self._buffer) < kept + len(piece):
            self._buffer = np.empty(kept + len(piece), np.uint8)
        joined = self._buffer[: kept + len(piece)]
        joined[:kept], joined[kept:] = self._tail, piece
        return joined

    def lose_track(self) -> None:
        """Forget an object whose continuation is missing; go on with the next one that can be found."""
        self._tail = self._tail[:0]
        self._report[IS_LOST] = True

    def finish(self) -> None:
        """Count an object that the file does not complete."""
        if len(self._tail):
            self._counts.cut_off(f"object {self._report[OBJECTS] + 1}")
