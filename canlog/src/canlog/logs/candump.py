"""candump's logs (``candump -l``), ``(1767225600.000000) vcan0 0A0#1122334455667788``, and what it prints for people.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.

What it prints is ``(1767225600.000000)  can0  TX - -  0A0   [4]  11 22 33 44               '."3D'``. Behind ``-t``
stands what its times are: ``a`` since the epoch, ``A`` a date in local time, ``z`` since the start, ``d`` since the
frame before. The last two look alike: times that keep falling are those of ``d``.
"""

import re
from datetime import date

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
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
    Frame,
    FrameBatch,
)
from canlog.jit import kernel, part
from canlog.logs.dates import date_us
from canlog.logs.text_kernels import (
    FRAME,
    HEX_VALUE,
    IS_LENGTH,
    LINES,
    MALFORMED,
    NEW_CHANNEL,
    NEWLINE,
    OTHER,
    POSITION,
    ROWS,
    SKIPPED,
    STOP,
    TOO_LONG,
    ChannelNames,
    FrameRows,
    NameWords,
    channel_number,
    clear,
    count_line,
    decimal,
    decimal_parts,
    digits,
    hex_bytes,
    skip_blanks,
    skip_line,
    skip_word,
)
from canlog.logs.text_log import MAX_LINE_BYTES, KernelLog, LineLog, frames_of

STANDARD_DIGITS, EXTENDED_DIGITS = 3, 8
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
ERROR_OR_ABOVE = 0x2000_0000  # written with eight digits, yet not an extended identifier
MAX_SECONDS_DIGITS, NS_DIGITS = 10, 9
NS_PER_S, NS_PER_US = 1_000_000_000, 1_000
FD_DIGIT_BITS = 0x03  # of the digit behind "##": bit rate switch and error state, as in ``flags``

# Characters of the grammar.
OPEN, CLOSE, POINT, HASH, UNDERSCORE = ord("("), ord(")"), ord("."), ord("#"), ord("_")
LETTER_R, LETTER_T, SMALL_R = ord("R"), ord("T"), ord("r")


@kernel
def parse_lines(text: UInt8Array, rows: FrameRows, names: NameWords, known: int, progress: Int64Array) -> None:
    """Parse lines from the position in ``progress`` on; ``known`` channels have a number."""
    at, line, row = progress[POSITION], progress[LINES], progress[ROWS]
    while at < len(text):
        outcome, behind = _parse_line(text, at, rows, row, names, known)
        if outcome >= TOO_LONG:
            progress[STOP] = outcome
            break
        row += outcome == FRAME
        line += 1
        count_line(progress, outcome, line)
        at = behind
    progress[POSITION], progress[LINES], progress[ROWS] = at, line, row


@part
def _parse_line(text: UInt8Array, at: int, rows: FrameRows, row: int, names: NameWords, known: int) -> tuple[int, int]:
    """Parse one line into one row; return the outcome and the position behind the line."""
    at = skip_blanks(text, at)
    if text[at] == NEWLINE:
        return SKIPPED, at + 1
    rows.t_ns[row], at = _parse_time(text, at)
    name_at = skip_blanks(text, at)
    identifier, at = _parse_id(text, skip_blanks(text, skip_word(text, name_at)))
    if rows.t_ns[row] < 0 or identifier < 0:
        return MALFORMED, skip_line(text, at)
    flags, limit = 0, PAYLOAD_BYTES
    if text[at] == HASH:
        if rows.data.shape[1] < FD_PAYLOAD_BYTES:
            return TOO_LONG, at
        digit = HEX_VALUE[text[at + 1]]
        if digit < 0:
            return MALFORMED, skip_line(text, at)
        flags, limit, at = FD_FLAG | (digit & FD_DIGIT_BITS), FD_PAYLOAD_BYTES, at + 2
    if limit == PAYLOAD_BYTES and (text[at] == LETTER_R or text[at] == SMALL_R):
        identifier |= REMOTE_FLAG
        clear(rows.data, row, 0)
        length, at = decimal(text, at + 1, 1)
    else:
        length, at = hex_bytes(text, at, row, rows.data, limit, POINT)
    rows.can_id[row], rows.length[row] = identifier, length
    is_sent, at = _parse_tail(text, at)
    rows.flags[row] = flags | TX_FLAG * is_sent
    if at < 0 or not IS_LENGTH[length]:
        return MALFORMED, at if at > 0 else skip_line(text, -at)
    number = channel_number(text, name_at, names, known)
    rows.channel[row] = max(number, 0)
    return (FRAME if number >= 0 else NEW_CHANNEL), at


@part
def _parse_time(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``(seconds.fraction)``; return the time [ns], -1 if it is none, and the position behind it."""
    if text[at] != OPEN:
        return -1, at
    begin = at + 1
    seconds, at = decimal(text, begin, MAX_SECONDS_DIGITS)
    if at == begin or text[at] != POINT:
        return -1, at
    begin = at + 1
    fraction, at = decimal_parts(text, begin, NS_PER_S, NS_DIGITS)
    if at == begin or text[at] != CLOSE:
        return -1, at
    return seconds * NS_PER_S + fraction // NS_PER_US * NS_PER_US, at + 1


@part
def _parse_id(text: UInt8Array, at: int) -> tuple[int, int]:
    """Parse ``123#`` or ``12345678#``; return the identifier with its flags, -1 if it is none, and the position."""
    begin = at
    value, at = digits(text, begin, 16, EXTENDED_DIGITS)
    count = at - begin
    if text[at] != HASH or value > MAX_ID:
        return -1, at
    if count == EXTENDED_DIGITS:
        return (value | EXTENDED_FLAG if value < ERROR_OR_ABOVE else value), at + 1
    if count == STANDARD_DIGITS and value <= MAX_STANDARD_ID:
        return value, at + 1
    return -1, at


@part
def _parse_tail(text: UInt8Array, at: int) -> tuple[bool, int]:
    """Pass over what may follow a payload; return whether the frame was sent, and the position behind the line.

    The position is negative if anything else follows.
    """
    if text[at] == UNDERSCORE and HEX_VALUE[text[at + 1]] > PAYLOAD_BYTES:
        at += 2  # the raw length code above eight that some controllers send
    behind = skip_blanks(text, at)
    has_direction = behind > at and (text[behind] == LETTER_T or text[behind] == LETTER_R)  # that candump -x appends
    is_sent = has_direction and text[behind] == LETTER_T
    if has_direction:
        behind = skip_blanks(text, behind + 1)
    return is_sent, behind + 1 if text[behind] == NEWLINE else -behind


class CandumpLog(KernelLog):
    shortest_line_bytes = 12  # "(0.0)c 123#"

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines; a channel that is met for the first time gets its number."""
        parse_lines(text, rows, self._channels.words, len(self._channels), progress)
        if progress[STOP] == NEW_CHANNEL:
            line = text[progress[POSITION] :][:MAX_LINE_BYTES].tobytes()
            self._channels.add(line.partition(b")")[2].split(maxsplit=1)[0])

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether a payload is so long that no byte can be missing."""
        return frame.length[0] in {PAYLOAD_BYTES, FD_PAYLOAD_BYTES}


DAY_S = 86_400
LAST_S = 9_200_000_000  # the year 2261: nanoseconds must fit 64 bits
FD_LENGTH_DIGITS = 2
BRS_PLACE, ESI_PLACE = 3, 5  # from the direction on
BINARY_DIGITS = 8
EPOCH = date(1970, 1, 1)
FIRST_SHOWN, LAST_SHOWN = 0x20, 0x7E  # bytes that -a shows as they are; a point stands for the others

_SHOWN = rb"(?:[ \t\r]|\x1b[^m]*(?:m|\Z))*+"  # blanks and colours
_WORD = rb"[^\x00-\x20]*+"
_BYTE = rb"(?:[01]{8}|[0-9A-Fa-f]{2}(?![01]))"  # of -i, or as a rule
_LINE = re.compile(
    rb"%(s)s(?:\((?:(?P<date>\d{1,4}-\d\d?-\d\d? \d\d?:\d\d?:\d\d?)|(?P<seconds>\d{1,10}))"
    rb"\.(?P<fraction>\d{1,9})\)|(?!\())"
    rb"%(s)s(?P<name>%(w)s)%(s)s(?:(?P<direction>[RT]X)(?= )%(s)s%(w)s%(s)s%(w)s%(s)s)?+"
    rb"(?P<id>[0-9A-Fa-f]{1,8})(?=[\x00-\x20])%(s)s"
    rb"(?:\{(?P<code>[0-9A-Fa-f])\}|\[(?P<length>\d\d?)\])%(s)s"
    rb"(?:(?P<remote>remote request)|(?P<bytes>%(b)s(?:(?P<between>[ `])%(b)s(?:(?P=between)%(b)s)*+)?)?%(s)s"
    rb"(?:(?P<error>ERRORFRAME)|(?P<mark>['`])(?P<shown>.*)(?P=mark))?)%(s)s"
    % {b"s": _SHOWN, b"w": _WORD, b"b": _BYTE},
    re.DOTALL,
)  # fmt: skip
_BEGINNING = re.compile(_SHOWN)


def _time_ns(match: re.Match[bytes]) -> int:
    """Return the time of a line [ns], whole microseconds; a date as if it were UTC; -1 if there is no such time."""
    seconds = int(match["seconds"] or 0)
    if match["date"]:
        year, month, day, hour, minute, second = (int(part) for part in re.split(rb"[- :]", match["date"]))
        if hour > 23 or minute > 59 or second > 60:
            return -1
        try:
            days = (date(year, month, day) - EPOCH).days
        except ValueError:
            return -1
        seconds = days * DAY_S + hour * 3600 + minute * 60 + second
    if not 0 <= seconds <= LAST_S:
        return -1
    return seconds * NS_PER_S + int((match["fraction"] or b"").ljust(NS_DIGITS, b"0")) // NS_PER_US * NS_PER_US


def _identifier(digits: bytes, *, is_padded: bool) -> int:
    """Return an identifier with its flags, -1 if it is too large, or has too few digits where zeros stand before."""
    value = int(digits, 16)
    if not is_padded and len(digits) < EXTENDED_DIGITS:
        return value if value <= MAX_STANDARD_ID else value | EXTENDED_FLAG
    if len(digits) not in {STANDARD_DIGITS, EXTENDED_DIGITS}:
        return -1
    if len(digits) == STANDARD_DIGITS:
        return value if value <= MAX_STANDARD_ID else -1
    return -1 if value > MAX_ID else value if value & ERROR_FLAG else value | EXTENDED_FLAG


def _length(match: re.Match[bytes]) -> int:
    """Return the length of a frame, -1 if there is none such."""
    if match["code"]:
        return min(int(match["code"], 16), PAYLOAD_BYTES)
    value, most = int(match["length"]), FD_PAYLOAD_BYTES if len(match["length"]) == FD_LENGTH_DIGITS else PAYLOAD_BYTES
    return value if value <= most and IS_LENGTH[value] else -1


def _payload(match: re.Match[bytes], length: int) -> bytes | None:
    """Return the bytes of a frame, None if they are not so many or others are shown behind them."""
    words = re.findall(_BYTE, match["bytes"] or b"")
    data = bytes(int(word, 2 if len(word) == BINARY_DIGITS else 16) for word in words)
    data = data[::-1] if match["between"] == b"`" else data
    shown = bytes(byte if FIRST_SHOWN <= byte <= LAST_SHOWN else ord(".") for byte in data)
    is_shown = match["mark"] is None or match["shown"] == (shown if match["mark"] == b"'" else shown[::-1])
    return data if len(data) == length and is_shown else None


COLOUR = re.compile(rb"\x1b\[[\d;]*m")
TIME = re.compile(rb"^\s*\((?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+|)(?P<count>\d+\.\d+|)\)\s", re.MULTILINE)
EPOCH_DIGITS = 9  # seconds since the epoch have had as many since 1973
LEAST_FALLS = 0.1  # share of all steps between times; those of one clock never fall so often
NO_TIMES = "the log has no times (candump -t): every frame gets the time 1970-01-01 00:00:00"


class ConsoleLog(LineLog):
    """A log as candump prints it without ``-L``."""

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()
        self._base_ns = self._now_ns = 0
        self._is_delta = self._is_padded = False

    def look_ahead(self, text: bytes) -> None:
        """Find out what the times are, and whether identifiers have zeros before them."""
        text = COLOUR.sub(b"", text)
        identifiers = {line["id"] for row in text.splitlines() if (line := _LINE.fullmatch(row))}
        is_short = {len(digits) not in {STANDARD_DIGITS, EXTENDED_DIGITS} for digits in identifiers}
        self._is_padded = True not in is_short or any(len(one) > 1 and one.startswith(b"0") for one in identifiers)
        if not self._is_padded:
            self.notes.append("identifiers are written without leading zeros: those above 7FF are taken as of 29 bits")
        times = list(TIME.finditer(text))
        if not times:
            self.notes.append(NO_TIMES)
        elif shown := times[0]["date"]:
            # Dates are local time, all with the offset of the first.
            as_utc, local_us = frames_of(ConsoleLog(), b"(" + shown + b") c 000 [0]").t_ns, date_us(shown)
            if local_us is not None and len(as_utc):
                self._base_ns = local_us * NS_PER_US - int(as_utc[0])
        elif len(times[0]["count"].partition(b".")[0]) < EPOCH_DIGITS:
            times_s = np.array([float(time["count"]) for time in times if time["count"]])
            steps_s = np.diff(times_s)  # times since the frame before fall somewhere, or are all the same
            is_constant = len(times_s) > 2 and times_s[1] > 0.0 and not steps_s[1:].any()
            self._is_delta = bool(is_constant or np.count_nonzero(steps_s < 0.0) > LEAST_FALLS * len(steps_s))
            kind = "frame before (candump -t d)" if self._is_delta else "start (candump -t z)"
            self.notes.append(f"times are taken as those since the {kind}, and count from 1970")

    def read_line(self, line: bytes) -> Frame | int:
        """Return the frame of a line, or what else it is."""
        begin = _BEGINNING.match(line)
        rest = line[begin.end() :] if begin else line
        if not rest or line.startswith(b"\t"):  # behind a tabulator -e says what an error frame means
            return SKIPPED
        if rest.startswith(b"DROPCOUNT:"):
            return OTHER
        match = _LINE.fullmatch(line)
        if match is None:
            return MALFORMED
        t_ns, can_id, length = _time_ns(match), _identifier(match["id"], is_padded=self._is_padded), _length(match)
        if min(t_ns, can_id, length) < 0:
            return MALFORMED
        data = bytes(length) if match["remote"] else _payload(match, length)
        now_ns = t_ns + (self._now_ns if self._is_delta else self._base_ns)
        if data is None or (match["error"] and not can_id & ERROR_FLAG) or not 0 <= now_ns <= LAST_S * NS_PER_S:
            return MALFORMED
        flags = TX_FLAG if match["direction"] == b"TX" else 0
        if match["length"] and len(match["length"]) == FD_LENGTH_DIGITS:
            marks = line[match.start("direction") :] if match["direction"] else b""
            is_fast, is_passive = marks[BRS_PLACE:][:1] == b"B", marks[ESI_PLACE:][:1] == b"E"
            flags |= FD_FLAG | BRS_FLAG * is_fast | ESI_FLAG * is_passive
        self._now_ns = now_ns
        can_id |= REMOTE_FLAG if match["remote"] else 0
        return Frame(now_ns, can_id, length, data, flags, self._channels.number(match["name"]))

    def read_comment(self, line: bytes) -> bool:
        """Note that candump lost frames."""
        is_known = line.startswith(b"DROPCOUNT: ")
        if is_known:
            self.notes.append("candump lost frames before it could print them: its lines DROPCOUNT say how many")
        return is_known

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether as many bytes are there as the length; of none, "remote request" might be missing."""
        return bool(frame.length[0]) or bool(frame.can_id[0] & np.uint32(REMOTE_FLAG))
