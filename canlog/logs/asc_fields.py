"""Single fields of a line of an ASC file, compiled."""

import string

import numpy as np

from canlog.arrays import BoolArray, UInt8Array
from canlog.frames import EXTENDED_FLAG
from canlog.jit import array_kernel
from canlog.logs.text_kernels import (
    BLANK,
    HEX_VALUE,
    LONGEST_NUMBER,
    NEWLINE,
    SLASH,
    decimal,
    digits,
    skip_blanks,
    skip_line,
    whole_number,
)

HEXADECIMAL, DECIMAL = 16, 10
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
MOST_ID_DIGITS = 12
BYTE_DIGITS, MAX_BYTE = 3, 255
EQUALS = ord("=")
LETTER_R, LETTER_T, LETTER_X = ord("r"), ord("t"), ord("x")
NONE = -1  # in place of a number or a position

IS_LETTER: BoolArray = np.isin(np.arange(256), list(f"{string.ascii_letters}{string.digits}_".encode()))  # of a name


@array_kernel
def is_word(text: UInt8Array, at: int, word: UInt8Array) -> bool:
    """Return whether a word stands here, in letters of either size."""
    for index in range(len(word)):
        if text[at + index] | 32 != word[index]:
            return False
    return not IS_LETTER[text[at + len(word)]]


@array_kernel
def decimal_number(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a decimal number and the blanks behind it; NONE, and stay, if there is none."""
    number, behind = decimal(text, at, LONGEST_NUMBER)
    if behind == at or text[behind] > BLANK:
        return NONE, at
    return number, skip_blanks(text, behind)


@array_kernel
def direction(text: UInt8Array, at: int) -> tuple[int, int]:
    """Pass over ``Rx`` or ``Tx`` and the blanks behind it; return 1 for the latter. Else stay: NONE."""
    is_sent = text[at] | 32 == LETTER_T
    if (is_sent or text[at] | 32 == LETTER_R) and text[at + 1] | 32 == LETTER_X and not IS_LETTER[text[at + 2]]:
        return int(is_sent), skip_blanks(text, at + 2)
    return NONE, at


@array_kernel
def identifier(text: UInt8Array, at: int, base: int) -> tuple[int, int]:
    """Read an identifier and the blanks behind it; NONE if it is none."""
    begin = at
    value, at = digits(text, begin, base, MOST_ID_DIGITS)
    is_extended = text[at] | 32 == LETTER_X
    at += is_extended
    if at == begin + is_extended or text[at] > BLANK or value > (MAX_EXTENDED_ID if is_extended else MAX_STANDARD_ID):
        return NONE, at
    return (value | EXTENDED_FLAG if is_extended else value), skip_blanks(text, at)


@array_kernel
def payload(text: UInt8Array, at: int, data: UInt8Array, row: int, count: int, base: int, is_fd: int) -> int:
    """Read bytes, each behind blanks; return the position behind them, or NONE.

    Hexadecimal ones of CAN FD have two digits each: the numbers behind them may have one.
    """
    behind = _paired_bytes(text, at, data, row, count) if base == HEXADECIMAL else NONE
    if behind == NONE:
        behind = at
        for index in range(count):
            begin = skip_blanks(text, behind)
            value, behind = whole_number(text, begin, base, BYTE_DIGITS)
            if not 0 <= value <= MAX_BYTE or (is_fd and base == HEXADECIMAL and behind != begin + 2):
                return NONE
            data[row, index] = value
    for index in range(count, data.shape[1]):
        data[row, index] = 0
    return behind


@array_kernel
def _paired_bytes(text: UInt8Array, at: int, data: UInt8Array, row: int, count: int) -> int:
    """Read bytes of two digits, as nearly all are, each behind blanks; return the position behind them, or NONE."""
    for index in range(count):
        if text[at] != BLANK:
            return NONE
        at = skip_blanks(text, at)
        high = HEX_VALUE[text[at]]
        low = HEX_VALUE[text[at + 1]] if high >= 0 else NONE
        if low < 0:
            return NONE
        data[row, index] = high * 16 + low
        at += 2
    return at if text[at] <= BLANK else NONE


@array_kernel
def end_of_line(text: UInt8Array, at: int) -> int:
    """Pass over ``name = anything`` or a comment, if it is there; return the position behind the line, or NONE."""
    at = skip_blanks(text, at)
    if text[at] == NEWLINE:
        return at + 1
    if text[at] == SLASH and text[at + 1] == SLASH:
        return skip_line(text, at)
    begin = at
    while IS_LETTER[text[at]]:
        at += 1
    if at == begin or text[skip_blanks(text, at)] != EQUALS:
        return NONE
    return skip_line(text, at)
