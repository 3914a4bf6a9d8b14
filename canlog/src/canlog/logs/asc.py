"""Vector ASC logs to columns: what its header lines say, and the lines that they speak of.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re
import string

import numpy as np

from canlog.arrays import BoolArray, Int64Array, UInt8Array
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
    FrameBatch,
)
from canlog.jit import kernel, part
from canlog.logs.dates import US_PER_S, date_us, decoded
from canlog.logs.text_kernels import (
    BLANK,
    FRAME,
    HEX_VALUE,
    IS_LENGTH,
    LENGTH_OF_CODE,
    LINES,
    LONGEST_NUMBER,
    MALFORMED,
    NEWLINE,
    OTHER,
    POSITION,
    ROWS,
    SKIPPED,
    SLASH,
    STOP,
    TOO_LONG,
    FrameRows,
    clear,
    count_line,
    decimal,
    decimal_parts,
    digits,
    skip_blanks,
    skip_line,
    skip_word,
    whole_number,
)
from canlog.logs.text_log import KernelLog

HEXADECIMAL, DECIMAL = 16, 10
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
MOST_ID_DIGITS = 12
BYTE_DIGITS, MAX_BYTE = 3, 255
EQUALS = ord("=")
LETTER_R, LETTER_T, LETTER_X = ord("r"), ord("t"), ord("x")
NONE = -1  # in place of a number or a position

IS_LETTER: BoolArray = np.isin(np.arange(256), list(f"{string.ascii_letters}{string.digits}_".encode()))  # of a name


@part
def is_word(text: UInt8Array, at: int, word: UInt8Array) -> bool:
    """Return whether a word stands here, in letters of either size."""
    for index in range(len(word)):
        if text[at + index] | 32 != word[index]:
            return False
    return not IS_LETTER[text[at + len(word)]]


@part
def decimal_number(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read a decimal number and the blanks behind it; NONE, and stay, if there is none."""
    number, behind = decimal(text, at, LONGEST_NUMBER)
    if behind == at or text[behind] > BLANK:
        return NONE, at
    return number, skip_blanks(text, behind)


@part
def read_direction(text: UInt8Array, at: int) -> tuple[int, int]:
    """Pass over ``Rx`` or ``Tx`` and the blanks behind it; return 1 for the latter. Else stay: NONE."""
    is_sent = text[at] | 32 == LETTER_T
    if (is_sent or text[at] | 32 == LETTER_R) and text[at + 1] | 32 == LETTER_X and not IS_LETTER[text[at + 2]]:
        return int(is_sent), skip_blanks(text, at + 2)
    return NONE, at


@part
def read_identifier(text: UInt8Array, at: int, base: int) -> tuple[int, int]:
    """Read an identifier and the blanks behind it; NONE if it is none."""
    begin = at
    value, at = digits(text, begin, base, MOST_ID_DIGITS)
    is_extended = text[at] | 32 == LETTER_X
    at += is_extended
    if at == begin + is_extended or text[at] > BLANK or value > (MAX_EXTENDED_ID if is_extended else MAX_STANDARD_ID):
        return NONE, at
    return (value | EXTENDED_FLAG if is_extended else value), skip_blanks(text, at)


@part
def payload(text: UInt8Array, at: int, data: UInt8Array, row: int, count: int, base: int, is_fd: int) -> int:
    """Read bytes, each behind blanks; return the position behind them, or NONE.

    Hexadecimal ones of CAN FD have two digits each: the numbers behind them may have one.
    """
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


@part
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


# The clock of a file.
START_US, NOW_US, IS_RELATIVE, BASE, CLOCK_FIELDS = range(5)

MAX_SECONDS_DIGITS, MAX_FRACTION_DIGITS = 10, 9
MAX_CHANNEL, MOST_CHANNEL_NUMBER = 255, 999
MOST_CODES = len(LENGTH_OF_CODE)
NS_PER_US = 1_000
LAST_US = 9_200_000_000_000_000  # since the epoch: nanoseconds must fit 64 bits
POINT, LETTER_D = ord("."), ord("d")
CANFD_WORD = np.frombuffer(b"canfd", np.uint8)
ERROR_WORD = np.frombuffer(b"errorframe", np.uint8)
SAID_REMOTE, SAID_FD = 0x0010, 0x1000  # bits of the flags of a CANFD line
FLAGS_PLACE = 2  # of the numbers behind a payload, from 0: duration, length, flags

# Characters that are in no text of either encoding.
IS_CONTROL: BoolArray = np.isin(np.arange(256), [*range(9), *range(14, 32), 127, 255])


@kernel
def parse_lines(text: UInt8Array, rows: FrameRows, clock: Int64Array, progress: Int64Array) -> None:
    """Parse lines from the position in ``progress`` up to the first that does not begin with a time."""
    at, line, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        time_us, event = _time_us(text, skip_blanks(text, at))
        outcome, behind = (OTHER, at) if time_us < 0 else _event(text, event, rows, row, clock[BASE])
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        # Later times are refused; adding to them must not overflow.
        clock[NOW_US] = min(time_us + (clock[NOW_US] if clock[IS_RELATIVE] else 0), LAST_US + 1)
        if outcome == FRAME:
            time_us = clock[START_US] + clock[NOW_US]
            rows.t_ns[row] = time_us * NS_PER_US
            outcome = FRAME if time_us <= LAST_US else MALFORMED
        row += outcome == FRAME
        line += 1
        count_line(progress, outcome, line)
        at = behind
    progress[POSITION], progress[LINES], progress[ROWS] = at, line, row


@part
def _time_us(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read ``seconds.fraction`` and the blanks behind it, rounded to microseconds; NONE if no event follows."""
    begin = at
    seconds, at = decimal(text, begin, MAX_SECONDS_DIGITS)
    if at == begin or text[at] != POINT:
        return NONE, at
    begin = at + 1
    fraction_ns, at = decimal_parts(text, begin, US_PER_S * NS_PER_US, MAX_FRACTION_DIGITS)
    behind = skip_blanks(text, at)
    if at == begin or text[at] > BLANK or text[behind] == NEWLINE:
        return NONE, at
    return seconds * US_PER_S + (fraction_ns + NS_PER_US // 2) // NS_PER_US, behind


@part
def _event(text: UInt8Array, at: int, rows: FrameRows, row: int, base: int) -> tuple[int, int]:
    """Read what stands behind a time; return the outcome and the position behind the line."""
    is_fd = text[at] | 32 == CANFD_WORD[0]
    number, channel_at = decimal_number(text, skip_blanks(text, skip_word(text, at)) if is_fd else at)
    end = NONE
    if 0 <= number <= MOST_CHANNEL_NUMBER:
        rows.channel[row] = min(number, MAX_CHANNEL)
        end = _fd_frame(text, channel_at, rows, row, base) if is_fd else _frame(text, channel_at, rows, row, base)
    if end >= 0:
        return FRAME, end
    return _other(text, at, rows, row) if end == NONE else (TOO_LONG, at)


@part
def _other(text: UInt8Array, at: int, rows: FrameRows, row: int) -> tuple[int, int]:
    """Read an event that is no frame with a payload; return the outcome and the position behind the line."""
    begin, is_fd, outcome = at, is_word(text, at, CANFD_WORD), SKIPPED
    number, at = decimal_number(text, skip_blanks(text, at + len(CANFD_WORD)) if is_fd else at)
    direction, behind = read_direction(text, at)
    if 0 <= number <= MOST_CHANNEL_NUMBER and is_word(text, behind, ERROR_WORD):
        rows.can_id[row], rows.length[row], rows.flags[row] = ERROR_FLAG, 0, TX_FLAG * (direction > 0)
        clear(rows.data, row, 0)
        return FRAME, skip_line(text, behind)
    if number < 0:  # no valid channel, or an event of another bus
        at = skip_blanks(text, skip_word(text, at))
        direction, _ = read_direction(text, at)
    if not is_fd:
        direction, behind = read_direction(text, skip_blanks(text, skip_word(text, at)))
        kind = text[behind] | 32
        is_data = (kind == LETTER_D or kind == LETTER_R) and text[behind + 1] <= BLANK  # noqa: PLR1714, SIM109 - no tuple
        direction = direction if number >= 0 or is_data else NONE
    if direction >= 0:  # it looks like a frame
        outcome = MALFORMED
    at = begin
    while text[at] != NEWLINE:
        if IS_CONTROL[text[at]]:
            outcome = MALFORMED
        at += 1
    return outcome, at + 1


@part
def _frame(text: UInt8Array, at: int, rows: FrameRows, row: int, base: int) -> int:
    """Read ``123x  Rx   d 8 11 22 ...``, perhaps without a direction; return what ``_fd_frame`` does."""
    identifier, at = read_identifier(text, at, base)
    direction, at = read_direction(text, at)
    kind = text[at] | 32
    is_remote = kind == LETTER_R and direction >= 0  # what else begins with R may be a damaged direction
    if identifier < 0 or not (kind == LETTER_D or is_remote) or text[at + 1] > BLANK:
        return NONE
    begin = skip_blanks(text, at + 1)
    code, at = whole_number(text, begin, base, 2)
    if code > PAYLOAD_BYTES and not is_remote:
        count, at = _long_payload(text, begin, rows, row, base)
        if at < 0:
            return at
        rows.length[row], rows.can_id[row] = count, identifier
        rows.flags[row] = TX_FLAG * (direction > 0) | (FD_FLAG if count > PAYLOAD_BYTES else 0)
        return end_of_line(text, at)
    if code >= MOST_CODES or (code < 0 and not is_remote):
        return NONE
    count = min(max(code, 0), PAYLOAD_BYTES)
    rows.length[row], rows.flags[row] = count, TX_FLAG * (direction > 0)
    rows.can_id[row] = identifier | (REMOTE_FLAG if is_remote else 0)
    at = payload(text, at, rows.data, row, 0 if is_remote else count, base, 0)
    while is_remote and code >= 0:  # some programs write bytes of a remote frame
        value, behind = whole_number(text, skip_blanks(text, at), HEXADECIMAL, BYTE_DIGITS)
        if value < 0:
            break
        at = behind
    return end_of_line(text, at) if at >= 0 else NONE


@part
def _long_payload(text: UInt8Array, begin: int, rows: FrameRows, row: int, base: int) -> tuple[int, int]:
    """Read a length beyond eight and its bytes; return their number and the position behind, or as ``_fd_frame``.

    The number of bytes decides what the length is: a code of CAN FD, a code of a classic frame, or that number.
    """
    code, at = whole_number(text, begin, base, 2)
    number, _ = whole_number(text, begin, DECIMAL, 2)
    count = 0
    while count <= FD_PAYLOAD_BYTES:
        start = skip_blanks(text, at)
        value, behind = whole_number(text, start, base, BYTE_DIGITS)
        if not 0 <= value <= MAX_BYTE or (base == HEXADECIMAL and behind != start + 2):
            break
        if count < rows.data.shape[1]:
            rows.data[row, count] = value
        count += 1
        at = behind
    is_by_code = code < MOST_CODES and (count == LENGTH_OF_CODE[code] or count == PAYLOAD_BYTES)
    if not is_by_code and not (count == number or count == code):  # noqa: PLR1714, SIM109 - no tuple
        return NONE, NONE
    if count > FD_PAYLOAD_BYTES or not IS_LENGTH[count]:
        return NONE, NONE
    if count > rows.data.shape[1]:
        return NONE, NONE - 1
    clear(rows.data, row, count)
    return count, at


@part
def _fd_frame(text: UInt8Array, at: int, rows: FrameRows, row: int, base: int) -> int:
    """Read ``Rx 123 [name] 1 0 9 12 11 22 ... duration length flags ...``; return the position behind, or NONE.

    A value below NONE: the rows are too short.
    """
    direction, at = read_direction(text, at)
    identifier, at = read_identifier(text, at, base)
    if not 48 <= text[at] <= 49 or text[at + 1] > BLANK:  # the name of a message
        at = skip_blanks(text, skip_word(text, at))
    is_fast, at = decimal_number(text, at)
    is_passive, at = decimal_number(text, at)
    code, at = whole_number(text, at, base, 2)
    count, behind = whole_number(text, skip_blanks(text, at), DECIMAL, 3)
    if min(identifier, is_fast, is_passive, code, count) < 0 or max(is_fast, is_passive) > 1 or code >= MOST_CODES:
        return NONE
    if count > rows.data.shape[1]:
        return NONE if count > FD_PAYLOAD_BYTES else NONE - 1
    behind = payload(text, behind, rows.data, row, count, base, 1)
    flags, end = _said_flags(text, behind) if behind >= 0 else (NONE, NONE)
    is_fd, is_remote = flags & SAID_FD != 0, flags & SAID_REMOTE != 0
    length = LENGTH_OF_CODE[code] if is_fd else min(code, PAYLOAD_BYTES)
    if end < 0 or (is_remote and is_fd) or (count != length and not (is_remote and count == 0)):
        return NONE
    if is_remote:
        clear(rows.data, row, 0)
    rows.length[row], rows.can_id[row] = length, identifier | (REMOTE_FLAG if is_remote else 0)
    kind = FD_FLAG | (BRS_FLAG * is_fast) | (ESI_FLAG * is_passive) if is_fd else 0
    rows.flags[row] = kind | TX_FLAG * (direction > 0)
    return end


@part
def _said_flags(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read the flags among the numbers behind a payload; return them and the position behind the line, or NONE.

    A line without flags is of CAN FD.
    """
    for place in range(FLAGS_PLACE + 1):
        begin = skip_blanks(text, at)
        if text[begin] == NEWLINE or (text[begin] == SLASH and text[begin + 1] == SLASH):
            return SAID_FD, skip_line(text, begin)
        value, at = 0, begin
        while HEX_VALUE[text[at]] >= 0:
            value = value << 4 | HEX_VALUE[text[at]]
            at += 1
        if at == begin or (text[at] > BLANK and text[at] != SLASH):
            return NONE, NONE
        if place == FLAGS_PLACE:
            return value, skip_line(text, at)
    return NONE, NONE


LONGEST_SHOWN = 60  # bytes of a date
HEADER = re.compile(rb"(?:date|base|no\s+internal|internal|begin|end|previous|split)\b|//", re.IGNORECASE)
START = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\S.*)", re.IGNORECASE)
BASE_LINE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
FIRST_LINE = re.compile(rb"base\s+(?:hex|dec)|(?:date|begin\s+triggerblock)\s+\S", re.IGNORECASE)
WHOLE_BYTE_AT_END = re.compile(rb"\s[0-9a-f]{2}\s*$", re.IGNORECASE)


class AscLog(KernelLog):
    """A log of Vector's tools; its header has the base of numbers and the start of times."""

    shortest_line_bytes = 13  # "0.0 1 1 Rx r"

    def __init__(self) -> None:
        super().__init__()
        self._clock = np.zeros(CLOCK_FIELDS, np.int64)
        self._clock[BASE] = HEXADECIMAL

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines up to one of a header."""
        parse_lines(text, rows, self._clock, progress)

    def read_comment(self, line: bytes) -> bool:
        if line and not HEADER.match(line):
            return False
        if base := BASE_LINE.match(line):
            self._clock[BASE] = DECIMAL if base["base"].lower() == b"dec" else HEXADECIMAL
            self._clock[IS_RELATIVE] = (base["kind"] or b"").lower() == b"relative"
        elif start := START.match(line):
            self._set_start(start["date"])
        return True

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether the line ends with a whole byte; behind those of a CANFD line are other numbers."""
        is_byte = self._clock[BASE] == HEXADECIMAL and WHOLE_BYTE_AT_END.search(line) is not None
        return is_byte and not frame.flags[0] & FD_FLAG

    def _set_start(self, date: bytes) -> None:
        start_us = date_us(date)
        self._clock[NOW_US] = 0
        if start_us is not None:
            self._clock[START_US] = start_us
        elif not self._clock[START_US]:
            shown = decoded(date[:LONGEST_SHOWN]).encode("ascii", "backslashreplace").decode()
            self.notes.append(f"the date {shown!r} is not understood: times count from 1970")


def is_asc_header(line: bytes) -> bool:
    """Return whether a line is one of those an ASC file begins with."""
    start = START.match(line)
    return bool(BASE_LINE.match(line)) or (start is not None and date_us(start["date"]) is not None)
