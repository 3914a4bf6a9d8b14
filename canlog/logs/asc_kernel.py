"""The usual lines of an ASC file, compiled: classic frames and those of CAN FD, both in hexadecimal."""

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import (
    BRS_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
)
from canlog.jit import array_kernel
from canlog.logs.text_kernels import (
    AT_END,
    BLANK,
    HEX_VALUE,
    IS_LENGTH,
    LENGTH_OF_CODE,
    LINES,
    NEWLINE,
    OTHER,
    POSITION,
    ROWS,
    STOP,
    WIDEN,
    decimal,
    decimal_parts,
    hexadecimal,
    skip_blanks,
    skip_line,
    skip_word,
)

# The clock of a file.
START_US, NOW_US, IS_RELATIVE, BASE = range(4)

HEXADECIMAL = 16
MAX_SECONDS_DIGITS, MAX_FRACTION_DIGITS = 10, 9
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
MAX_ID_DIGITS = 8
US_PER_S, NS_PER_US = 1_000_000, 1_000
LAST_US = 9_200_000_000_000_000  # since the epoch: nanoseconds must fit 64 bits
POINT, EQUALS, UNDERSCORE, SLASH = ord("."), ord("="), ord("_"), ord("/")
LETTER_C, LETTER_D, LETTER_R, LETTER_T, LETTER_X = ord("c"), ord("d"), ord("r"), ord("t"), ord("x")
SAID_REMOTE, SAID_FD = 0x0010, 0x1000  # bits of the flags of a CANFD line
UNUSUAL, TOO_LONG = -1, -2  # in place of the position behind a line


@array_kernel
def parse_usual_lines(
    text: UInt8Array,
    clock: Int64Array,
    t_ns: Int64Array,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
    report: Int64Array,
) -> None:
    """Parse lines from where the report says up to the first that is of another kind."""
    at, line, row = report[POSITION], report[LINES], report[ROWS]
    report[STOP] = AT_END
    is_hexadecimal = clock[BASE] == HEXADECIMAL
    while at < len(text):
        time_us, behind = _time_us(text, skip_blanks(text, at))
        now_us = clock[NOW_US] + time_us if clock[IS_RELATIVE] else time_us
        if time_us < 0 or not is_hexadecimal or clock[START_US] + now_us > LAST_US:
            end = UNUSUAL
        elif text[behind] | 32 == LETTER_C:
            end = _fd_frame(text, behind, row, can_id, length, flags, channel, data)
        else:
            end = _frame(text, behind, row, can_id, length, flags, channel, data)
        if end < 0:
            report[STOP] = WIDEN if end == TOO_LONG else OTHER
            break
        clock[NOW_US] = now_us
        t_ns[row] = (clock[START_US] + clock[NOW_US]) * NS_PER_US
        row += 1
        line += 1
        at = end
    report[POSITION], report[LINES], report[ROWS] = at, line, row


@array_kernel
def _time_us(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``seconds.fraction`` and the blanks behind it, rounded to microseconds; -1 if it is none."""
    begin = at
    seconds, at = decimal(text, begin, MAX_SECONDS_DIGITS)
    if at == begin or text[at] != POINT:
        return -1, at
    begin = at + 1
    fraction_ns, at = decimal_parts(text, begin, US_PER_S * NS_PER_US, MAX_FRACTION_DIGITS)
    if at == begin or text[at] != BLANK:
        return -1, at
    return seconds * US_PER_S + (fraction_ns + NS_PER_US // 2) // NS_PER_US, skip_blanks(text, at)


@array_kernel
def _frame(
    text: UInt8Array,
    at: int,
    row: int,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
) -> int:
    """Read ``1  123x  Rx   d 8 11 22 ...``; return the position behind the line, or UNUSUAL."""
    number, at = _decimal(text, at)
    identifier, at = _identifier(text, at)
    is_sent, at = _direction(text, at)
    kind = text[at] | 32
    is_data, is_remote = kind == LETTER_D, kind == LETTER_R
    if number < 0 or identifier < 0 or not (is_data or is_remote) or text[at + 1] > BLANK:
        return UNUSUAL
    at = skip_blanks(text, at + 1)
    count = HEX_VALUE[text[at]]
    if count < 0 and not (is_remote and text[at] == NEWLINE):
        return UNUSUAL
    at += count >= 0
    count = min(max(count, 0), PAYLOAD_BYTES)
    channel[row], length[row], flags[row] = number, count, TX_FLAG * is_sent
    can_id[row] = identifier | (REMOTE_FLAG if is_remote else 0)
    at = _payload(text, at, row, 0 if is_remote else count, data)
    return _end_of_line(text, at) if at >= 0 else UNUSUAL


@array_kernel
def _fd_frame(
    text: UInt8Array,
    at: int,
    row: int,
    can_id: UInt32Array,
    length: UInt8Array,
    flags: UInt8Array,
    channel: UInt8Array,
    data: UInt8Array,
) -> int:
    """Read ``CANFD 1 Rx 123 [name] 1 0 9 12 11 22 ... duration length flags ...``; as ``_frame``."""
    number, at = _decimal(text, skip_blanks(text, skip_word(text, at)))
    is_sent, at = _direction(text, at)
    identifier, at = _identifier(text, at)
    if not (48 <= text[at] <= 49 and text[at + 1] <= BLANK):
        at = skip_blanks(text, skip_word(text, at))
    is_fast, at = _decimal(text, at)
    is_passive, at = _decimal(text, at)
    code = HEX_VALUE[text[at]] if text[at + 1] <= BLANK else UNUSUAL
    at = skip_blanks(text, skip_word(text, at))
    count, at = _decimal(text, at)
    if (
        min(number, identifier, is_fast, is_passive, code, count) < 0
        or count > FD_PAYLOAD_BYTES
        or not IS_LENGTH[count]
    ):
        return UNUSUAL
    if count > data.shape[1]:
        return TOO_LONG
    channel[row], length[row], can_id[row] = number, count, identifier
    at = _payload(text, at - 1, row, count, data)
    if at < 0:
        return UNUSUAL
    at = skip_blanks(text, skip_word(text, skip_blanks(text, at)))  # the duration
    at = skip_blanks(text, skip_word(text, at))  # the length in bits
    begin = at
    said, at = hexadecimal(text, begin, MAX_ID_DIGITS)
    if at == begin or text[at] > BLANK or said & SAID_REMOTE or is_fast > 1 or is_passive > 1:
        return UNUSUAL
    if count != (LENGTH_OF_CODE[code] if said & SAID_FD else min(code, PAYLOAD_BYTES)):
        return UNUSUAL
    kind = FD_FLAG | (BRS_FLAG * is_fast) | (ESI_FLAG * is_passive) if said & SAID_FD else 0
    flags[row] = kind | TX_FLAG * is_sent
    return skip_line(text, at)


@array_kernel
def _decimal(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a number of one or two digits and the blanks behind it; -1 if it is none."""
    begin = at
    number, at = decimal(text, begin, 2)
    return (-1, at) if at == begin or text[at] > BLANK else (number, skip_blanks(text, at))


@array_kernel
def _direction(text: UInt8Array, at: int) -> tuple[bool, int]:
    """Pass over ``Rx`` or ``Tx`` and the blanks behind it; return whether it is the latter. Stay where neither is."""
    is_sent = text[at] | 32 == LETTER_T
    is_one = is_sent or text[at] | 32 == LETTER_R
    if is_one and text[at + 1] | 32 == LETTER_X and text[at + 2] <= BLANK:
        return is_sent, skip_blanks(text, at + 2)
    return False, at


@array_kernel
def _identifier(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read an identifier and the blanks behind it; -1 if it is none."""
    begin = at
    value, at = hexadecimal(text, begin, MAX_ID_DIGITS)
    is_extended = text[at] | 32 == LETTER_X
    at += is_extended
    if at == begin + is_extended or text[at] != BLANK or value > (MAX_EXTENDED_ID if is_extended else MAX_STANDARD_ID):
        return -1, at
    return (value | EXTENDED_FLAG if is_extended else value), skip_blanks(text, at)


@array_kernel
def _payload(text: UInt8Array, at: int, row: int, count: int, data: UInt8Array) -> int:
    """Read bytes of two digits, each behind blanks; return the position behind them, -1 if there are fewer."""
    for index in range(count):
        if text[at] != BLANK:
            return -1
        at = skip_blanks(text, at)
        high = HEX_VALUE[text[at]]
        low = HEX_VALUE[text[at + 1]] if high >= 0 else -1
        if low < 0:
            return -1
        data[row, index] = high * 16 + low
        at += 2
    for index in range(count, data.shape[1]):
        data[row, index] = 0
    return at if text[at] <= BLANK else -1


@array_kernel
def _end_of_line(text: UInt8Array, at: int) -> int:
    """Pass over ``name = anything`` or a comment, if it is there; return the position behind the line, or UNUSUAL."""
    at = skip_blanks(text, at)
    if text[at] == NEWLINE:
        return at + 1
    if text[at] == SLASH and text[at + 1] == SLASH:
        return skip_line(text, at)
    begin = at
    while 48 <= text[at] <= 57 or 97 <= (text[at] | 32) <= 122 or text[at] == UNDERSCORE:
        at += 1
    if at == begin or text[skip_blanks(text, at)] != EQUALS:
        return UNUSUAL
    return skip_line(text, at)
