"""The objects inside BLF containers, compiled: found one by one, frames written into columns."""

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, TX_FLAG
from canlog.jit import array_kernel, inlined_kernel
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_kernels import LENGTH_OF_CODE, half, lower, word

# What has been done, and how it goes on.
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
FIRST_BYTES = np.array([256**count - 1 for count in range(PAYLOAD_BYTES + 1)], np.uint64)  # as masks


@array_kernel
def parse_objects(raw: UInt8Array, layouts: Int64Array, start_ns: int, rows: FrameRows, report: Int64Array) -> None:
    """Go through the objects of a buffer, up to the first that it does not hold whole.

    ``layouts`` has a row per kind of object, with DATA < 0 where a kind holds no frame.
    """
    at, row, objects = report[POSITION], report[ROWS], report[OBJECTS]
    report[IS_TOO_WIDE] = 0
    while True:
        while _usual_message(raw, at, rows, row, start_ns):
            at += USUAL_BYTES
            row += 1
            objects += 1
            report[IS_LOST] = 0
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
            row += outcome == STORED
            if outcome == BROKEN:
                _count_damage(report)
        objects += 1
        at += size
    report[POSITION], report[ROWS] = at, row


STORED, BROKEN, TOO_WIDE = range(3)

# A data frame of CAN as all writers store it: 32 bytes of header, channel, flags, length, identifier and eight bytes.
USUAL_BYTES, USUAL_CHANNEL, USUAL_FLAGS, USUAL_LENGTH, USUAL_ID, USUAL_DATA = 48, 32, 34, 35, 36, 40
USUAL_KINDS = (1, 86)
REMOTE_BIT, SENT_BIT = 0x80, 0x01


@inlined_kernel
def _usual_message(raw: UInt8Array, at: int, rows: FrameRows, row: int, start_ns: int) -> bool:
    """Write the frame of an object of the usual kind into a row; return whether there is one."""
    if at + USUAL_BYTES > raw.size:
        return False
    kind, time_ns = lower(raw, at + KIND_OFFSET), _time_ns(raw, at, start_ns)
    is_message = lower(raw, at) == MAGIC_WORD and (kind == USUAL_KINDS[0] or kind == USUAL_KINDS[1])
    if not is_message or half(raw, at + HEADER_SIZE_OFFSET) != STAMPED_HEADER_BYTES:
        return False
    if lower(raw, at + SIZE_OFFSET) != USUAL_BYTES or time_ns < 0:
        return False
    identifier, count = lower(raw, at + USUAL_ID), np.int64(raw[np.uint64(at + USUAL_LENGTH)])
    bare = identifier & ~EXTENDED_FLAG
    if count > PAYLOAD_BYTES or bare > MAX_EXTENDED_ID or (bare == identifier and bare > MAX_STANDARD_ID):
        return False
    said = raw[np.uint64(at + USUAL_FLAGS)]
    if said & REMOTE_BIT:
        return False
    rows.t_ns[row], rows.can_id[row], rows.length[row] = time_ns, identifier, count
    rows.flags[row], rows.channel[row] = TX_FLAG * (said & SENT_BIT), min(half(raw, at + USUAL_CHANNEL), 255)
    rows.words[row, 0] = word(raw, at + USUAL_DATA) & FIRST_BYTES[count]
    for index in range(1, rows.words.shape[1]):
        rows.words[row, index] = 0
    return True


@inlined_kernel
def _count_damage(report: Int64Array) -> None:
    if report[DAMAGED] == 0:
        report[FIRST_DAMAGED] = report[OBJECTS] + 1
    report[DAMAGED] += 1


@inlined_kernel
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
        size = lower(raw, found + SIZE_OFFSET)
        if HEADER_BYTES <= size <= MAX_OBJECT_BYTES:
            return (found, size) if found + size <= len(raw) else (found, -1)
        _count_damage(report)
        report[IS_LOST] = 1
        at = found + 4


@array_kernel
def _next_object(raw: UInt8Array, at: int) -> int:
    """Return where the next object begins, -1 if there is none."""
    while at + 4 <= len(raw):
        if lower(raw, at) == MAGIC_WORD:
            return at
        at += 1
    return -1


@inlined_kernel
def _frame(raw: UInt8Array, at: int, size: int, layout: Int64Array, rows: FrameRows, row: int, start_ns: int) -> int:
    """Write the frame of an object into a row; return STORED, or why it could not be."""
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
        rows.data[row, :] = 0
        return STORED
    identifier = lower(raw, body + CAN_ID_OFFSET)
    limit = MAX_EXTENDED_ID | EXTENDED_FLAG if identifier & EXTENDED_FLAG else MAX_STANDARD_ID
    if identifier > limit:
        return BROKEN
    is_remote = raw[body + layout[REMOTE]] & layout[REMOTE_MASK] != 0
    said = raw[body + layout[FD]] if layout[FD] >= 0 else 0
    is_fd = said & layout[FD_MASK] != 0
    count = LENGTH_OF_CODE[raw[body + layout[LENGTH]] & 15]
    count = count if is_fd else min(count, PAYLOAD_BYTES)
    if count > rows.data.shape[1]:
        return TOO_WIDE
    rows.can_id[row] = identifier | (REMOTE_FLAG if is_remote else 0)
    rows.length[row] = count
    rows.flags[row] = TX_FLAG * (raw[body + layout[SENT]] & SENT_BIT)
    if is_fd:
        is_fast, is_passive = said & layout[BRS_MASK] != 0, said & layout[ESI_MASK] != 0
        rows.flags[row] |= FD_FLAG | (BRS_FLAG if is_fast else 0) | (ESI_FLAG if is_passive else 0)
    end = raw[body + layout[EXTENSION]] if layout[EXTENSION] >= 0 else 0
    stored = 0 if is_remote else (min(end, size) if end else size) - header - layout[DATA]
    _copy(raw, body + layout[DATA], max(min(stored, count), 0), rows, row)
    return STORED


@inlined_kernel
def _copy(raw: UInt8Array, at: int, count: int, rows: FrameRows, row: int) -> None:
    """Copy a payload into a row that is zero behind it."""
    for index in range(rows.words.shape[1]):
        rows.words[row, index] = 0
    if count <= PAYLOAD_BYTES and at + PAYLOAD_BYTES <= raw.size:  # nearly all there are
        rows.words[row, 0] = word(raw, at) & FIRST_BYTES[count]
        return
    for index in range(count):
        rows.data[row, index] = raw[at + index]


@inlined_kernel
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
