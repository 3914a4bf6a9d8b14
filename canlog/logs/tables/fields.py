"""Single fields of a text table, compiled: each is read up to the first character that does not belong to it.

A field that is none returns -1 beside a position at which it went wrong, negative where only a position is returned.
"""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import PAYLOAD_BYTES
from canlog.jit import array_kernel
from canlog.logs import text_kernels
from canlog.logs.tables.layout import BLANKS, packed_word
from canlog.logs.text_kernels import BLANK, LENGTH_OF_CODE, LONGEST_NUMBER, NEWLINE, decimal, skip_blanks

NO_BYTE = 256  # an empty column
NO_TIME = -(1 << 62)  # a time may be negative
MINUS, PLUS, POINT, COLON, LETTER_E = ord("-"), ord("+"), ord("."), ord(":"), ord("e")
MOST_CODES = len(LENGTH_OF_CODE)
SECOND_US = 1_000_000
MOST_HOURS = 9_999
TRUE, FALSE = packed_word("true"), packed_word("false")

BASE64_VALUE: npt.NDArray[np.int8] = np.full(256, -1, np.int8)
for _value, _character in enumerate(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"):
    BASE64_VALUE[_character] = _value
PAD = ord("=")


@array_kernel
def skip_field(text: UInt8Array, at: int, separator: int) -> int:
    """Return the position behind a field of any content; negative where the line ends instead."""
    if text[at] == NEWLINE:
        return -at
    while text[at] != separator and (text[at] > BLANK or (separator != BLANKS and text[at] != NEWLINE)):
        at += 1
    return at


@array_kernel
def number(text: UInt8Array, at: int, limit: int) -> tuple[int, int]:
    """Read a number of up to three digits; ``-`` is one that is not known."""
    if text[at] == MINUS:
        return -1, at + 1
    begin = at
    value, at = decimal(text, begin, 3)
    return (-1, -at) if at == begin or value > limit else (value, at)


@array_kernel
def decode_length(line: Int64Array, place: int, is_fd: int, at: int) -> int:
    """Replace a length code by the length; a classic frame has at most eight bytes, whatever its code."""
    code = line[place]
    if code >= MOST_CODES:
        return -at
    line[place] = LENGTH_OF_CODE[code] if is_fd else min(code, PAYLOAD_BYTES)
    return at


@array_kernel
def decimal_us(text: UInt8Array, at: int, power: int) -> tuple[int, int]:
    """Read a decimal number, perhaps with sign and exponent, as microseconds: times ten to this power, rounded."""
    is_negative = text[at] == MINUS
    at += is_negative or text[at] == PLUS
    mantissa, digits, begin = 0, 0, at
    while 48 <= text[at] <= 57:
        mantissa = mantissa * 10 + text[at] - 48
        digits += 1
        at += 1
        if digits > LONGEST_NUMBER:
            return NO_TIME, -at
    if text[at] == POINT and at > begin:
        at += 1
        while 48 <= text[at] <= 57:
            if digits < LONGEST_NUMBER:
                mantissa = mantissa * 10 + text[at] - 48
                digits += 1
                power -= 1
            at += 1
    if at == begin:
        return NO_TIME, -at
    exponent, at = _exponent(text, at)
    time_us = scaled(mantissa, power + exponent)
    return (-time_us if is_negative and time_us != NO_TIME else time_us), at


@array_kernel
def _exponent(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``e-05`` or ``E+12`` behind a number, if it is there."""
    if (text[at] | 32) != LETTER_E:
        return 0, at
    begin = at + 1 + (text[at + 1] == MINUS or text[at + 1] == PLUS)
    value, behind = decimal(text, begin, 3)
    if behind == begin:
        return 0, at
    return (-value if text[at + 1] == MINUS else value), behind


@array_kernel
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


@array_kernel
def clock_us(text: UInt8Array, at: int, unit_us: int) -> tuple[int, int]:
    """Read ``hours:minutes:seconds:count``, a count of so many microseconds, padded with zeros or not."""
    total_us = 0
    for part in range(3):
        begin = at
        value, at = decimal(text, begin, 4)
        if at == begin or text[at] != COLON or value > (MOST_HOURS if part == 0 else 59):
            return NO_TIME, -at
        total_us = total_us * 60 + value
        at += 1
    begin = at
    count, at = decimal(text, begin, 6)
    if at == begin or count * unit_us >= SECOND_US:
        return NO_TIME, -at
    return total_us * SECOND_US + count * unit_us, at


@array_kernel
def hexadecimal(text: UInt8Array, at: int) -> tuple[int, int, int]:
    """Read up to eight digits, perhaps behind 0x; return value, digits and position. ``-`` is a value not known."""
    if text[at] == MINUS:
        return -1, 0, at + 1
    if text[at] == 48 and (text[at + 1] | 32) == 120:
        at += 2
    begin = at
    value, at = text_kernels.hexadecimal(text, begin, 8)
    return (-1, 0, -at) if at == begin else (value, at - begin, at)


@array_kernel
def word(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a word of letters and digits, packed in lower case; 0 if there is none or it is too long to be known."""
    packed, begin = 0, at
    while text[at] > BLANK and text[at] != 44:
        letter = text[at] | 32 if 65 <= text[at] <= 90 else text[at]
        packed = (packed << 7) | (letter & 127) if at - begin < 8 else 0
        at += 1
    return packed, at


@array_kernel
def meaning_of(packed: int, words: Int64Array) -> int:
    """Return what a word means, -1 if it is not known."""
    for index in range(len(words)):
        if words[index, 0] == packed and packed != 0:
            return int(words[index, 1])
    return -1


@array_kernel
def switch(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read 0, 1, false or true."""
    if text[at] == 48 or text[at] == 49:
        return int(text[at]) - 48, at + 1
    packed, behind = word(text, at)
    is_true, is_false = packed == TRUE, packed == FALSE
    return int(is_true), (behind if is_true or is_false else -behind)


@array_kernel
def byte(text: UInt8Array, at: int, separator: int) -> tuple[int, int]:
    """Read a byte and what separates it from the next; two digits, or one between commas."""
    begin = at
    value, at = text_kernels.hexadecimal(text, begin, 2)
    digits = at - begin
    at = skip_blanks(text, at)
    if separator == BLANKS:
        is_apart = at > begin + 2 or text[at] == NEWLINE
        return (value, at) if digits == 2 and is_apart else (-1, at)
    if text[at] == separator:
        return (value if digits else NO_BYTE), at + 1
    return (value, at) if digits and text[at] == NEWLINE else (-1, at)


@array_kernel
def decimal_byte(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a byte of one to three decimal digits and the blanks behind it; -1 if it is none."""
    value, at = text_kernels.whole_number(text, at, 10, 3)
    return (value if value <= 255 else -1), skip_blanks(text, at)


@array_kernel
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
