"""The compiled reader of tables: one line is split at its separators, and each field is read by its role."""

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
)
from canlog.jit import array_kernel, inlined_kernel
from canlog.logs.asc_fields import is_word
from canlog.logs.columns import fields
from canlog.logs.columns.message_kernel import (
    BASE_US,
    CHANNEL,
    COUNT,
    HEADER_LINES,
    ID,
    LAPS_US,
    LENGTH,
    MEANING,
    MESSAGE,
    MOST_MESSAGE_BYTES,
    NOW_US,
    SEEN,
    TIME_US,
    UNKNOWN,
    WRAP_US,
    check_message,
    read_part,
    store_message,
)
from canlog.logs.columns.roles import BLANKS, Program, Role
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.tables.fields import NO_TIME
from canlog.logs.text_kernels import (
    FRAME,
    IS_LENGTH,
    LENGTH_OF_CODE,
    LINES,
    MALFORMED,
    NEWLINE,
    POSITION,
    ROWS,
    SKIPPED,
    STOP,
    TOO_LONG,
    count_line,
    skip_line,
)

MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
NS_PER_US = 1_000
LAST_US = 9_200_000_000_000_000
CODES = len(LENGTH_OF_CODE)
REMOTE_WORD = np.frombuffer(b"remote", np.uint8)
LETTER_B, LETTER_E, LETTER_F, LETTER_R, LETTER_X = ord("b"), ord("e"), ord("f"), ord("r"), ord("x")
CARBUS_EXTENDED, CARBUS_REMOTE, CARBUS_FD, CARBUS_FAST = 0x1, 0x2, 0x10, 0x20


@array_kernel
def parse_lines(
    text: UInt8Array, rows: FrameRows, program: Program, clock: Int64Array, line: Int64Array, progress: Int64Array
) -> None:
    """Parse lines from where the progress says; ``line`` is room for the fields of one, shape (FIELDS,)."""
    at, number, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        if clock[HEADER_LINES] > 0:
            clock[HEADER_LINES] -= 1
            outcome, end = SKIPPED, skip_line(text, at)
        else:
            outcome, end = _parse_line(text, at, rows.data, row, program, line)
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        if outcome == FRAME:
            outcome = _store(rows, row, clock, line)
            if outcome == FRAME and program.has_messages:
                row += store_message(rows, row, clock, line)
            row += outcome == FRAME
        number += 1
        count_line(progress, outcome, number)
        at = end
    progress[POSITION], progress[LINES], progress[ROWS] = at, number, row


@array_kernel
def _parse_line(
    text: UInt8Array, at: int, data: UInt8Array, row: int, program: Program, line: Int64Array
) -> tuple[int, int]:
    """Read the fields of one line; return the outcome and the position behind the line."""
    line[:MESSAGE] = UNKNOWN
    line[MEANING] = line[COUNT] = line[TIME_US] = 0
    separator = program.separator
    at = fields.skip_margin(text, at, separator)
    if text[at] == NEWLINE or program.is_comment[text[at]]:
        return SKIPPED, skip_line(text, at)
    width = len(program.columns)
    column = 0
    while True:
        begin, stop, at = fields.field(text, at, separator)
        if program.is_spread:
            column = _column_of(text[begin], column, program, line)
        role, parameter = _role_of(column, stop > begin, program, line)
        if not _read_field(text, begin, stop, role, parameter, data, row, program, line):
            is_too_long = data.shape[1] < line[COUNT] <= FD_PAYLOAD_BYTES
            return (TOO_LONG if is_too_long else MALFORMED), skip_line(text, at)
        column += role != Role.COUNTED or line[COUNT] >= line[LENGTH]
        if text[at] == NEWLINE:
            break
        at += separator != BLANKS
        if separator == BLANKS and text[at] == NEWLINE:
            break
    if program.is_spread and column < width:
        return MALFORMED, at + 1
    return (check_message(line) if program.has_messages else _check_length(line)), at + 1


@inlined_kernel
def _role_of(
    column: int,
    has_text: bool,  # noqa: FBT001 - of a kernel
    program: Program,
    line: Int64Array,
) -> tuple[int, int]:
    """Return what a field is, and the parameter of that; -1 if there may be none in its place."""
    last = len(program.columns) - 1
    role, parameter = program.columns[min(column, last), 0], program.columns[min(column, last), 1]
    is_full = 0 <= line[LENGTH] <= line[COUNT] and (program.separator == BLANKS or line[LENGTH] <= PAYLOAD_BYTES)
    if column <= last:
        return (Role.IGNORED if role == Role.BYTE and is_full else role), parameter  # a label where bytes would be
    if not has_text:
        return Role.IGNORED, 0
    if role == Role.MESSAGE:
        return (Role.IGNORED if is_full and program.separator == BLANKS else Role.MESSAGE), parameter
    if role != Role.DATA:
        return (Role.IGNORED if role == Role.BYTE or parameter == fields.REST else -1), 0
    return (Role.IGNORED if is_full else Role.BYTE), parameter  # a comment, or bytes of one column, spread over others


@array_kernel
def _column_of(first: int, column: int, program: Program, line: Int64Array) -> int:
    """Return which column a field is that begins so: one that may be missing is passed over."""
    while column < len(program.columns):
        role = program.columns[column, 0]
        is_bare = line[MEANING] & (ERROR_FLAG | REMOTE_FLAG) != 0 or line[LENGTH] == 0
        is_missing = role == Role.MARKS and 48 <= first <= 57
        is_missing = is_missing or (role == Role.LENGTH and line[MEANING] & ERROR_FLAG != 0)
        if not is_missing and not (role == Role.COUNTED and is_bare):
            break
        column += 1
    return column


@array_kernel
def _read_field(  # noqa: C901, PLR0911 - one for each role
    text: UInt8Array,
    begin: int,
    stop: int,
    role: int,
    parameter: int,
    data: UInt8Array,
    row: int,
    program: Program,
    line: Int64Array,
) -> bool:
    """Read one field; return whether it fits its role."""
    if role == Role.IGNORED:
        return True
    if role == Role.TIME:
        line[TIME_US] = fields.time_us(text, begin, stop, parameter, program.has_decimal_comma)
        return bool(line[TIME_US] != NO_TIME)
    if role == Role.ID:
        line[ID] = fields.identifier(text, begin, stop, parameter, line, MEANING, program.tells_by_digits)
        return bool(line[ID] >= 0 or stop == begin)  # of an error frame
    if role == Role.DATA or role == Role.BYTE or role == Role.COUNTED or role == Role.MESSAGE:  # noqa: PLR1714 - no tuple
        return _read_bytes(text, begin, stop, role, parameter, data, row, program, line)
    if role == Role.LENGTH:
        line[LENGTH] = fields.small_number(text, begin, stop)
        return bool(line[LENGTH] >= 0 or stop == begin)
    if role == Role.CHANNEL:
        line[CHANNEL] = fields.channel(text, begin, stop, program.channel_names)
        return True
    if role == Role.FLAGS:
        return _read_flags(text, begin, stop, parameter, line)
    if role == Role.STAMP:
        line[TIME_US] = fields.stamp_us(text, begin, stop, parameter)
        return bool(line[TIME_US] != NO_TIME)
    if Role.PRIORITY <= role <= Role.ADDRESSES:
        return read_part(text, begin, stop, role, parameter, line)
    if role == Role.MARKS:
        return _read_marks(text, begin, stop, line)
    if Role.EXTENDED <= role <= Role.DIRECTION:
        line[MEANING] |= _meaning(role) if fields.is_on(text, begin, stop, role) else 0
        return True
    return False


@inlined_kernel
def _read_bytes(
    text: UInt8Array,
    begin: int,
    stop: int,
    role: int,
    base: int,
    data: UInt8Array,
    row: int,
    program: Program,
    line: Int64Array,
) -> bool:
    """Read bytes to those that are there; return whether they fit."""
    if role == Role.DATA and is_word(text, begin, REMOTE_WORD):  # "Remote request DLC = 8", as IXXAT writes it
        line[MEANING] |= REMOTE_FLAG
        line[LENGTH] = max(line[LENGTH], fields.channel(text, begin, stop, program.channel_names[:0]))
        return True
    if role == Role.MESSAGE:
        message = line[MESSAGE:SEEN].reshape(1, -1)
        is_one = program.separator != BLANKS
        line[COUNT] = fields.data_bytes(text, begin, stop, base, message, 0, line[COUNT], is_one)
        return bool(0 <= line[COUNT] <= MOST_MESSAGE_BYTES)
    line[COUNT] = fields.data_bytes(text, begin, stop, base, data, row, line[COUNT], role != Role.DATA)
    return bool(0 <= line[COUNT] <= data.shape[1])


@array_kernel
def _meaning(role: int) -> int:
    """Return what a switch of this role says about a frame: flags of its identifier and its own."""
    if role == Role.EXTENDED:
        return EXTENDED_FLAG
    if role == Role.REMOTE:
        return REMOTE_FLAG
    if role == Role.ERROR:
        return ERROR_FLAG
    if role == Role.BIT_RATE_SWITCH:
        return BRS_FLAG
    if role == Role.ERROR_STATE:
        return ESI_FLAG
    return TX_FLAG if role == Role.DIRECTION else FD_FLAG


@array_kernel
def _read_marks(text: UInt8Array, begin: int, stop: int, line: Int64Array) -> bool:
    """Read what CanKing says of a frame: letters, or that it is an error frame."""
    if (text[begin] | 32) == LETTER_E:
        line[MEANING] |= ERROR_FLAG
        return True
    for at in range(begin, stop):
        letter = text[at] | 32
        line[MEANING] |= EXTENDED_FLAG if letter == LETTER_X else 0
        line[MEANING] |= REMOTE_FLAG if letter == LETTER_R else 0
        line[MEANING] |= FD_FLAG if letter == LETTER_F else 0
        line[MEANING] |= BRS_FLAG if letter == LETTER_B else 0
        if not 97 <= letter <= 122:
            return False
    return True


@array_kernel
def _read_flags(text: UInt8Array, begin: int, stop: int, sent_bit: int, line: Int64Array) -> bool:
    """Read the bits that CARBUS Analyzer writes of a frame, and one that says that it was sent."""
    bits = fields.hexadecimal_field(text, begin, stop)
    if bits < 0:
        return False
    line[MEANING] |= EXTENDED_FLAG if bits & CARBUS_EXTENDED else 0
    line[MEANING] |= REMOTE_FLAG if bits & CARBUS_REMOTE else 0
    line[MEANING] |= TX_FLAG if bits & sent_bit else 0
    line[MEANING] |= FD_FLAG if bits & CARBUS_FD else 0
    line[MEANING] |= BRS_FLAG if bits & CARBUS_FD and bits & CARBUS_FAST else 0
    return True


@array_kernel
def _check_length(line: Int64Array) -> int:
    """Return whether the bytes that were found are those that the line speaks of; more may stand behind them."""
    count, length = line[COUNT], line[LENGTH]
    if length > PAYLOAD_BYTES and length < CODES and count == LENGTH_OF_CODE[length]:
        length = count  # it was the code for so many
    if length < 0:
        length = count
    has_payload = not line[MEANING] & (REMOTE_FLAG | ERROR_FLAG)
    if length > FD_PAYLOAD_BYTES or not IS_LENGTH[length] or (has_payload and count < length):
        return MALFORMED
    if not has_payload and length > PAYLOAD_BYTES:
        return MALFORMED
    line[LENGTH] = length
    line[COUNT] = min(count, length) if has_payload else 0
    return FRAME


@array_kernel
def _store(rows: FrameRows, row: int, clock: Int64Array, line: Int64Array) -> int:
    """Write the fields of a line into a row; return whether they make a frame."""
    meaning, identifier, length = line[MEANING], line[ID], line[LENGTH]
    if meaning & ERROR_FLAG:
        identifier, length, meaning = ERROR_FLAG, 0, meaning & ~(EXTENDED_FLAG | REMOTE_FLAG)
    elif identifier < 0 or identifier > MAX_EXTENDED_ID:
        return MALFORMED
    elif identifier > MAX_STANDARD_ID:
        meaning |= EXTENDED_FLAG
    time_us = _advance(clock, line[TIME_US])
    if not -LAST_US <= time_us <= LAST_US:
        return MALFORMED
    rows.t_ns[row] = time_us * NS_PER_US
    rows.can_id[row] = np.uint32(identifier | meaning & (EXTENDED_FLAG | REMOTE_FLAG))
    rows.length[row], rows.channel[row] = length, max(line[CHANNEL], 0)
    is_fd = meaning & FD_FLAG or length > PAYLOAD_BYTES
    is_fd = is_fd and not meaning & (REMOTE_FLAG | ERROR_FLAG) and identifier != ERROR_FLAG
    rows.flags[row] = FD_FLAG | meaning & (BRS_FLAG | ESI_FLAG | TX_FLAG) if is_fd else meaning & TX_FLAG
    rows.data[row, min(length, line[COUNT]) :] = 0
    return FRAME


@array_kernel
def _advance(clock: Int64Array, time_us: int) -> int:
    """Return the time since the epoch; a clock that begins again goes on where it ended."""
    wrap_us = clock[WRAP_US]
    if wrap_us > 0:
        if time_us + wrap_us // 2 < clock[NOW_US]:
            clock[LAPS_US] += wrap_us
        elif time_us > clock[NOW_US] + wrap_us // 2 and clock[LAPS_US] > 0:
            return int(
                clock[BASE_US] + clock[LAPS_US] - wrap_us + time_us
            )  # a frame that came late, from before the lap
        clock[NOW_US] = time_us
    return int(clock[BASE_US] + clock[LAPS_US] + time_us)
