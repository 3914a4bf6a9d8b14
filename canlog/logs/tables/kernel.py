"""The compiled reader of all text tables: it follows a layout, column by column."""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
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
from canlog.jit import array_kernel
from canlog.logs.tables import fields
from canlog.logs.tables.layout import BLANKS, Meaning, Role
from canlog.logs.text_kernels import (
    AT_END,
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
    WIDEN,
    count_lines,
    decimal,
    skip_blanks,
    skip_line,
)

WIDEN_FIRST = 3  # beside the outcomes of a line

# What has been read of a line.
TIME_US, ID, MEANING, LENGTH, CHANNEL, COUNT, FIELDS = range(7)
UNKNOWN = -1

# The clock of a file.
BASE_US, NOW_US, MODE, CLOCK_FIELDS = range(4)
ABSOLUTE, RELATIVE, DAYTIME = range(3)
DAY_US = 86_400_000_000
HOUR_US = 3_600_000_000
LAST_US = 9_200_000_000_000_000

# Options of a layout.
SEPARATOR, IS_PADDED = range(2)

NS_PER_US = 1_000
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF

_TIME, _CLOCK, _CHANNEL, _ID = int(Role.TIME), int(Role.CLOCK), int(Role.CHANNEL), int(Role.ID)
_WORD, _SWITCH, _LENGTH, _LENGTH_CODE = int(Role.WORD), int(Role.SWITCH), int(Role.LENGTH), int(Role.LENGTH_CODE)
_DATA, _BASE64, _IGNORED = int(Role.DATA), int(Role.BASE64), int(Role.IGNORED)
_DECIMAL_ID, _DECIMAL_DATA, _DIRECTION = int(Role.DECIMAL_ID), int(Role.DECIMAL_DATA), int(Role.DIRECTION)
_EXTENDED, _REMOTE, _ERROR, _EVENT = int(Meaning.EXTENDED), int(Meaning.REMOTE), int(Meaning.ERROR), int(Meaning.EVENT)
_FD, _BRS, _ESI = int(Meaning.FD), int(Meaning.BIT_RATE_SWITCH), int(Meaning.ERROR_STATE)
_SENT = int(Meaning.SENT)
LETTER_T = ord("t")


@array_kernel
def parse_lines(
    text: UInt8Array,
    program: Int64Array,
    vocabulary: Int64Array,
    options: Int64Array,
    is_comment: npt.NDArray[np.bool_],
    clock: Int64Array,
    line: Int64Array,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    report: Int64Array,
    outcomes: Int64Array,
    first: Int64Array,
) -> None:
    """Parse lines from where the report says; stop before a comment, and where the arena is too narrow.

    ``line`` is room for the fields of one line, shape (FIELDS,); ``clock`` is what the times are relative to.
    """
    at, number, row = report[POSITION], report[LINES], report[ROWS]
    report[STOP] = AT_END
    while at < len(text):
        begin = skip_blanks(text, at)
        if is_comment[text[begin]]:
            report[STOP] = OTHER
            break
        outcome, end = _parse_line(text, begin, row, program, vocabulary, options, line, data)
        if outcome == WIDEN_FIRST:
            report[STOP] = WIDEN
            break
        if outcome == FRAME:
            outcome = _settle(row, clock, line, t_ns, can_id, length, flags, channel, data)
            row += outcome == FRAME
        elif outcome == SKIPPED and line[TIME_US] != fields.NO_TIME and clock[MODE] == RELATIVE:
            clock[NOW_US] += line[TIME_US]
        number += 1
        count_lines(outcomes, first, outcome, number)
        at = end
    report[POSITION], report[LINES], report[ROWS] = at, number, row


@array_kernel
def _parse_line(
    text: UInt8Array,
    at: int,
    row: int,
    program: Int64Array,
    vocabulary: Int64Array,
    options: Int64Array,
    line: Int64Array,
    data: UInt8Array,
) -> tuple[int, int]:
    """Read the columns of one line; return the outcome and the position behind the line."""
    line[:] = UNKNOWN
    line[MEANING] = 0
    line[TIME_US] = fields.NO_TIME
    if text[at] == NEWLINE:
        return SKIPPED, at + 1
    separator = options[SEPARATOR]
    for column in range(len(program)):
        role, parameter = program[column, 0], program[column, 1]
        if role == _DATA or role == _BASE64 or role == _DECIMAL_DATA:  # noqa: PLR1714, SIM109 - no tuple in a kernel
            at = _read_payload(text, at, row, role, vocabulary, separator, line, data)
        elif role == _IGNORED or role == _DIRECTION:  # noqa: PLR1714, SIM109 - no tuple in a kernel
            line[MEANING] |= _SENT if role == _DIRECTION and (text[at] | 32) == LETTER_T else 0
            at = fields.skip_field(text, at, separator)
        else:
            at = _read_column(text, at, role, parameter, vocabulary, line)
        if at < 0:
            is_too_narrow = data.shape[1] < line[COUNT] <= FD_PAYLOAD_BYTES
            return (WIDEN_FIRST if is_too_narrow else MALFORMED), skip_line(text, -at)
        if line[MEANING] & _EVENT:
            return SKIPPED, skip_line(text, at)
        at = _next_column(text, at, separator)
        if at < 0:
            return MALFORMED, skip_line(text, -at)
    if text[at] != NEWLINE:
        return MALFORMED, skip_line(text, at)
    return _check_length(line, options[IS_PADDED]), at + 1


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
def _read_column(text: UInt8Array, at: int, role: int, parameter: int, vocabulary: Int64Array, line: Int64Array) -> int:
    """Read one column that is not data; return the position behind it, negative if it does not fit its role."""
    begin = at
    if role == _TIME:
        line[TIME_US], at = fields.decimal_us(text, at, parameter)
    elif role == _CLOCK:
        line[TIME_US], at = fields.clock_us(text, at, parameter)
    elif role == _ID:
        at = _read_id(text, at, parameter, line)
    elif role == _DECIMAL_ID:
        line[ID], at = decimal(text, begin, 10)
    elif role == _WORD:
        at = _read_word(text, at, parameter, vocabulary, line)
    elif role == _SWITCH:
        is_on, at = fields.switch(text, at)
        line[MEANING] |= parameter * is_on
    elif role == _CHANNEL:
        line[CHANNEL], at = fields.number(text, at, 255)
    else:
        line[LENGTH], at = fields.number(text, at, FD_PAYLOAD_BYTES)
        if role == _LENGTH_CODE and at > 0 and line[LENGTH] >= 0:
            at = fields.decode_length(line, LENGTH, line[MEANING] & _FD, at)
    return at if at > begin else -max(begin, 1)


@array_kernel
def _read_id(text: UInt8Array, at: int, standard_digits: int, line: Int64Array) -> int:
    """Read an identifier; many digits say that it is an extended one, where the layout says so."""
    value, digits, at = fields.hexadecimal(text, at)
    line[ID] = value
    if standard_digits and digits > standard_digits:
        line[MEANING] |= _EXTENDED
        if value == 0xFFFF_FFFF:  # how PCAN writes a change of the bus
            line[MEANING] |= _EVENT
    return at


@array_kernel
def _read_word(text: UInt8Array, at: int, initial: int, vocabulary: Int64Array, line: Int64Array) -> int:
    """Read a word, behind a channel of one digit if there is one."""
    if 48 <= text[at] <= 57:
        line[CHANNEL] = text[at] - 48
        at += 1
    packed, behind = fields.word(text, at)
    meaning = fields.meaning_of(packed, vocabulary)
    if meaning < 0:
        if initial and (text[at] | 32) == initial:
            meaning = _EVENT
        else:
            return -behind
    line[MEANING] |= meaning
    return behind


@array_kernel
def _read_payload(
    text: UInt8Array,
    at: int,
    row: int,
    role: int,
    vocabulary: Int64Array,
    separator: int,
    line: Int64Array,
    data: UInt8Array,
) -> int:
    """Read the payload of a line; return the position behind it, negative if it is none."""
    if role == _DATA:
        return _read_data(text, at, row, vocabulary, separator, line, data)
    if role == _DECIMAL_DATA:
        return _read_decimal_data(text, at, row, line, data)
    line[COUNT], at = fields.base64_bytes(text, at, row, data)
    return at


@array_kernel
def _read_data(
    text: UInt8Array,
    at: int,
    row: int,
    vocabulary: Int64Array,
    separator: int,
    line: Int64Array,
    data: UInt8Array,
) -> int:
    """Read bytes to the end of the line, before them perhaps a word; return the position of the newline."""
    count = 0
    is_word = separator == BLANKS and text[at] > BLANK and (HEX_VALUE[text[at]] < 0 or HEX_VALUE[text[at + 1]] < 0)
    if is_word:
        packed, at = fields.word(text, at)
        meaning = fields.meaning_of(packed, vocabulary)
        if meaning < 0:
            return -at
        line[MEANING] |= meaning
        at = skip_blanks(text, at)
    while text[at] != NEWLINE:
        value, behind = fields.byte(text, at, separator)
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
def _read_decimal_data(text: UInt8Array, at: int, row: int, line: Int64Array, data: UInt8Array) -> int:
    """Read decimal bytes to the end of the line; as ``_read_data``."""
    count = 0
    while text[at] != NEWLINE:
        value, behind = fields.decimal_byte(text, at)
        if value < 0:
            return -behind
        if count < data.shape[1]:
            data[row, count] = value
        count += 1
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
    has_payload = not line[MEANING] & (_REMOTE | _ERROR)
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
def _settle(
    row: int,
    clock: Int64Array,
    line: Int64Array,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
) -> int:
    """Write the fields of a line into a row; return whether they make a frame."""
    meaning, identifier = line[MEANING], line[ID]
    if meaning & _ERROR:
        identifier = ERROR_FLAG
        line[LENGTH] = 0
    elif identifier < 0 or identifier > (MAX_EXTENDED_ID if meaning & _EXTENDED else MAX_STANDARD_ID):
        return MALFORMED
    elif meaning & _EXTENDED:
        identifier |= EXTENDED_FLAG
    time_us = _advance(clock, line[TIME_US])
    if time_us == fields.NO_TIME:
        return MALFORMED
    t_ns[row] = time_us * NS_PER_US
    can_id[row] = np.uint32(identifier | (REMOTE_FLAG if meaning & _REMOTE else 0))
    length[row] = line[LENGTH]
    channel[row] = max(line[CHANNEL], 0)
    flags[row] = _frame_flags(meaning, line[LENGTH])
    for index in range(min(line[LENGTH], max(line[COUNT], 0)), data.shape[1]):
        data[row, index] = 0
    return FRAME


@array_kernel
def _frame_flags(meaning: int, length: int) -> int:
    """Return the flags of a frame; formats that do not tell FD apart still show it by its length."""
    sent = TX_FLAG if meaning & _SENT else 0
    if not meaning & _FD and length <= PAYLOAD_BYTES:
        return sent
    return sent | FD_FLAG | (BRS_FLAG if meaning & _BRS else 0) | (ESI_FLAG if meaning & _ESI else 0)


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
