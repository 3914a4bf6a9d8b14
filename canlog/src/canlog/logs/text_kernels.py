"""What compiled readers of text share: digits, blanks, and payloads in hexadecimal.

Every text that is parsed ends with a newline, and no step passes over one, so none needs the length of the text.
"""

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array
from canlog.jit import part

# What one line comes to. The last three stop a kernel: the frame is too long for the rows, the line is none that the
# kernel reads, its channel has no number yet.
FRAME, SKIPPED, MALFORMED, TOO_LONG, OTHER, NEW_CHANNEL = range(6)

# Where a kernel is in its text, what stopped it, and what it has found until then.
POSITION, LINES, ROWS, STOP, SKIPPED_LINES, MALFORMED_LINES, FIRST_MALFORMED, PROGRESS_FIELDS = range(8)

NEWLINE, TAB, RETURN, BLANK, SLASH = 10, 9, 13, 32, 47
LONGEST_NUMBER = 18  # digits that 64 bits surely hold
DAYS_OF_400_YEARS, DAYS_TO_EPOCH = 146_097, 719_468  # of the Gregorian calendar, counted from March

HEX_VALUE: npt.NDArray[np.int8] = np.full(256, -1, np.int8)
UInt64Array = npt.NDArray[np.uint64]

_1, _2, _3, _4, _5, _6, _7 = (np.uint64(number) for number in range(1, 8))
_8, _16, _24, _32, _40, _48, _56 = (np.uint64(8 * number) for number in range(1, 8))


@part
def half(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of two bytes."""
    place = np.uint64(at)  # unsigned: no look from the end of the array
    return int(np.int64(raw[place]) | np.int64(raw[place + _1]) << 8)


@part
def word(raw: UInt8Array, at: int) -> np.uint64:
    """Return eight bytes from anywhere, little-endian, in one load."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    low |= np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24
    high = np.uint64(raw[place + _4]) << _32 | np.uint64(raw[place + _5]) << _40
    high |= np.uint64(raw[place + _6]) << _48 | np.uint64(raw[place + _7]) << _56
    return low | high


@part
def lower(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of four bytes."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    return int(np.int64(low | np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24))


@part
def reversed_bytes(value: int) -> int:
    """Return four bytes in the other order."""
    return (value & 0xFF) << 24 | (value & 0xFF00) << 8 | (value >> 8) & 0xFF00 | (value >> 24) & 0xFF


for _digit in range(16):
    HEX_VALUE[ord(f"{_digit:x}")] = HEX_VALUE[ord(f"{_digit:X}")] = _digit

# Two characters at a time: their value as hexadecimal and as decimal digits, -1 for any others.
_HEX_PAIRS = 16 * HEX_VALUE[:, None].astype(np.int16) + HEX_VALUE[None, :]
_ARE_HEX = (HEX_VALUE[:, None] >= 0) & (HEX_VALUE[None, :] >= 0)
HEX_PAIR: npt.NDArray[np.int16] = np.where(_ARE_HEX, _HEX_PAIRS, np.int16(-1))
LENGTH_OF_CODE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.int64)
IS_LENGTH: npt.NDArray[np.bool_] = np.isin(np.arange(65), LENGTH_OF_CODE)


@part
def skip_blanks(text: UInt8Array, at: int) -> int:
    """Return the position of the next character that is neither space, tabulator nor carriage return."""
    while text[at] == BLANK or text[at] == TAB or text[at] == RETURN:
        at += 1
    return at


@part
def skip_word(text: UInt8Array, at: int) -> int:
    """Return the position behind the characters that are neither blank nor the end of the line."""
    while text[at] > BLANK:
        at += 1
    return at


@part
def skip_line(text: UInt8Array, at: int) -> int:
    while text[at] != NEWLINE:
        at += 1
    return at + 1


@part
def decimal(text: UInt8Array, at: int, most_digits: int) -> tuple[int, int]:
    """Read a number of up to so many digits; return it and the position behind it, which is ``at`` if there is none."""
    value, begin = 0, at
    while 48 <= text[at] <= 57 and at - begin < most_digits:
        value = value * 10 + text[at] - 48
        at += 1
    return value, at


@part
def decimal_parts(text: UInt8Array, at: int, whole: int, most_digits: int) -> tuple[int, int]:
    """Read digits behind a decimal point as parts of a whole, a power of ten; further ones are worth nothing."""
    value, begin = 0, at
    while 48 <= text[at] <= 57 and at - begin < most_digits:
        whole //= 10
        value += whole * (text[at] - 48)
        at += 1
    return value, at


@part
def digits(text: UInt8Array, at: int, base: int, most_digits: int) -> tuple[int, int]:
    """Read a number of up to so many digits in a base up to 16, as ``decimal``."""
    value, begin = 0, at
    while 0 <= HEX_VALUE[text[at]] < base and at - begin < most_digits:
        value = value * base + HEX_VALUE[text[at]]
        at += 1
    return value, at


@part
def whole_number(text: UInt8Array, at: int, base: int, most_digits: int) -> tuple[int, int]:
    """Read a number as ``digits`` does that ends before a blank, a comment or the line's end; -1, and stay, if not."""
    begin = at
    value, at = digits(text, begin, base, most_digits)
    is_ended = text[at] <= BLANK or (text[at] == SLASH and text[at + 1] == SLASH)
    return (value, at) if at > begin and is_ended else (-1, begin)


@part
def clear(data: UInt8Array, row: int, first: int) -> None:
    """Make the bytes of a row zero from a first one on; a slice takes ten times as long to compile."""
    for place in range(first, data.shape[1]):
        data[row, place] = 0


@part
def hex_bytes(text: UInt8Array, at: int, row: int, data: UInt8Array, limit: int, separator: int) -> tuple[int, int]:
    """Read bytes of two digits into a row until something else comes; return how many and the position behind them.

    Between two bytes the separator may stand. More bytes than the limit are not read; the rest of the row is zeros.
    """
    count = 0
    while count < limit and text[at] != NEWLINE:
        value = HEX_PAIR[text[at], text[at + 1]]
        if value < 0:
            break
        data[row, count] = value
        count += 1
        at += 2
        if text[at] == separator and HEX_VALUE[text[at + 1]] >= 0:
            at += 1
    clear(data, row, count)
    return count, at


@part
def day_number(year: int, month: int, day: int) -> int:
    """Return how many days a date is behind the epoch."""
    shifted = year - (month <= 2)
    day_of_year = (153 * (month + (-3 if month > 2 else 9)) + 2) // 5 + day - 1
    days = shifted // 400 * DAYS_OF_400_YEARS + shifted % 400 * 365 + shifted % 400 // 4 - shifted % 400 // 100
    return int(days + day_of_year - DAYS_TO_EPOCH)


@part
def count_line(progress: Int64Array, outcome: int, line: int) -> None:
    if outcome == SKIPPED:
        progress[SKIPPED_LINES] += 1
    elif outcome == MALFORMED:
        if progress[MALFORMED_LINES] == 0:
            progress[FIRST_MALFORMED] = line
        progress[MALFORMED_LINES] += 1
