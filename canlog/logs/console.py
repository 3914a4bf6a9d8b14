"""What candump prints for people: ``(1767225600.000000)  can0  TX - -  0A0   [4]  11 22 33 44               '."3D'``.

Behind ``-t`` stands what its times are: ``a`` since the epoch, ``A`` a date in local time, ``z`` since the start, ``d``
since the frame before. The last two look alike: times that keep falling are those of ``d``.
"""

import re

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
)
from canlog.jit import array_kernel
from canlog.logs.dates import date_us
from canlog.logs.frame_buffer import ChannelNames, FrameRows, NameWords, channel_number
from canlog.logs.text_kernels import (
    BLANK,
    FRAME,
    HEX_PAIR,
    IS_LENGTH,
    LINES,
    MALFORMED,
    NEW_CHANNEL,
    NEWLINE,
    OTHER,
    POSITION,
    RETURN,
    ROWS,
    SKIPPED,
    STOP,
    TAB,
    TOO_LONG,
    count_line,
    day_number,
    decimal,
    decimal_parts,
    digits,
    skip_line,
    skip_word,
)
from canlog.logs.text_log import MAX_LINE_BYTES, TextLog, frames_of

# What times are relative to.
BASE_NS, NOW_NS, IS_DELTA, CLOCK_FIELDS = range(4)

NS_PER_S, NS_PER_US, DAY_S = 1_000_000_000, 1_000, 86_400
MAX_SECONDS_DIGITS, NS_DIGITS = 10, 9
NO_TIME = -(1 << 62)
LAST_S = 9_200_000_000  # the year 2261: nanoseconds must fit 64 bits
STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
BRS, ESI = 1, 2  # as ``flags`` has them

# Characters of the grammar.
ESCAPE, POINT = 27, ord(".")
OPEN, CLOSE, COLON, MINUS = ord("("), ord(")"), ord(":"), ord("-")
SQUARE, SQUARE_END, CURLED, CURLED_END = ord("["), ord("]"), ord("{"), ord("}")
TICK, QUOTE, ZERO, ONE = ord("`"), ord("'"), ord("0"), ord("1")
LETTER_B, LETTER_E, LETTER_R, LETTER_T, LETTER_X, SMALL_M = ord("B"), ord("E"), ord("R"), ord("T"), ord("X"), ord("m")
DROPCOUNT = np.frombuffer(b"DROPCOUNT:", np.uint8)
REMOTE_WORDS = np.frombuffer(b"remote request", np.uint8)
ERROR_WORD = np.frombuffer(b"ERRORFRAME", np.uint8)
FIRST_SHOWN, LAST_SHOWN = 0x20, 0x7E  # bytes that -a shows as they are; a point stands for the others


@array_kernel
def parse_lines(
    text: UInt8Array, rows: FrameRows, names: NameWords, known: int, clock: Int64Array, progress: Int64Array
) -> None:
    """Parse lines from where the progress says, up to one of lost frames; ``known`` channels have a number."""
    at, line, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        outcome, behind = _parse_line(text, at, rows, row, names, known)
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        if outcome == FRAME:
            now_ns = rows.t_ns[row] + (clock[NOW_NS] if clock[IS_DELTA] else clock[BASE_NS])
            if 0 <= now_ns <= LAST_S * NS_PER_S:
                clock[NOW_NS] = now_ns
                rows.t_ns[row] = now_ns
                row += 1
            else:
                outcome = MALFORMED
        line += 1
        count_line(progress, outcome, line)
        at = behind
    progress[POSITION], progress[LINES], progress[ROWS] = at, line, row


@array_kernel
def _parse_line(  # noqa: PLR0911 - one for each outcome
    text: UInt8Array, at: int, rows: FrameRows, row: int, names: NameWords, known: int
) -> tuple[int, int]:
    """Parse one line into one row; return the outcome and the position behind the line."""
    begin = _skip_shown(text, at)
    if text[begin] == NEWLINE or text[at] == TAB:  # behind a tabulator -e says what an error frame means
        return SKIPPED, skip_line(text, begin)
    if _behind(text, begin, DROPCOUNT) > 0:
        return OTHER, at
    rows.t_ns[row], name_at = _read_time(text, begin)
    if name_at < 0:
        return MALFORMED, skip_line(text, -name_at)
    name_at = _skip_shown(text, name_at)
    flags, at = _read_direction(text, _skip_shown(text, skip_word(text, name_at)))
    identifier, at = _read_id(text, at)
    length, is_fd, at = _read_length(text, _skip_shown(text, at))
    if identifier < 0 or length < 0:
        return MALFORMED, skip_line(text, abs(at))
    if length > rows.data.shape[1]:
        return TOO_LONG, begin
    rows.can_id[row], rows.length[row] = identifier, length
    rows.flags[row] = flags & TX_FLAG | (FD_FLAG | flags & (BRS | ESI) if is_fd else 0)
    at = _read_payload(text, at, rows, row, length)
    if at < 0:
        return MALFORMED, skip_line(text, -at)
    number = channel_number(text, name_at, names, known)
    rows.channel[row] = max(number, 0)
    return (FRAME if number >= 0 else NEW_CHANNEL), at


@array_kernel
def _skip_shown(text: UInt8Array, at: int) -> int:
    """Return the position of the next character that is neither blank nor part of a colour."""
    while True:
        while text[at] == BLANK or text[at] == TAB or text[at] == RETURN:
            at += 1
        if text[at] != ESCAPE:
            return at
        while text[at] != SMALL_M:
            if text[at] == NEWLINE:
                return at
            at += 1
        at += 1


@array_kernel
def _behind(text: UInt8Array, at: int, word: UInt8Array) -> int:
    """Return the position behind a word that stands here, -1 if it does not."""
    for index in range(len(word)):
        if text[at + index] != word[index]:
            return -1
    return at + len(word)


@array_kernel
def _read_direction(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read what -x puts before an identifier, ``TX B E``; return the flags and where the identifier begins."""
    is_direction = (text[at] == LETTER_R or text[at] == LETTER_T) and text[at + 1] == LETTER_X
    if not is_direction or text[at + 2] != BLANK:
        return 0, at
    flags = TX_FLAG if text[at] == LETTER_T else 0
    flags |= BRS if text[at + 3] == LETTER_B else 0
    flags |= ESI if text[at + 3] != NEWLINE and text[at + 4] != NEWLINE and text[at + 5] == LETTER_E else 0
    at = skip_word(text, _skip_shown(text, at + 2))
    at = skip_word(text, _skip_shown(text, at))
    return flags, _skip_shown(text, at)


@array_kernel
def _read_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read three digits, or eight of an extended identifier or an error frame; -1 if it is none of them."""
    begin = at
    value, at = digits(text, begin, 16, EXTENDED_DIGITS)
    if text[at] > BLANK or value > MAX_ID:
        return -1, at
    if at - begin == EXTENDED_DIGITS:
        return (value if value & ERROR_FLAG else value | EXTENDED_FLAG), at
    return (value if at - begin == STANDARD_DIGITS and value <= MAX_STANDARD_ID else -1), at


@array_kernel
def _read_length(text: UInt8Array, at: int) -> tuple[int, int, int]:
    """Read ``[8]``, ``{F}`` of -8, or ``[08]`` of a CAN FD frame; return the length, -1 if it is none, and whether."""
    begin = at + 1
    if text[at] == CURLED:
        value, at = digits(text, begin, 16, 1)
        is_read = at > begin and text[at] == CURLED_END
        return (min(value, PAYLOAD_BYTES) if is_read else -1), 0, at + is_read
    if text[at] != SQUARE:
        return -1, 0, at
    value, at = decimal(text, begin, 3)
    is_fd = at - begin == 2
    if text[at] != SQUARE_END or not begin < at <= begin + 2 or value > (FD_PAYLOAD_BYTES if is_fd else PAYLOAD_BYTES):
        return -1, 0, at
    return (value if IS_LENGTH[value] else -1), int(is_fd), at + 1


@array_kernel
def _read_payload(text: UInt8Array, at: int, rows: FrameRows, row: int, count: int) -> int:
    """Read the bytes of a frame and what may follow them; return the position behind the line, negative if not."""
    rows.data[row, :] = 0
    word_at = _skip_shown(text, at)
    behind = _behind(text, word_at, REMOTE_WORDS)
    if behind > 0:
        rows.can_id[row] |= np.uint32(REMOTE_FLAG)
        return _end(text, behind)
    at, is_swapped = word_at, False
    for index in range(count):
        if index > 0:
            if text[at] != (TICK if is_swapped else BLANK) and (text[at] != TICK or index > 1):
                return -at
            is_swapped = text[at] == TICK
            at += 1
        value, at = _read_byte(text, at)
        if value < 0:
            return -at
        rows.data[row, index] = value
    for index in range(count // 2 if is_swapped else 0):
        other = count - 1 - index
        rows.data[row, index], rows.data[row, other] = rows.data[row, other], rows.data[row, index]
    at = _skip_shown(text, at)
    if rows.can_id[row] & np.uint32(ERROR_FLAG) and _behind(text, at, ERROR_WORD) > 0:
        at = _behind(text, at, ERROR_WORD)
    elif text[at] == QUOTE or text[at] == TICK:
        at = _read_shown(text, at, rows.data, row, count)
    return _end(text, at) if at >= 0 else at


@array_kernel
def _read_byte(text: UInt8Array, at: int) -> tuple[int, int]:
    """Read two hexadecimal digits, or the eight binary ones of -i; -1 if it is neither."""
    if text[at] == NEWLINE or text[at + 1] == NEWLINE:
        return -1, at
    if text[at + 2] != ZERO and text[at + 2] != ONE:
        pair = int(HEX_PAIR[text[at], text[at + 1]])
        return pair, at + (2 if pair >= 0 else 0)
    value = 0
    for _ in range(8):
        if text[at] != ZERO and text[at] != ONE:
            return -1, at
        value = value << 1 | int(text[at] == ONE)
        at += 1
    return value, at


@array_kernel
def _read_shown(text: UInt8Array, at: int, data: UInt8Array, row: int, count: int) -> int:
    """Pass over what -a shows, which must be the characters of the bytes; the mark before it says their order."""
    mark = text[at]
    at += 1
    for index in range(count):
        byte = data[row, index if mark == QUOTE else count - 1 - index]
        shown = byte if FIRST_SHOWN <= byte <= LAST_SHOWN else POINT
        if text[at] != shown:
            return -at
        at += 1
    return at + 1 if text[at] == mark else -at


@array_kernel
def _end(text: UInt8Array, at: int) -> int:
    """Return the position behind a line that ends here, negative if something else follows."""
    at = _skip_shown(text, at)
    return at + 1 if text[at] == NEWLINE else -at


@array_kernel
def _read_time(text: UInt8Array, at: int) -> tuple[int, int]:
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
    return (day_number(year, month, day) * DAY_S + hour * 3600 + minute * 60 + second), at


@array_kernel
def _number_behind(text: UInt8Array, at: int, mark: int, limit: int) -> tuple[int, int]:
    """Read a mark and the number behind it; the position is negative, and stays so, if they are not there."""
    if at < 0 or text[at] != mark:
        return 0, -abs(at)
    begin = at + 1
    value, at = decimal(text, begin, 2)
    return (value, at) if at > begin and value <= limit else (0, -at)


COLOUR = re.compile(rb"\x1b\[[\d;]*m")
TIME = re.compile(rb"^\s*\((?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+|)(?P<count>\d+\.\d+|)\)\s", re.MULTILINE)
_BLANK = rb"(?:\x1b[^m\n]*m|[ \t\r])*"  # colours as well, as the compiled reader passes over them
NAME = re.compile(_BLANK + rb"(?:\([^)\n]*\)" + _BLANK + rb")?(?P<name>[^\x00-\x20]+)")
EPOCH_DIGITS = 9  # seconds since the epoch have had as many since 1973
LEAST_FALLS = 0.1  # of all steps between times: so many times of one clock never fall
NO_TIMES = "the log has no times (candump -t): every frame gets the time 1970-01-01 00:00:00"


class ConsoleLog(TextLog):
    """A log as candump prints it without ``-L``."""

    shortest_line_bytes = 9  # "c 123 [0]"

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()
        self._clock = np.zeros(CLOCK_FIELDS, np.int64)

    def look_ahead(self, text: bytes) -> None:
        """Find out what the times are."""
        found = list(TIME.finditer(COLOUR.sub(b"", text)))
        if not found:
            self.notes.append(NO_TIMES)
        elif date := found[0]["date"]:
            # Dates are local time, all with the offset of the first.
            as_utc, local_us = frames_of(ConsoleLog(), b"(" + date + b") c 000 [0]").t_ns, date_us(date)
            if local_us is not None and len(as_utc):
                self._clock[BASE_NS] = local_us * NS_PER_US - int(as_utc[0])
        elif len(found[0]["count"].partition(b".")[0]) < EPOCH_DIGITS:
            times_s = np.array([float(one["count"]) for one in found if one["count"]])
            steps_s = np.diff(times_s)  # of times since the frame before some fall, or all are the same above zero
            is_constant = len(times_s) > 2 and times_s[1] > 0.0 and not steps_s[1:].any()
            self._clock[IS_DELTA] = is_constant or np.count_nonzero(steps_s < 0.0) > LEAST_FALLS * len(steps_s)
            kind = "frame before (candump -t d)" if self._clock[IS_DELTA] else "start (candump -t z)"
            self.notes.append(f"times are taken as those since the {kind}, and count from 1970")

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines; a channel that is met for the first time gets its number."""
        parse_lines(text, rows, self._channels.words, len(self._channels), self._clock, progress)
        if progress[STOP] == NEW_CHANNEL:
            line = NAME.match(text[progress[POSITION] :][:MAX_LINE_BYTES].tobytes())
            self._channels.add(line["name"] if line else b"")

    def read_comment(self, line: bytes) -> bool:
        """Take up that candump says it lost frames."""
        is_known = line.startswith(b"DROPCOUNT: ")
        if is_known:
            self.notes.append("candump lost frames before it could print them: its lines DROPCOUNT say how many")
        return is_known

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether all is there that the length speaks of; without bytes "remote request" might be missing."""
        return bool(frame.length[0]) or bool(frame.can_id[0] & np.uint32(REMOTE_FLAG))
