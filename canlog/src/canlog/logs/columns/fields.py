"""Single fields of a table, compiled: each is read between two positions and takes no more and no less than that."""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, FD_PAYLOAD_BYTES, REMOTE_FLAG, TX_FLAG
from canlog.jit import part
from canlog.logs.columns.roles import BLANKS, HEXADECIMAL, Role, packed_word
from canlog.logs.frame_buffer import name_hash
from canlog.logs.text_kernels import (
    BLANK,
    LONGEST_NUMBER,
    NEWLINE,
    RETURN,
    TAB,
    day_number,
    decimal,
    decimal_parts,
    digits,
)

NO_TIME = -(1 << 62)  # a time may be negative

QUOTE, COMMA, POINT, COLON, MINUS, PLUS, ZERO = ord('"'), ord(","), ord("."), ord(":"), ord("-"), ord("+"), ord("0")
LETTER_E, LETTER_H, LETTER_X, LETTER_Z = ord("e"), ord("h"), ord("x"), ord("z")
SQUARE, SQUARE_END, SLASH = ord("["), ord("]"), ord("/")
MOST_ID_DIGITS = 10
LARGEST_ID = 0x1FFF_FFFF
MOST_CHANNEL, MOST_LENGTH = 255, 255
SECOND_US, DAY_S = 1_000_000, 86_400
MOST_FRACTION_DIGITS = 9
MOST_HOURS = 9_999
TRUE, FALSE = packed_word("true"), packed_word("false")
PAD = ord("=")
YEAR_DIGITS = 4
HOUR_DIGITS, DAY_DIGITS, MOST_STAMP_DIGITS = 9, 11, 17  # of a stamp in milliseconds up to these parts, and to the year
IS_BETWEEN: npt.NDArray[np.bool_] = np.arange(256) <= BLANK
IS_BETWEEN[list(b",:-._[]")] = True  # what else may stand between two bytes
IS_BEFORE_CLOCK: npt.NDArray[np.bool_] = np.zeros(256, np.bool_)
IS_BEFORE_CLOCK[list(b"Tt -")] = True  # what stands between a date and a time of day
BASE64_VALUE: npt.NDArray[np.int8] = np.full(256, -1, np.int8)
for _value, _character in enumerate(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"):
    BASE64_VALUE[_character] = _value
# First letters of fields that say yes, by the role of their column: true, yes, x, and what names it, such as Ext or Tx;
# and what yes says about a frame: flags of its identifier and its own.
SAYS_YES: npt.NDArray[np.bool_] = np.zeros((len(Role), 256), np.bool_)
MEANING_OF_ROLE: Int64Array = np.zeros(len(Role), np.int64)
for _role, _letters, _flag in (
    (Role.EXTENDED, "tyxe", EXTENDED_FLAG),
    (Role.REMOTE, "tyxr", REMOTE_FLAG),
    (Role.ERROR, "tyxe", ERROR_FLAG),
    (Role.FD, "tyxf", FD_FLAG),
    (Role.BIT_RATE_SWITCH, "tyxb", BRS_FLAG),
    (Role.ERROR_STATE, "tyxe", ESI_FLAG),
    (Role.DIRECTION, "tyos", TX_FLAG),  # out, sent
):
    SAYS_YES[_role, list((_letters + _letters.upper()).encode())] = True
    MEANING_OF_ROLE[_role] = _flag


@part
def skip_margin(text: UInt8Array, at: int, separator: int) -> int:
    """Return the position of the next character that is neither blank nor, of blank-separated columns, a tabulator."""
    while text[at] == BLANK or text[at] == RETURN or (text[at] == TAB and separator != TAB):
        at += 1
    return at


@part
def field(text: UInt8Array, at: int, separator: int) -> tuple[int, int, int]:
    """Return where a field begins and stops, without quotes and blanks around it, and where its separator stands."""
    begin = skip_margin(text, at, separator)
    if text[begin] == QUOTE and separator != BLANKS:
        at = begin + 1
        while text[at] != QUOTE and text[at] != NEWLINE:
            at += 1
        begin, stop = begin + 1, at
        at = skip_margin(text, at + (text[at] == QUOTE), separator)
        if text[at] == separator or text[at] == NEWLINE:
            return begin, stop, at
    else:
        at = begin
    while text[at] != separator and text[at] != NEWLINE:
        if separator == BLANKS and (text[at] == TAB or text[at] == RETURN):
            break
        at += 1
    stop = at
    while stop > begin and (text[stop - 1] == BLANK or text[stop - 1] == TAB or text[stop - 1] == RETURN):
        stop -= 1
    return begin, stop, (skip_margin(text, at, separator) if separator == BLANKS else at)


@part
def hexadecimal_field(text: UInt8Array, begin: int, stop: int) -> int:
    """Return a hexadecimal number of up to eight digits, -1 if a field is none."""
    value, at = digits(text, begin, HEXADECIMAL, 8)
    return value if begin < at == stop else -1


@part
def small_number(text: UInt8Array, begin: int, stop: int) -> int:
    """Return a decimal number, perhaps in brackets, -1 if a field is none or it is larger than any length."""
    if stop - begin > 2 and text[begin] == SQUARE and text[stop - 1] == SQUARE_END:
        begin, stop = begin + 1, stop - 1
    value, at = decimal(text, begin, 3)
    return value if begin < at == stop and value <= MOST_LENGTH else -1


@part
def channel(text: UInt8Array, begin: int, stop: int, names: Int64Array) -> int:
    """Return the place of a name of a bus among known ones; without those the number at its end, 0 if there is none."""
    if names.size:
        wanted = name_hash(text, begin, stop)
        for index in range(names.size):
            if names[index] == wanted:
                return index
        return int(names.size)  # a name that came late
    value, factor, at = 0, 1, stop
    while at > begin and 48 <= text[at - 1] <= 57 and factor <= 100:
        at -= 1
        value += factor * (text[at] - 48)
        factor *= 10
    return value if value <= MOST_CHANNEL else 0


@part
def identifier(
    text: UInt8Array,
    begin: int,
    stop: int,
    base: int,
    line: Int64Array,
    meaning: int,
    extended_digits: int,
) -> int:
    """Return an identifier, -1 if a field is none; ``x`` behind it makes it an extended one, as Vector writes it.

    So do that many hexadecimal digits, unless ``extended_digits`` is 0.
    """
    if stop - begin > 2 and text[begin] == ZERO and (text[begin + 1] | 32) == LETTER_X:
        begin, base = begin + 2, HEXADECIMAL
    last = text[stop - 1] | 32 if stop > begin else 0
    if last == LETTER_X or last == LETTER_H:  # noqa: PLR1714, SIM109 - no tuple in a kernel
        line[meaning] |= EXTENDED_FLAG if last == LETTER_X else 0
        stop, base = stop - 1, (HEXADECIMAL if last == LETTER_H else base)
    value, at = digits(text, begin, base, MOST_ID_DIGITS)
    if not begin < at == stop:
        return -1
    if value > LARGEST_ID and value & EXTENDED_FLAG and value & ~EXTENDED_FLAG <= LARGEST_ID:
        value &= ~EXTENDED_FLAG  # as Linux numbers them
        line[meaning] |= EXTENDED_FLAG
    if 0 < extended_digits <= stop - begin and base == HEXADECIMAL:
        line[meaning] |= EXTENDED_FLAG
    return value if value <= LARGEST_ID else -1


@part
def data_bytes(
    text: UInt8Array,
    begin: int,
    stop: int,
    base: int,
    data: UInt8Array,
    row: int,
    count: int,
    is_one: bool,  # noqa: FBT001 - of a kernel
) -> int:
    """Add the bytes of a field to those of a row; return how many there are then, -1 if something is no byte.

    Hexadecimal ones may stand without anything between them. Bytes that do not fit into the row are counted, too.
    """
    at, before = begin, count
    while at < stop:
        while at < stop and IS_BETWEEN[text[at]]:
            at += 1
        if at == stop:
            break
        own_base = base
        if stop - at > 2 and text[at] == ZERO and (text[at + 1] | 32) == LETTER_X:
            at, own_base = at + 2, HEXADECIMAL
        start = at
        value, at = digits(text, start, own_base, 2 if own_base == HEXADECIMAL else 3)
        is_ended = at == stop or IS_BETWEEN[text[at]]
        if at == start or value > 255 or (not is_ended and (own_base != HEXADECIMAL or at < start + 2)):
            return -1
        if count < data.shape[1]:
            data[row, count] = value
        count += 1
        if count > FD_PAYLOAD_BYTES:
            return -1
    return -1 if is_one and count - before > 1 else count


@part
def is_on(text: UInt8Array, begin: int, stop: int, role: int) -> bool:
    """Return whether a field says yes: 1, true, yes, x, or by the name of what it stands for, such as Tx or Ext."""
    if stop == begin:
        return False
    if 48 <= text[begin] <= 57:
        value = small_number(text, begin, stop)
        return bool(value == 29 or (value > 0 and value != 11))
    return bool(SAYS_YES[role, text[begin]])


@part
def time_us(text: UInt8Array, begin: int, stop: int, power: int, has_decimal_comma: bool) -> int:  # noqa: FBT001
    """Return a time in microseconds: a number of a unit, a time of day, or a date; NO_TIME if a field is none of them.

    A date is taken as if it were UTC unless an offset stands behind it.
    """
    mark = begin  # behind the first digits
    while mark < stop and 48 <= text[mark] <= 57:
        mark += 1
    if text[mark] == COLON and mark < stop:
        value_us, at = clock_us(text, begin, stop)
        return value_us if at == stop else NO_TIME
    if mark - begin == YEAR_DIGITS and mark < stop and (text[mark] == MINUS or text[mark] == SLASH):
        return date_us(text, begin, stop)
    if text[mark] == COMMA and has_decimal_comma and begin < mark < stop:
        whole_us = decimal_us_of(text, begin, mark, power)
        part_us = decimal_us_of(text, mark + 1, stop, power - (stop - mark - 1))
        return NO_TIME if min(whole_us, part_us) == NO_TIME else whole_us + part_us
    return decimal_us_of(text, begin, stop, power)


@part
def decimal_us_of(text: UInt8Array, begin: int, stop: int, power: int) -> int:
    """Return a decimal number as microseconds, NO_TIME unless it takes the whole field."""
    if begin == stop:
        return NO_TIME
    value_us, at = decimal_us(text, begin, power)
    return value_us if at == stop else NO_TIME


@part
def clock_us(text: UInt8Array, begin: int, stop: int) -> tuple[int, int]:
    """Read ``hours:minutes:seconds.fraction``; return the time and the position behind it, or NO_TIME."""
    total_s, at = 0, begin
    for place in range(3):
        start = at
        value, at = decimal(text, start, 4)
        if at == start or (place > 0 and value > 59):
            return NO_TIME, at
        total_s = total_s * 60 + value
        if place < 2:
            if at == stop or text[at] != COLON:
                return NO_TIME, at
            at += 1
    fraction_us = 0
    if at < stop and (text[at] == POINT or text[at] == COMMA or text[at] == COLON):
        start = at + 1
        fraction_us, at = decimal_parts(text, start, SECOND_US, MOST_FRACTION_DIGITS)
        if at == start:
            return NO_TIME, at
    return total_s * SECOND_US + fraction_us, at


@part
def date_us(text: UInt8Array, begin: int, stop: int) -> int:
    """Return ``2026-01-31T23:59:59.5+01:00``, or with a blank and without an offset, in microseconds."""
    if stop - begin < 12:
        return NO_TIME
    year = _number(text, begin, 4)
    month, day = _number(text, begin + 5, 2), _number(text, begin + 8, 2)
    is_date = text[begin + 7] == text[begin + 4] and 1 <= month <= 12 and 1 <= day <= 31 and year >= 0
    if not is_date or not IS_BEFORE_CLOCK[text[begin + 10]]:
        return NO_TIME
    day_us, at = clock_us(text, begin + 11, stop)
    if day_us == NO_TIME:
        return NO_TIME
    value_us = day_number(year, month, day) * DAY_S * SECOND_US + day_us
    offset_s = _offset_s(text, at, stop)
    return NO_TIME if offset_s == NO_TIME else value_us - offset_s * SECOND_US


@part
def stamp_us(text: UInt8Array, begin: int, stop: int, year: int) -> int:  # noqa: PLR0911 - one for each length
    """Return ``20260131T235959.999`` in microseconds, whatever stands between its digits, as if it were UTC.

    Larger parts may be missing: the year, which is then ``year``; the month, then it is the time since the month
    began; the day, the hour, and so on. NO_TIME if a field is none of these.
    """
    count, value = 0, 0
    for at in range(begin, stop):
        if 48 <= text[at] <= 57:
            count, value = count + 1, value * 10 + text[at] - 48
            if count > MOST_STAMP_DIGITS:
                return NO_TIME
    if count % 2 == 0 or count < 3 or count == MOST_STAMP_DIGITS - 2:
        return NO_TIME
    value_us, rest = value % 1_000 * 1_000, value // 1_000
    second, minute, hour, rest = rest % 100, rest // 100 % 100, rest // 10_000 % 100, rest // 1_000_000
    if second > 60 or minute > 59 or hour > 23:
        return NO_TIME
    value_us += ((hour * 60 + minute) * 60 + second) * SECOND_US
    if count <= HOUR_DIGITS:
        return value_us
    day, month = rest % 100, rest // 100 % 100 if count > DAY_DIGITS else 1
    if not (1 <= month <= 12 and 1 <= day <= 31):
        return NO_TIME
    if count == DAY_DIGITS:
        return value_us + (day - 1) * DAY_S * SECOND_US
    return value_us + day_number(rest // 10_000 if count == MOST_STAMP_DIGITS else year, month, day) * DAY_S * SECOND_US


@part
def _number(text: UInt8Array, at: int, count: int) -> int:
    """Return a number of so many digits, -1 if it is none."""
    value, behind = decimal(text, at, count)
    return value if behind == at + count else -1


@part
def _offset_s(text: UInt8Array, at: int, stop: int) -> int:
    """Return ``+01:00`` or ``Z`` in seconds, 0 where nothing stands, NO_TIME if it is anything else."""
    if at == stop or (stop - at == 1 and (text[at] | 32) == LETTER_Z):
        return 0
    if stop - at < 5 or (text[at] != PLUS and text[at] != MINUS):
        return NO_TIME
    hours, minutes = _number(text, at + 1, 2), _number(text, stop - 2, 2)
    if hours < 0 or minutes < 0 or stop - at > 6:
        return NO_TIME
    total_s = hours * 3600 + minutes * 60
    return -total_s if text[at] == MINUS else total_s


@part
def is_switch(text: UInt8Array, begin: int, stop: int) -> bool:
    """Return whether a field is 0, 1, false or true and nothing else."""
    if stop == begin + 1:
        return bool(text[begin] == ZERO or text[begin] == ZERO + 1)
    packed, behind = word(text, begin)
    return bool(behind == stop and (packed == TRUE or packed == FALSE))  # noqa: PLR1714, SIM109 - no tuple in a kernel


@part
def decimal_us(text: UInt8Array, at: int, power: int) -> tuple[int, int]:
    """Read a decimal number, perhaps with sign and exponent, as microseconds: times ten to this power, rounded."""
    is_negative = text[at] == MINUS
    at += is_negative or text[at] == PLUS
    mantissa, digit_count, begin = 0, 0, at
    while 48 <= text[at] <= 57:
        mantissa = mantissa * 10 + text[at] - 48
        digit_count += 1
        at += 1
        if digit_count > LONGEST_NUMBER:
            return NO_TIME, -at
    if text[at] == POINT and at > begin:
        at += 1
        while 48 <= text[at] <= 57:
            if digit_count < LONGEST_NUMBER:
                mantissa = mantissa * 10 + text[at] - 48
                digit_count += 1
                power -= 1
            at += 1
    if at == begin:
        return NO_TIME, -at
    exponent, at = _exponent(text, at)
    time_us = scaled(mantissa, power + exponent)
    return (-time_us if is_negative and time_us != NO_TIME else time_us), at


@part
def _exponent(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``e-05`` or ``E+12`` behind a number, if it is there."""
    if (text[at] | 32) != LETTER_E:
        return 0, at
    begin = at + 1 + (text[at + 1] == MINUS or text[at + 1] == PLUS)
    value, behind = decimal(text, begin, 3)
    if behind == begin:
        return 0, at
    return (-value if text[at + 1] == MINUS else value), behind


@part
def scaled(mantissa: int, power: int) -> int:
    """Return an integer times a power of ten, rounded half up; NO_TIME if it is too large."""
    if power < -LONGEST_NUMBER or mantissa == 0:
        return 0
    if power > LONGEST_NUMBER:
        return NO_TIME
    factor = 1
    for _ in range(abs(power)):
        factor *= 10
    if power < 0:
        return (mantissa + factor // 2) // factor
    return NO_TIME if mantissa > 4_000_000_000_000_000_000 // factor else mantissa * factor


@part
def counted_clock_us(text: UInt8Array, at: int, unit_us: int) -> tuple[int, int]:
    """Read ``hours:minutes:seconds:count``, a count of so many microseconds, padded with zeros or not."""
    total_us = 0
    for place in range(3):
        begin = at
        value, at = decimal(text, begin, 4)
        if at == begin or text[at] != COLON or value > (MOST_HOURS if place == 0 else 59):
            return NO_TIME, -at
        total_us = total_us * 60 + value
        at += 1
    begin = at
    count, at = decimal(text, begin, 6)
    if at == begin or count * unit_us >= SECOND_US:
        return NO_TIME, -at
    return total_us * SECOND_US + count * unit_us, at


@part
def word(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a word of letters and digits, packed in lower case; 0 if there is none or it is too long to be known."""
    packed, begin = 0, at
    while text[at] > BLANK and text[at] != 44:
        letter = text[at] | 32 if 65 <= text[at] <= 90 else text[at]
        packed = (packed << 7) | (letter & 127) if at - begin < 8 else 0
        at += 1
    return packed, at


@part
def meaning_of(packed: int, words: Int64Array) -> int:
    """Return what a word means, -1 if it is not known."""
    for index in range(len(words)):
        if words[index, 0] == packed and packed != 0:
            return int(words[index, 1])
    return -1


@part
def base64_bytes(text: UInt8Array, at: int, row: int, data: UInt8Array) -> tuple[int, int]:
    """Read all bytes of a payload; return their number, or one more than fit beside a negative position."""
    bits, held, count, begin = 0, 0, 0, at
    while BASE64_VALUE[text[at]] >= 0:
        bits = ((bits << 6) | BASE64_VALUE[text[at]]) & 0xFFFF
        held += 6
        if held >= 8:
            held -= 8
            if count == data.shape[1]:
                return count + 1, -at
            data[row, count] = (bits >> held) & 0xFF
            count += 1
        at += 1
    while text[at] == PAD:
        at += 1
    return (count, at) if (at - begin) % 4 == 0 else (count, -at)
