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
from canlog.jit import kernel, part
from canlog.logs.asc import is_word
from canlog.logs.columns import fields
from canlog.logs.columns.fields import NO_TIME
from canlog.logs.columns.roles import BLANKS, EVENT, HEXADECIMAL, Program, Role
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_kernels import (
    BLANK,
    FRAME,
    HEX_VALUE,
    IS_LENGTH,
    LENGTH_OF_CODE,
    LINES,
    MALFORMED,
    NEWLINE,
    OTHER,
    POSITION,
    ROWS,
    SKIPPED,
    STOP,
    TOO_LONG,
    count_line,
    decimal,
    digits,
    skip_blanks,
    skip_line,
    skip_word,
)

TIME_US, ID, MEANING, LENGTH, CHANNEL, COUNT, FIELDS = range(7)  # what has been read of a line
UNKNOWN = -1

# The clock of a file, and how many of its first lines hold no frames.
BASE_US, NOW_US, WRAP_US, LAPS_US, IS_RELATIVE, HEADER_LINES, CLOCK_FIELDS = range(7)

MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
NS_PER_US = 1_000
HOUR_US = 3_600_000_000
LAST_US = 9_200_000_000_000_000
CODES = len(LENGTH_OF_CODE)
REMOTE_WORD = np.frombuffer(b"remote", np.uint8)
LETTER_R, LETTER_T, LETTER_X = ord("r"), ord("t"), ord("x")
DASH = ord("-")  # in an exact layout, what is not known
BUS_CHANGE_ID = 0xFFFF_FFFF  # how PCAN writes one
EVENT_LETTERS = 3
EXTENDED_BIT = 0x1  # of the type of a frame, as CLX000 loggers write it


@kernel
def parse_lines(
    text: UInt8Array, rows: FrameRows, program: Program, clock: Int64Array, line: Int64Array, progress: Int64Array
) -> None:
    """Parse lines from where the progress says, of an exact layout up to a comment.

    ``line`` is room for the fields of one, shape (FIELDS,).
    """
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
            outcome = _store(rows, row, program, clock, line)
            row += outcome == FRAME
        elif outcome == SKIPPED and clock[IS_RELATIVE]:
            clock[NOW_US] += line[TIME_US]  # of an event
        number += 1
        count_line(progress, outcome, number)
        at = end
    progress[POSITION], progress[LINES], progress[ROWS] = at, number, row


@part
def _parse_line(
    text: UInt8Array, at: int, data: UInt8Array, row: int, program: Program, line: Int64Array
) -> tuple[int, int]:
    """Read the fields of one line; return the outcome and the position behind the line."""
    line[:] = UNKNOWN
    line[MEANING] = line[COUNT] = line[TIME_US] = 0
    separator = program.separator
    at = fields.skip_margin(text, at, separator)
    if text[at] == NEWLINE or program.is_comment[text[at]]:
        is_read = program.is_exact and text[at] != NEWLINE
        return (OTHER if is_read else SKIPPED), skip_line(text, at)
    column, last = 0, len(program.columns) - 1
    while True:
        if program.is_exact and line[MEANING] & ERROR_FLAG:
            column = _column_of(text, at, column, program, line)
        is_data = program.is_exact and column == last and program.columns[last, 0] == Role.DATA
        if is_data:
            is_read, at = _read_exact_data(text, at, data, row, program.columns[last, 1], program, line)
        else:
            begin, stop, at = fields.field(text, at, separator)
            role, parameter = _role_of(column, stop > begin, program, line)
            if program.is_exact:
                is_read = _read_exact_field(text, begin, stop, role, parameter, data, row, program, line)
            else:
                is_read = _read_field(text, begin, stop, role, parameter, data, row, program, line)
            column += 1
        if not is_read:
            is_too_long = data.shape[1] < line[COUNT] <= FD_PAYLOAD_BYTES
            return (TOO_LONG if is_too_long else MALFORMED), skip_line(text, at)
        if line[MEANING] & EVENT:
            return SKIPPED, skip_line(text, at)
        if text[at] == NEWLINE:
            break
        at += separator != BLANKS
        if separator == BLANKS and text[at] == NEWLINE:
            break
    return _check(column, program, line), at + 1


@part
def _role_of(
    column: int,
    has_text: bool,  # noqa: FBT001 - of a kernel
    program: Program,
    line: Int64Array,
) -> tuple[int, int]:
    """Return what a field is, and the parameter of that; -1 if there may be none in its place."""
    last = len(program.columns) - 1
    role, parameter = program.columns[min(column, last), 0], program.columns[min(column, last), 1]
    is_full = 0 <= line[LENGTH] <= min(line[COUNT], PAYLOAD_BYTES)
    if column <= last:
        return (Role.IGNORED if role == Role.BYTE and is_full else role), parameter  # a label where bytes would be
    if not has_text:
        return Role.IGNORED, 0
    if program.is_exact:
        return -1, 0
    if role != Role.DATA:
        return (Role.IGNORED if role == Role.BYTE else -1), 0
    return (Role.IGNORED if is_full else Role.BYTE), parameter  # a comment, or bytes of one column, spread over others


@part
def _column_of(text: UInt8Array, begin: int, column: int, program: Program, line: Int64Array) -> int:
    """Return which column a field is that begins here: one that error frames lack is passed over."""
    while column < len(program.columns) and _is_left_out(text, begin, program.columns[column, 0], line):
        column += 1
    return column


@part
def _is_left_out(text: UInt8Array, begin: int, role: int, line: Int64Array) -> bool:
    """Return whether an error frame has no such column: TRC 2.0 leaves out its identifier and its length."""
    letter = text[begin] | 32
    is_direction = (letter == LETTER_R or letter == LETTER_T) and text[begin + 1] | 32 == LETTER_X  # noqa: PLR1714, SIM109 - no tuple in a kernel
    if role == Role.ID and is_direction:
        line[ID] = line[LENGTH] = 0
        return True
    return bool(role == Role.LENGTH and line[LENGTH] == 0)


@part
def _read_exact_field(  # noqa: C901, PLR0911 - one for each role
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
    """Read one field of an exact layout; return whether it is as its role must be."""
    if role == Role.BASE64:
        line[COUNT], at = fields.base64_bytes(text, begin, row, data)
        return at == stop
    if stop == begin:
        return role == Role.IGNORED or role == Role.DIRECTION  # noqa: PLR1714 - no tuple in a kernel
    if role == Role.WORD:
        return _read_word(text, begin, stop, parameter, program.words, line)
    if role == Role.CLOCK:
        line[TIME_US], at = fields.counted_clock_us(text, begin, parameter)
        return at == stop
    if role == Role.DIRECTION:
        line[MEANING] |= TX_FLAG if (text[begin] | 32) == LETTER_T else 0
        return True
    if Role.EXTENDED <= role < Role.DIRECTION:
        line[MEANING] |= fields.MEANING_OF_ROLE[role] if fields.is_on(text, begin, stop, role) else 0
        return fields.is_switch(text, begin, stop)
    if role == Role.TIME:
        line[TIME_US] = fields.decimal_us_of(text, begin, stop, parameter)
        return bool(line[TIME_US] != NO_TIME)
    is_number = role == Role.CHANNEL or role == Role.LENGTH or role == Role.LENGTH_CODE  # noqa: PLR1714
    if (is_number or role == Role.ID) and text[begin] == DASH and stop == begin + 1:
        return True
    if is_number:
        value = fields.small_number(text, begin, stop)
        if role == Role.LENGTH_CODE and 0 <= value < CODES:
            value = LENGTH_OF_CODE[value] if line[MEANING] & FD_FLAG else min(value, PAYLOAD_BYTES)
        elif role == Role.LENGTH_CODE:
            return False
        line[CHANNEL if role == Role.CHANNEL else LENGTH] = value
        return value >= 0
    if role == Role.ID:
        return _read_exact_id(text, begin, stop, parameter, program.extended_digits, line)
    return role == Role.IGNORED


@part
def _read_exact_id(text: UInt8Array, begin: int, stop: int, base: int, extended_digits: int, line: Int64Array) -> bool:
    """Read a decimal identifier, or one of up to eight hexadecimal digits, perhaps behind 0x."""
    if base != HEXADECIMAL:
        line[ID], at = decimal(text, begin, fields.MOST_ID_DIGITS)
        return at == stop
    begin += 2 * (stop > begin + 2 and text[begin] == fields.ZERO and (text[begin + 1] | 32) == LETTER_X)
    line[ID] = fields.hexadecimal_field(text, begin, stop)
    if 0 < extended_digits <= stop - begin:
        line[MEANING] |= EXTENDED_FLAG | (EVENT if line[ID] == BUS_CHANGE_ID else 0)
    return bool(line[ID] >= 0)


@part
def _read_word(text: UInt8Array, at: int, stop: int, initial: int, words: Int64Array, line: Int64Array) -> bool:
    """Read a word of the layout, behind a channel of one digit if there is one; return whether it is known."""
    if 48 <= text[at] <= 57:
        line[CHANNEL] = text[at] - 48
        at += 1
    packed, behind = fields.word(text, at)
    meaning = fields.meaning_of(packed, words)
    if meaning < 0 and initial and (text[at] | 32) == initial and behind - at == EVENT_LETTERS:
        meaning = EVENT
    line[MEANING] |= max(meaning, 0)
    return bool(meaning >= 0 and behind == stop)


@part
def _read_exact_data(
    text: UInt8Array, at: int, data: UInt8Array, row: int, base: int, program: Program, line: Int64Array
) -> tuple[bool, int]:
    """Read bytes to the end of the line, before them perhaps a word; return whether that is all, and how far it went.

    A hexadecimal byte has two digits; between separators also one, or none where a column is empty.
    """
    at, is_blank = skip_blanks(text, at), program.separator == BLANKS
    is_word = text[at] > BLANK and (HEX_VALUE[text[at]] < 0 or HEX_VALUE[text[at + 1]] < 0)
    if is_word and is_blank and base == HEXADECIMAL:
        stop = skip_word(text, at)
        if not _read_word(text, at, stop, 0, program.words, line):
            return False, at
        at = skip_blanks(text, stop)
    width = data.shape[1]
    while text[at] != NEWLINE:
        begin = at
        value, stop = digits(text, begin, base, 2 if base == HEXADECIMAL else 3)
        at, count = skip_blanks(text, stop), line[COUNT]
        if is_blank:
            is_byte = stop > begin + (base == HEXADECIMAL) and (at > stop or text[at] == NEWLINE)
        else:
            is_byte = text[at] == program.separator or (stop > begin and text[at] == NEWLINE)
            at += text[at] == program.separator
        if not is_byte or value > 255:
            return False, begin
        if stop > begin:
            if count < width:
                data[row, count] = value
            line[COUNT] = count + 1
            if count >= width and (count >= FD_PAYLOAD_BYTES or line[LENGTH] != width):
                return False, begin
    return True, at


@part
def _read_field(  # noqa: PLR0911 - one for each role
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
        line[ID] = fields.identifier(text, begin, stop, parameter, line, MEANING, program.extended_digits)
        return bool(line[ID] >= 0 or stop == begin)  # of an error frame
    if role == Role.DATA or role == Role.BYTE:  # noqa: PLR1714 - no tuple in a kernel
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
    if Role.EXTENDED <= role <= Role.DIRECTION:
        line[MEANING] |= fields.MEANING_OF_ROLE[role] if fields.is_on(text, begin, stop, role) else 0
        return True
    return False


@part
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
    line[COUNT] = fields.data_bytes(text, begin, stop, base, data, row, line[COUNT], role != Role.DATA)
    return bool(0 <= line[COUNT] <= data.shape[1])


@part
def _read_flags(text: UInt8Array, begin: int, stop: int, sent_bit: int, line: Int64Array) -> bool:
    """Read the type of a frame: whether its identifier is an extended one, and whether it was sent."""
    bits = fields.hexadecimal_field(text, begin, stop)
    if bits < 0:
        return False
    line[MEANING] |= EXTENDED_FLAG if bits & EXTENDED_BIT else 0
    line[MEANING] |= TX_FLAG if bits & sent_bit else 0
    return True


@part
def _check(column: int, program: Program, line: Int64Array) -> int:
    """Return whether so many columns were enough, and their bytes those that the line speaks of."""
    width = len(program.columns)
    if program.is_exact:
        last = program.columns[width - 1, 0]
        width -= last == Role.DATA or last == Role.BASE64  # noqa: PLR1714 - no tuple in a kernel
        return _check_exact_length(line, program.is_padded) if column >= width else MALFORMED
    return _check_length(line)


@part
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


@part
def _check_exact_length(line: Int64Array, is_padded: bool) -> int:  # noqa: FBT001 - of a kernel
    """Return whether there are as many bytes as the line says."""
    count = line[COUNT]
    has_payload = not line[MEANING] & (REMOTE_FLAG | ERROR_FLAG)
    if line[LENGTH] < 0:
        line[LENGTH] = count
    if has_payload and (count < line[LENGTH] or (count > line[LENGTH] and not is_padded)):
        return MALFORMED
    line[COUNT] = count if has_payload else 0
    return FRAME if line[LENGTH] <= FD_PAYLOAD_BYTES and IS_LENGTH[line[LENGTH]] else MALFORMED


@part
def _store(rows: FrameRows, row: int, program: Program, clock: Int64Array, line: Int64Array) -> int:
    """Write the fields of a line into a row; return whether they make a frame."""
    meaning, identifier, length = line[MEANING], line[ID], line[LENGTH]
    if meaning & ERROR_FLAG:
        identifier, length, meaning = ERROR_FLAG, 0, meaning & ~(EXTENDED_FLAG | REMOTE_FLAG)
    elif identifier < 0 or identifier > MAX_EXTENDED_ID:
        return MALFORMED
    elif identifier > MAX_STANDARD_ID:
        if program.is_exact and not meaning & EXTENDED_FLAG:
            return MALFORMED
        meaning |= EXTENDED_FLAG
    if program.is_exact and clock[WRAP_US] > 0 and line[TIME_US] >= clock[WRAP_US]:
        return MALFORMED
    time_us = _advance(clock, line[TIME_US], program.is_exact)
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


@part
def _advance(clock: Int64Array, time_us: int, is_exact: bool) -> int:  # noqa: FBT001 - of a kernel
    """Return the time since the epoch; a clock that begins again goes on where it ended."""
    if clock[IS_RELATIVE]:
        clock[NOW_US] += time_us
        return int(clock[BASE_US] + clock[NOW_US])
    wrap_us = clock[WRAP_US]
    if wrap_us > 0 and is_exact:  # only about midnight may it begin again; anywhere else it jumped
        clock[LAPS_US] += wrap_us if time_us < HOUR_US and clock[NOW_US] >= wrap_us - HOUR_US else 0
        clock[NOW_US] = time_us
    elif wrap_us > 0:
        if time_us + wrap_us // 2 < clock[NOW_US]:
            clock[LAPS_US] += wrap_us
        elif time_us > clock[NOW_US] + wrap_us // 2 and clock[LAPS_US] > 0:
            return int(
                clock[BASE_US] + clock[LAPS_US] - wrap_us + time_us
            )  # a frame that came late, from before the lap
        clock[NOW_US] = time_us
    return int(clock[BASE_US] + clock[LAPS_US] + time_us)
