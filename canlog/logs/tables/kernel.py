"""The compiled reader of all text tables: it follows a layout, column by column."""

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, REMOTE_FLAG, TX_FLAG
from canlog.jit import array_kernel
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.tables import fields
from canlog.logs.tables.layout import BLANKS, EVENT, Program, Role
from canlog.logs.text_kernels import (
    BLANK,
    FRAME,
    HEX_VALUE,
    IS_LENGTH,
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
    skip_blanks,
    skip_line,
)

# What has been read of a line.
TIME_US, ID, MEANING, LENGTH, CHANNEL, COUNT, FIELDS = range(7)
UNKNOWN = -1

# The clock of a file.
BASE_US, NOW_US, MODE, CLOCK_FIELDS = range(4)
ABSOLUTE, RELATIVE, DAYTIME = range(3)
DAY_US = 86_400_000_000
HOUR_US = 3_600_000_000
LAST_US = 9_200_000_000_000_000

NS_PER_US = 1_000
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
BUS_CHANGE_ID = 0xFFFF_FFFF  # how PCAN writes one
FRAME_FLAGS = 0xFF  # of a meaning, as ``flags`` has them
EVENT_LETTERS = 3
LETTER_R, LETTER_T, LETTER_X = ord("r"), ord("t"), ord("x")


@array_kernel
def parse_lines(
    text: UInt8Array, rows: FrameRows, program: Program, clock: Int64Array, line: Int64Array, progress: Int64Array
) -> None:
    """Parse lines from where the progress says; stop before a comment.

    ``line`` is room for the fields of one line, shape (FIELDS,); ``clock`` is what the times are relative to.
    """
    at, number, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        begin = skip_blanks(text, at)
        is_comment = program.is_comment[text[begin]]
        outcome, end = (OTHER, begin) if is_comment else _parse_line(text, begin, rows.data, row, program, line)
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        if outcome == FRAME:
            outcome = _store(rows, row, clock, line)
            row += outcome == FRAME
        elif outcome == SKIPPED and line[TIME_US] != fields.NO_TIME and clock[MODE] == RELATIVE:
            clock[NOW_US] += line[TIME_US]
        number += 1
        count_line(progress, outcome, number)
        at = end
    progress[POSITION], progress[LINES], progress[ROWS] = at, number, row


@array_kernel
def _parse_line(
    text: UInt8Array, at: int, data: UInt8Array, row: int, program: Program, line: Int64Array
) -> tuple[int, int]:
    """Read the columns of one line; return the outcome and the position behind the line."""
    line[:] = UNKNOWN
    line[MEANING] = 0
    line[TIME_US] = fields.NO_TIME
    if text[at] == NEWLINE:
        return SKIPPED, at + 1
    separator = program.separator
    for column in range(len(program.columns)):
        role, parameter = program.columns[column, 0], program.columns[column, 1]
        if line[MEANING] & ERROR_FLAG and _is_left_out(text, at, role, line):
            continue
        if role == Role.DATA or role == Role.DECIMAL_DATA:  # noqa: PLR1714 - no tuple in a kernel
            at = _read_data(text, at, data, row, role, program, line)
        elif role == Role.BASE64:
            line[COUNT], at = fields.base64_bytes(text, at, row, data)
        elif role == Role.IGNORED or role == Role.DIRECTION:  # noqa: PLR1714
            line[MEANING] |= TX_FLAG * int(role == Role.DIRECTION and (text[at] | 32) == LETTER_T)
            at = fields.skip_field(text, at, separator)
        else:
            at = _read_column(text, at, role, parameter, program.words, line)
        if at < 0:
            return _refusal(data, line), skip_line(text, -at)
        if line[MEANING] & EVENT:
            return SKIPPED, skip_line(text, at)
        at = _next_column(text, at, separator)
        if at < 0:
            return MALFORMED, skip_line(text, -at)
    return (_check_length(line, program.is_padded) if text[at] == NEWLINE else MALFORMED), skip_line(text, at)


@array_kernel
def _refusal(data: UInt8Array, line: Int64Array) -> int:
    """Return why a line was left: it has more bytes than there is room for, or something in it is wrong."""
    return TOO_LONG if data.shape[1] < line[COUNT] <= FD_PAYLOAD_BYTES else MALFORMED


@array_kernel
def _is_left_out(text: UInt8Array, at: int, role: int, line: Int64Array) -> bool:
    """Return whether an error frame has no such column: TRC 2.0 leaves out its identifier and its length."""
    letter = text[at] | 32
    if role == Role.ID and (letter == LETTER_R or letter == LETTER_T) and text[at + 1] | 32 == LETTER_X:  # noqa: PLR1714, SIM109 - no tuple in a kernel
        line[ID] = line[LENGTH] = 0
        return True
    return bool(role == Role.LENGTH and line[LENGTH] == 0)


@array_kernel
def _next_column(text: UInt8Array, at: int, separator: int) -> int:
    """Return where the next column begins, negative if something stands between the two."""
    if text[at] > BLANK and text[at] != separator:
        return -at
    at = skip_blanks(text, at)
    if separator != BLANKS and text[at] == separator:
        at = skip_blanks(text, at + 1)
    return at


@array_kernel
def _read_column(text: UInt8Array, at: int, role: int, parameter: int, words: Int64Array, line: Int64Array) -> int:
    """Read one column that is not data; return the position behind it, negative if it does not fit its role."""
    begin = at
    if role == Role.TIME:
        line[TIME_US], at = fields.decimal_us(text, at, parameter)
    elif role == Role.CLOCK:
        line[TIME_US], at = fields.clock_us(text, at, parameter)
    elif role == Role.ID:
        at = _read_id(text, at, parameter, line)
    elif role == Role.DECIMAL_ID:
        line[ID], at = decimal(text, begin, 10)
    elif role == Role.WORD:
        at = _read_word(text, at, parameter, words, line)
    elif role == Role.SWITCH:
        is_on, at = fields.switch(text, at)
        line[MEANING] |= parameter * is_on
    elif role == Role.CHANNEL:
        line[CHANNEL], at = fields.number(text, at, 255)
    else:
        line[LENGTH], at = fields.number(text, at, FD_PAYLOAD_BYTES)
        if role == Role.LENGTH_CODE and at > 0 and line[LENGTH] >= 0:
            at = fields.decode_length(line, LENGTH, line[MEANING] & FD_FLAG, at)
    return at if at > begin else -max(begin, 1)


@array_kernel
def _read_id(text: UInt8Array, at: int, standard_digits: int, line: Int64Array) -> int:
    """Read an identifier; many digits say that it is an extended one, where the layout says so."""
    value, digits, at = fields.hexadecimal(text, at)
    line[ID] = value
    if standard_digits and digits > standard_digits:
        line[MEANING] |= EXTENDED_FLAG | (EVENT if value == BUS_CHANGE_ID else 0)
    return at


@array_kernel
def _read_word(text: UInt8Array, at: int, initial: int, words: Int64Array, line: Int64Array) -> int:
    """Read a word, behind a channel of one digit if there is one."""
    if 48 <= text[at] <= 57:
        line[CHANNEL] = text[at] - 48
        at += 1
    packed, behind = fields.word(text, at)
    meaning = fields.meaning_of(packed, words)
    if meaning < 0 and initial and (text[at] | 32) == initial and behind - at == EVENT_LETTERS:
        meaning = EVENT
    if meaning < 0:
        return -behind
    line[MEANING] |= meaning
    return behind


@array_kernel
def _read_data(
    text: UInt8Array, at: int, data: UInt8Array, row: int, role: int, program: Program, line: Int64Array
) -> int:
    """Read bytes to the end of the line, before them perhaps a word; return the position of the newline."""
    count = 0
    is_decimal = role == Role.DECIMAL_DATA
    is_word = HEX_VALUE[text[at]] < 0 or HEX_VALUE[text[at + 1]] < 0
    if not is_decimal and program.separator == BLANKS and text[at] > BLANK and is_word:
        packed, at = fields.word(text, at)
        meaning = fields.meaning_of(packed, program.words)
        if meaning < 0:
            return -at
        line[MEANING] |= meaning
        at = skip_blanks(text, at)
    while text[at] != NEWLINE:
        value, behind = fields.decimal_byte(text, at) if is_decimal else fields.byte(text, at, program.separator)
        if value < 0:
            return -behind
        if value != fields.NO_BYTE and count < data.shape[1]:
            data[row, count] = value
        count += value != fields.NO_BYTE
        if count > data.shape[1] and (count > FD_PAYLOAD_BYTES or line[LENGTH] != data.shape[1]):
            line[COUNT] = count
            return -behind
        at = behind
    line[COUNT] = count
    return at


@array_kernel
def _check_length(line: Int64Array, is_padded: int) -> int:
    """Return whether the bytes that were found are those that the line speaks of."""
    count = max(line[COUNT], 0)
    has_payload = not line[MEANING] & (REMOTE_FLAG | ERROR_FLAG)
    if line[LENGTH] < 0:
        line[LENGTH] = count
    if has_payload and (count < line[LENGTH] or (count > line[LENGTH] and not is_padded)):
        return MALFORMED
    if not IS_LENGTH[line[LENGTH]] or line[TIME_US] == fields.NO_TIME:
        return MALFORMED
    if not has_payload:
        line[COUNT] = 0
    return FRAME


@array_kernel
def _store(rows: FrameRows, row: int, clock: Int64Array, line: Int64Array) -> int:
    """Write the fields of a line into a row; return whether they make a frame."""
    meaning, identifier, length = line[MEANING], line[ID], line[LENGTH]
    if meaning & ERROR_FLAG:
        identifier, length, meaning = ERROR_FLAG, 0, meaning & ~EXTENDED_FLAG
    elif identifier < 0 or identifier > (MAX_EXTENDED_ID if meaning & EXTENDED_FLAG else MAX_STANDARD_ID):
        return MALFORMED
    time_us = _advance(clock, line[TIME_US])
    if time_us == fields.NO_TIME:
        return MALFORMED
    rows.t_ns[row] = time_us * NS_PER_US
    rows.can_id[row] = np.uint32(identifier | meaning & (EXTENDED_FLAG | REMOTE_FLAG))
    rows.length[row], rows.channel[row] = length, max(line[CHANNEL], 0)
    # Formats that do not tell FD apart still show it by the length.
    is_fd = meaning & FD_FLAG or length > PAYLOAD_BYTES
    rows.flags[row] = FD_FLAG | meaning & FRAME_FLAGS if is_fd else meaning & TX_FLAG
    rows.data[row, min(length, max(line[COUNT], 0)) :] = 0
    return FRAME


@array_kernel
def _advance(clock: Int64Array, time_us: int) -> int:
    """Return the time since the epoch of a line, NO_TIME if there can be no such time."""
    if clock[MODE] == RELATIVE:
        clock[NOW_US] += time_us
        time_us = clock[NOW_US]
    elif clock[MODE] == DAYTIME:
        if time_us >= DAY_US:
            return fields.NO_TIME
        # Only about midnight may the time of day start again; anywhere else it jumped.
        if time_us < HOUR_US and clock[NOW_US] % DAY_US >= DAY_US - HOUR_US:
            clock[BASE_US] += DAY_US
        clock[NOW_US] = time_us
    time_us += clock[BASE_US]
    return time_us if -LAST_US <= time_us <= LAST_US else fields.NO_TIME
