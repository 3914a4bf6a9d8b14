"""Vector BLF files: from containers on disk to one stream of objects; damage is counted.

The layout follows the structures that python-can documents; the start of measurement counts as UTC, as it does there.
No size in the file is trusted: every step makes progress or gives up, and what is damaged is counted and stepped over.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from datetime import UTC, datetime
from typing import BinaryIO, NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.errors import SourceError
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
)
from canlog.jit import kernel, part
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_kernels import LENGTH_OF_CODE, FrameBuffer, FrameRows, clear, half, lower, word

# Fields of the report that goes from call to call.
POSITION, ROWS, OBJECTS, IS_LOST, SKIPPED, DAMAGED, FIRST_DAMAGED, IS_TOO_WIDE, REPORT_FIELDS = range(9)

# The columns of a layout: where fields are, counted from the end of an object's header; -1: it has none.
DATA, CHANNEL_BYTES, REMOTE, REMOTE_MASK, LENGTH, FD, FD_MASK, BRS_MASK, ESI_MASK, EXTENSION, IS_ERROR, SENT = range(12)
CAN_ID_OFFSET = 4

MAGIC_WORD = int.from_bytes(b"LOBJ", "little")
HEADER_BYTES = 16  # magic, header size, header version, object size, object type
HEADER_SIZE_OFFSET, SIZE_OFFSET, KIND_OFFSET = 4, 8, 12
FLAGS_OFFSET = 16  # behind the common header, in both header versions
TIME_OFFSET = 24
STAMPED_HEADER_BYTES = 32
LONGEST_HEADER_BYTES = 64
TEN_MICROSECONDS = 1  # flag: unit of the time; anything else is nanoseconds
NS_PER_US, NS_PER_TEN_US = 1_000, 10_000
LAST_NS = 9_200_000_000_000_000_000
LONGEST_PADDING = 8
MAX_OBJECT_BYTES = 4 * 1024 * 1024  # a damaged size must not swallow the rest of the file
MOST_KINDS = 256  # about 140 are defined
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF


@kernel
def parse_objects(raw: UInt8Array, layouts: Int64Array, start_ns: int, rows: FrameRows, report: Int64Array) -> None:
    """Go through the objects of a buffer, up to the first that it does not hold whole.

    ``layouts`` has a row per kind of object, with DATA < 0 where a kind holds no frame.
    """
    at, row, objects = report[POSITION], report[ROWS], report[OBJECTS]
    report[IS_TOO_WIDE] = 0
    while True:
        report[OBJECTS] = objects
        at, size = _locate(raw, at, report)
        if size < 0:
            break
        kind = lower(raw, at + KIND_OFFSET)
        if kind >= MOST_KINDS:
            _count_damage(report)
        elif layouts[kind, DATA] < 0:
            report[SKIPPED] += 1
        else:
            outcome = _frame(raw, at, size, layouts[kind], rows, row, start_ns)
            if outcome == TOO_WIDE:
                report[IS_TOO_WIDE] = 1
                break
            row += outcome == WRITTEN
            if outcome == BROKEN:
                _count_damage(report)
        objects += 1
        at += size
    report[POSITION], report[ROWS] = at, row


WRITTEN, BROKEN, TOO_WIDE = range(3)

SENT_BIT = 0x01


@part
def _count_damage(report: Int64Array) -> None:
    if report[DAMAGED] == 0:
        report[FIRST_DAMAGED] = report[OBJECTS] + 1
    report[DAMAGED] += 1


@part
def _locate(raw: UInt8Array, at: int, report: Int64Array) -> tuple[int, int]:
    """Return where the next object is and its size, -1 if the buffer does not hold all of it; count what is damaged."""
    while True:
        start = at
        while start + 4 <= len(raw) and lower(raw, start) != MAGIC_WORD:
            start += 1
        if start + 4 > len(raw):
            return max(at, len(raw) - 3), -1
        if start - at > LONGEST_PADDING and not report[IS_LOST]:
            _count_damage(report)
        report[IS_LOST] = 0
        if start + HEADER_BYTES > len(raw):
            return start, -1
        size = lower(raw, start + SIZE_OFFSET)
        if HEADER_BYTES <= size <= MAX_OBJECT_BYTES:
            return (start, size) if start + size <= len(raw) else (start, -1)
        _count_damage(report)
        report[IS_LOST] = 1
        at = start + 4


@part
def _frame(raw: UInt8Array, at: int, size: int, layout: Int64Array, rows: FrameRows, row: int, start_ns: int) -> int:
    """Write the frame of an object into a row; return WRITTEN, or why it could not be."""
    header = half(raw, at + HEADER_SIZE_OFFSET)
    if header < STAMPED_HEADER_BYTES or header > LONGEST_HEADER_BYTES or size < header + layout[DATA]:
        return BROKEN
    time_ns = _time_ns(raw, at, start_ns)
    if time_ns < 0:
        return BROKEN
    body = at + header
    rows.t_ns[row] = time_ns
    rows.channel[row] = min(half(raw, body), 255) if layout[CHANNEL_BYTES] == 2 else raw[body]
    if layout[IS_ERROR]:
        rows.can_id[row], rows.length[row], rows.flags[row] = ERROR_FLAG, 0, 0
        clear(rows.data, row, 0)
        return WRITTEN
    identifier = lower(raw, body + CAN_ID_OFFSET)
    limit = MAX_EXTENDED_ID | EXTENDED_FLAG if identifier & EXTENDED_FLAG else MAX_STANDARD_ID
    if identifier > limit:
        return BROKEN
    is_remote = raw[body + layout[REMOTE]] & layout[REMOTE_MASK] != 0
    fd_bits = raw[body + layout[FD]] if layout[FD] >= 0 else 0
    is_fd = fd_bits & layout[FD_MASK] != 0
    count = LENGTH_OF_CODE[raw[body + layout[LENGTH]] & 15]
    count = count if is_fd else min(count, PAYLOAD_BYTES)
    if count > rows.data.shape[1]:
        return TOO_WIDE
    rows.can_id[row] = identifier | (REMOTE_FLAG if is_remote else 0)
    rows.length[row] = count
    rows.flags[row] = TX_FLAG * (raw[body + layout[SENT]] & SENT_BIT)
    if is_fd:
        is_fast, is_passive = fd_bits & layout[BRS_MASK] != 0, fd_bits & layout[ESI_MASK] != 0
        rows.flags[row] |= FD_FLAG | (BRS_FLAG if is_fast else 0) | (ESI_FLAG if is_passive else 0)
    end = raw[body + layout[EXTENSION]] if layout[EXTENSION] >= 0 else 0
    stored = 0 if is_remote else (min(end, size) if end else size) - header - layout[DATA]
    begin, count = body + layout[DATA], max(min(stored, count), 0)
    for index in range(rows.data.shape[1]):
        rows.data[row, index] = raw[begin + index] if index < count else 0
    return WRITTEN


@part
def _time_ns(raw: UInt8Array, at: int, start_ns: int) -> int:
    """Return the time of an object since the epoch, rounded to microseconds; -1 if there can be no such time."""
    count, longest_ns = np.int64(word(raw, at + TIME_OFFSET)), LAST_NS - start_ns
    if lower(raw, at + FLAGS_OFFSET) == TEN_MICROSECONDS:
        if count < 0 or count > longest_ns // NS_PER_TEN_US:
            return -1
        count *= NS_PER_TEN_US
    if count < 0 or count > longest_ns:
        return -1
    return int((start_ns + count + NS_PER_US // 2) // NS_PER_US * NS_PER_US)


MAGIC = b"LOGG"
FILE_HEADER = struct.Struct("<4sL8BQQLL8H8H")
FILE_SIZE_FIELD = 10
START_FIELDS = slice(14, 22)  # SYSTEMTIME: year, month, day of week, day, hour, minute, second, millisecond
CONTAINER_HEADER = struct.Struct("<H6xL4x")  # compression, inflated size
FRAMES_PER_BATCH = 65_536
FRAMES_PER_CONTAINER = 4_096  # in the 128 KiB that writers use, and a little more
LOG_CONTAINER = 10
CONTAINER_OBJECT_BYTES = 16  # of the header of a container; all others have longer ones
STORED, DEFLATED = 0, 2
MAX_CONTAINER_BYTES = 64 * 1024 * 1024  # writers use 128 KiB
SEARCH_BYTES = 1024 * 1024
US_PER_S = 1_000_000
LAST_START_S = 9_000_000_000  # the year 2255: nanoseconds must fit 64 bits
OBJECT_MAGIC = MAGIC_WORD.to_bytes(4, "little")
OBJECT_HEADER = struct.Struct("<4sHHLL")  # magic, header size, header version, object size, object type


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectLayout:
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


MESSAGE = ObjectLayout(length=3, remote=2, remote_mask=0x80, data=8)
FD_MESSAGE = ObjectLayout(
    length=3, remote=2, remote_mask=0x80, fd=13, fd_mask=0x01, brs_mask=0x02, esi_mask=0x04, data=20
)  # fmt: skip
FD_MESSAGE_64 = ObjectLayout(
    length=1, remote=12, remote_mask=0x10, fd=13, fd_mask=0x10, brs_mask=0x20, esi_mask=0x40, data=40, extension=35,
    channel_bytes=1, sent=34,
)  # fmt: skip
ERROR = ObjectLayout(is_error=True, data=2)
FD_ERROR = ObjectLayout(is_error=True, data=1, channel_bytes=1)
LAYOUTS = {1: MESSAGE, 86: MESSAGE, 100: FD_MESSAGE, 101: FD_MESSAGE_64, 2: ERROR, 73: ERROR, 104: FD_ERROR}
ABSENT = ObjectLayout(data=-1)


LAYOUT_TABLE: Int64Array = np.array([astuple(LAYOUTS.get(kind, ABSENT)) for kind in range(MOST_KINDS)], np.int64)


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

    def feed(self, data: bytes | bytearray, *, is_whole: bool = True) -> None:
        """Add the frames of the objects that end in this piece; of one that is not whole the rest is missing.

        Then an object that it begins is forgotten; the next one that can be found goes on.
        """
        raw, report, kept_bytes = np.frombuffer(data, np.uint8), self._report, len(self._tail)
        if kept_bytes:
            if len(self._buffer) < kept_bytes + len(raw):
                self._buffer = np.empty(kept_bytes + len(raw), np.uint8)
            joined = self._buffer[: kept_bytes + len(raw)]
            joined[:kept_bytes], joined[kept_bytes:] = self._tail, raw
            raw = joined
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
        if not is_whole:
            self._tail, report[IS_LOST] = self._tail[:0], True

    def hand_over(self) -> FrameBatch:
        """Return the frames added since the last time."""
        batch = self._frames.batch(len(self))
        self._counts.frames += len(self)
        self._report[ROWS] = 0
        return batch

    def finish(self) -> None:
        """Count an object that the file does not complete."""
        if len(self._tail):
            self._counts.cut_off(f"object {self._report[OBJECTS] + 1}")


def read_blf(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of a BLF file, one batch for several containers.

    Raises SourceError if the file ends inside its own header.
    """
    header = stream.read(FILE_HEADER.size)
    if len(header) < FILE_HEADER.size:
        raise SourceError("the BLF file ends inside its header")
    fields = FILE_HEADER.unpack(header)
    header_bytes = max(int(fields[1]), FILE_HEADER.size)
    size_bytes = stream.seek(0, os.SEEK_END)
    # A writer that was killed left the size of an empty file; one that was cut is shorter than it says.
    stated_bytes = int(fields[FILE_SIZE_FIELD])
    counts.truncated = size_bytes < stated_bytes or stated_bytes <= header_bytes < size_bytes
    objects = ObjectStream(start_us(fields[START_FIELDS]), counts, FRAMES_PER_BATCH + FRAMES_PER_CONTAINER)
    for data, is_whole in containers(stream, header_bytes, size_bytes, counts):
        objects.feed(data, is_whole=is_whole)
        if len(objects) >= FRAMES_PER_BATCH:  # of many containers: long columns are decoded faster
            yield objects.hand_over()
    objects.finish()
    if len(objects):
        yield objects.hand_over()


def start_us(systemtime: tuple[int, ...]) -> int:
    """Return the start of measurement in microseconds since the epoch; 0 if the file does not say."""
    year, month, _, day, hour, minute, second, millisecond = systemtime
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return 0
    start_s = int(start.timestamp())
    return start_s * US_PER_S + millisecond * 1_000 if 0 <= start_s <= LAST_START_S else 0


def containers(
    stream: BinaryIO, position: int, size_bytes: int, counts: LogCounts
) -> Iterator[tuple[bytes | bytearray, bool]]:
    """Yield the inflated contents of each container and whether nothing of it is missing.

    Objects outside containers are passed on as they are.
    """
    is_lost = False
    while (position := next_object(stream, position, size_bytes, None if is_lost else counts)) < size_bytes:
        stream.seek(position)
        header = stream.read(OBJECT_HEADER.size)
        if len(header) < OBJECT_HEADER.size:
            counts.cut_off(f"byte {position}")
            return
        _, header_bytes, _, object_bytes, object_type = OBJECT_HEADER.unpack(header)
        if not OBJECT_HEADER.size <= object_bytes <= MAX_CONTAINER_BYTES:
            counts.reject(LogReject.DAMAGED, f"byte {position}")
            position, is_lost = position + len(OBJECT_MAGIC), True
            continue
        body = stream.read(object_bytes - OBJECT_HEADER.size)
        is_whole = len(body) == object_bytes - OBJECT_HEADER.size
        # A container whose type or header size is damaged may still inflate to what its checksum confirms.
        is_container = object_type == LOG_CONTAINER or header_bytes == CONTAINER_OBJECT_BYTES
        is_sound = (object_type == LOG_CONTAINER) == (header_bytes == CONTAINER_OBJECT_BYTES)
        if is_container:
            contents = inflate(body, is_whole=is_whole)
        else:
            contents = ContainerContents(header + body, is_sound=True, used_bytes=len(body))
        if not is_whole:
            counts.cut_off(f"byte {position}")
        elif not (contents.is_sound and is_sound):
            counts.reject(LogReject.DAMAGED, f"byte {position}")
        # The size of a damaged container may be wrong: look for the next one inside it.
        is_lost = not (is_whole and contents.is_sound)
        yield contents.data, not is_lost
        position += len(header) + contents.used_bytes if is_lost else object_bytes


def next_object(stream: BinaryIO, position: int, size_bytes: int, counts: LogCounts | None) -> int:
    """Return where the next object begins, ``size_bytes`` if there is none; count what had to be stepped over."""
    start, block_bytes = position, LONGEST_PADDING + len(OBJECT_MAGIC)  # as a rule it is near
    while True:
        stream.seek(position)
        block = stream.read(block_bytes)
        offset = block.find(OBJECT_MAGIC)
        if offset >= 0 or len(block) <= len(OBJECT_MAGIC):  # the end; the file may have shrunk
            break
        position += len(block) - len(OBJECT_MAGIC) + 1
        block_bytes = SEARCH_BYTES
    position = position + offset if offset >= 0 else size_bytes
    if counts is not None and position - start > LONGEST_PADDING:
        counts.reject(LogReject.DAMAGED, f"byte {start}")
    return position


class ContainerContents(NamedTuple):
    """What a container holds."""

    data: bytes | bytearray
    is_sound: bool  # all of it, and the container holds nothing else
    used_bytes: int  # of the container's body; what follows was not looked at


NOTHING = ContainerContents(b"", is_sound=False, used_bytes=0)


def inflate(body: bytes, *, is_whole: bool) -> ContainerContents:
    """Return what a container holds.

    A container that the end of the file cuts gives its beginning. One with wrong bytes inside gives nothing: where
    they are is not known, and what they inflate to could pass for frames.
    """
    if len(body) < CONTAINER_HEADER.size:
        return NOTHING
    method, stated_bytes = CONTAINER_HEADER.unpack_from(body)
    payload = memoryview(body)[CONTAINER_HEADER.size :]
    if method == STORED:
        stored = bytes(payload[:stated_bytes])
        is_sound = stated_bytes <= len(payload) <= stated_bytes + LONGEST_PADDING
        return ContainerContents(stored, is_sound, CONTAINER_HEADER.size + len(stored))
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(payload, MAX_CONTAINER_BYTES)
    except zlib.error:
        return NOTHING
    # Without its end the checksum was not compared; with more left it is too large for a container.
    if method != DEFLATED or (not inflater.eof and (is_whole or inflater.unconsumed_tail)):
        return NOTHING
    foreign_bytes = len(inflater.unused_data)
    return ContainerContents(data, inflater.eof and foreign_bytes <= LONGEST_PADDING, len(body) - foreign_bytes)
