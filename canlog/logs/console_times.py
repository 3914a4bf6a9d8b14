"""The times that candump prints in brackets, compiled."""

from canlog.arrays import UInt8Array
from canlog.jit import array_kernel
from canlog.logs.text_kernels import BLANK, decimal, decimal_parts

NS_PER_S, NS_PER_US, DAY_S = 1_000_000_000, 1_000, 86_400
MAX_SECONDS_DIGITS, NS_DIGITS = 10, 9
NO_TIME = -(1 << 62)
LAST_S = 9_200_000_000  # the year 2261: nanoseconds must fit 64 bits
DAYS_OF_400_YEARS, DAYS_TO_EPOCH = 146_097, 719_468  # of the Gregorian calendar, counted from March
OPEN, CLOSE, POINT, COLON, MINUS = ord("("), ord(")"), ord("."), ord(":"), ord("-")


@array_kernel
def read_time(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a time in brackets, if there is one, in nanoseconds; the position is negative if it is none."""
    if text[at] != OPEN:
        return 0, at
    begin = at + 1
    seconds, at = decimal(text, begin, MAX_SECONDS_DIGITS)
    if at == begin:
        return NO_TIME, -at
    if text[at] == MINUS:
        seconds, at = _read_date(text, begin)
    if at < 0 or text[at] != POINT:
        return NO_TIME, -abs(at)
    begin = at + 1
    fraction, at = decimal_parts(text, begin, NS_PER_S, NS_DIGITS)
    if at == begin or text[at] != CLOSE or not 0 <= seconds <= LAST_S:
        return NO_TIME, -at
    return seconds * NS_PER_S + fraction // NS_PER_US * NS_PER_US, at + 1


@array_kernel
def _read_date(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``2026-01-31 23:59:59`` as seconds since the epoch, as if it were UTC."""
    year, at = decimal(text, at, 4)
    month, at = _number_behind(text, at, MINUS, 12)
    day, at = _number_behind(text, at, MINUS, 31)
    hour, at = _number_behind(text, at, BLANK, 23)
    minute, at = _number_behind(text, at, COLON, 59)
    second, at = _number_behind(text, at, COLON, 60)
    if at < 0 or month == 0 or day == 0:
        return 0, -abs(at)
    shifted = year - (month <= 2)
    day_of_year = (153 * (month + (-3 if month > 2 else 9)) + 2) // 5 + day - 1
    days = shifted // 400 * DAYS_OF_400_YEARS + shifted % 400 * 365 + shifted % 400 // 4 - shifted % 400 // 100
    return ((days + day_of_year - DAYS_TO_EPOCH) * DAY_S + hour * 3600 + minute * 60 + second), at


@array_kernel
def _number_behind(text: UInt8Array, at: int, mark: int, limit: int) -> tuple[int, int]:
    """Read a mark and the number behind it; the position is negative, and stays so, if they are not there."""
    if at < 0 or text[at] != mark:
        return 0, -abs(at)
    begin = at + 1
    value, at = decimal(text, begin, 2)
    return (value, at) if at > begin and value <= limit else (0, -at)
