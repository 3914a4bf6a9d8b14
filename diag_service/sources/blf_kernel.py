"""The objects inside BLF containers, compiled: found one by one, frames written into columns."""

import numpy as np

from clutch_model.jit import array_kernel
from diag_service.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
)
from diag_service.records import Int64Array, UInt8Array, UInt32Array

# What has been done, and how it goes on.
POSITION, ROWS, OBJECTS, IS_LOST, SKIPPED, DAMAGED, FIRST_DAMAGED, IS_TOO_WIDE, REPORT_FIELDS = range(9)

# The columns of a layout: where fields are, counted from the end of an object's header; -1: it has none.
DATA, CHANNEL_BYTES, REMOTE, REMOTE_MASK, LENGTH, FD, FD_MASK, BRS_MASK, ESI_MASK, EXTENSION, IS_ERROR = range(11)
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
LENGTH_OF_CODE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.int64)


@array_kernel
def parse_objects(
    raw: UInt8Array,
    layouts: Int64Array,
    start_ns: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    report: Int64Array,
) -> None:
    """Go through the objects of a buffer, up to the first that it does not hold whole.

    ``layouts`` has a row per kind of object, with DATA < 0 where a kind holds no frame.
    """
    at, row = report[POSITION], report[ROWS]
    report[IS_TOO_WIDE] = 0
    while True:
        at, size = _locate(raw, at, report)
        if size < 0:
            break
        kind = _word(raw, at + KIND_OFFSET)
        if kind >= MOST_KINDS:
            _count_damage(report)
        elif layouts[kind, DATA] < 0:
            report[SKIPPED] += 1
        else:
            outcome = _frame(raw, at, size, layouts[kind], row, start_ns, t_ns, can_id, length, flags, channel, data)
            if outcome == TOO_WIDE:
                report[IS_TOO_WIDE] = 1
                break
            row += outcome == TAKEN
            if outcome == BROKEN:
                _count_damage(report)
        report[OBJECTS] += 1
        at += size
    report[POSITION], report[ROWS] = at, row


TAKEN, BROKEN, TOO_WIDE = range(3)


@array_kernel
def _count_damage(report: Int64Array) -> None:
    if report[DAMAGED] == 0:
        report[FIRST_DAMAGED] = report[OBJECTS] + 1
    report[DAMAGED] += 1


@array_kernel
def _locate(raw: UInt8Array, at: int, report: Int64Array) -> tuple[int, int]:
    """Return where the next object is and its size, -1 if the buffer does not hold all of it; count what is damaged."""
    while True:
        found = _next_object(raw, at)
        if found < 0:
            return max(at, len(raw) - 3), -1
        if found - at > LONGEST_PADDING and not report[IS_LOST]:
            _count_damage(report)
        report[IS_LOST] = 0
        if found + HEADER_BYTES > len(raw):
            return found, -1
        size = _word(raw, found + SIZE_OFFSET)
        if HEADER_BYTES <= size <= MAX_OBJECT_BYTES:
            return (found, size) if found + size <= len(raw) else (found, -1)
        _count_damage(report)
        report[IS_LOST] = 1
        at = found + 4


@array_kernel
def _next_object(raw: UInt8Array, at: int) -> int:
    """Return where the next object begins, -1 if there is none."""
    while at + 4 <= len(raw):
        if _word(raw, at) == MAGIC_WORD:
            return at
        at += 1
    return -1


@array_kernel
def _half(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of two bytes."""
    return int(np.int64(raw[at]) | np.int64(raw[at + 1]) << 8)


@array_kernel
def _word(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of four bytes."""
    return int(_half(raw, at) | np.int64(raw[at + 2]) << 16 | np.int64(raw[at + 3]) << 24)


@array_kernel
def _frame(
    raw: UInt8Array,
    at: int,
    size: int,
    layout: Int64Array,
    row: int,
    start_ns: int,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
) -> int:
    """Write the frame of an object into a row; return TAKEN, or why it could not be."""
    header = _half(raw, at + HEADER_SIZE_OFFSET)
    if header < STAMPED_HEADER_BYTES or header > LONGEST_HEADER_BYTES or size < header + layout[DATA]:
        return BROKEN
    time_ns = _time_ns(raw, at, start_ns)
    if time_ns < 0:
        return BROKEN
    body = at + header
    t_ns[row] = time_ns
    channel[row] = min(_half(raw, body), 255) if layout[CHANNEL_BYTES] == 2 else raw[body]
    if layout[IS_ERROR]:
        can_id[row], length[row], flags[row] = ERROR_FLAG, 0, 0
        data[row, :] = 0
        return TAKEN
    identifier = _word(raw, body + CAN_ID_OFFSET)
    limit = MAX_EXTENDED_ID | EXTENDED_FLAG if identifier & EXTENDED_FLAG else MAX_STANDARD_ID
    if identifier > limit:
        return BROKEN
    is_remote = raw[body + layout[REMOTE]] & layout[REMOTE_MASK] != 0
    said = raw[body + layout[FD]] if layout[FD] >= 0 else 0
    is_fd = said & layout[FD_MASK] != 0
    count = LENGTH_OF_CODE[raw[body + layout[LENGTH]] & 15]
    count = count if is_fd else min(count, PAYLOAD_BYTES)
    if count > data.shape[1]:
        return TOO_WIDE
    can_id[row] = identifier | (REMOTE_FLAG if is_remote else 0)
    length[row] = count
    flags[row] = 0
    if is_fd:
        is_fast, is_passive = said & layout[BRS_MASK] != 0, said & layout[ESI_MASK] != 0
        flags[row] = FD_FLAG | (BRS_FLAG if is_fast else 0) | (ESI_FLAG if is_passive else 0)
    end = raw[body + layout[EXTENSION]] if layout[EXTENSION] >= 0 else 0
    stored = 0 if is_remote else (min(end, size) if end else size) - header - layout[DATA]
    _copy(raw, body + layout[DATA], max(min(stored, count), 0), row, data)
    return TAKEN


@array_kernel
def _copy(raw: UInt8Array, at: int, count: int, row: int, data: UInt8Array) -> None:
    """Copy a payload into a row that is zero behind it."""
    if count == PAYLOAD_BYTES and data.shape[1] == PAYLOAD_BYTES:  # nearly all there are
        for index in range(PAYLOAD_BYTES):
            data[row, index] = raw[at + index]
        return
    for index in range(count):
        data[row, index] = raw[at + index]
    for index in range(count, data.shape[1]):
        data[row, index] = 0


@array_kernel
def _time_ns(raw: UInt8Array, at: int, start_ns: int) -> int:
    """Return the time of an object since the epoch, rounded to microseconds; -1 if there can be no such time."""
    is_coarse = _word(raw, at + FLAGS_OFFSET) == TEN_MICROSECONDS
    count = _word(raw, at + TIME_OFFSET) | _word(raw, at + TIME_OFFSET + 4) << 32
    unit = NS_PER_TEN_US if is_coarse else 1
    if count < 0 or count > (LAST_NS - start_ns) // unit:
        return -1
    return (start_ns + count * unit + NS_PER_US // 2) // NS_PER_US * NS_PER_US
