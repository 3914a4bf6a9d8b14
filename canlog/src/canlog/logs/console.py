"""What candump prints for people: ``(1767225600.000000)  can0  TX - -  0A0   [4]  11 22 33 44               '."3D'``.

Behind ``-t`` stands what its times are: ``a`` since the epoch, ``A`` a date in local time, ``z`` since the start, ``d``
since the frame before. The last two look alike: times that keep falling are those of ``d``.
"""

import re
from datetime import date

import numpy as np

from canlog.frames import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    Frame,
    FrameBatch,
)
from canlog.logs.dates import date_us
from canlog.logs.text_kernels import (
    IS_LENGTH,
    MALFORMED,
    OTHER,
    SKIPPED,
    ChannelNames,
)
from canlog.logs.text_log import LineLog, frames_of

NS_PER_S, NS_PER_US, DAY_S = 1_000_000_000, 1_000, 86_400
NS_DIGITS = 9
LAST_S = 9_200_000_000  # the year 2261: nanoseconds must fit 64 bits
STANDARD_DIGITS, FD_LENGTH_DIGITS = 3, 2
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x3FFF_FFFF
BRS, ESI = 1, 2  # as ``flags`` has them
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
    rb"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})(?=[\x00-\x20])%(s)s"
    rb"(?:\{(?P<code>[0-9A-Fa-f])\}|\[(?P<length>\d\d?)\])%(s)s"
    rb"(?:(?P<remote>remote request)|(?P<bytes>%(b)s(?:(?P<between>[ `])%(b)s(?:(?P=between)%(b)s)*+)?)?%(s)s"
    rb"(?:(?P<error>ERRORFRAME)|(?P<mark>['`])(?P<shown>.*)(?P=mark))?)%(s)s"
    % {b"s": _SHOWN, b"w": _WORD, b"b": _BYTE},
    re.DOTALL,
)  # fmt: skip
_BEGINNING = re.compile(_SHOWN)


def _time_ns(found: re.Match[bytes]) -> int:
    """Return the time of a line [ns], whole microseconds; a date as if it were UTC; -1 if there is no such time."""
    seconds = int(found["seconds"] or 0)
    if found["date"]:
        year, month, day, hour, minute, second = (int(one) for one in re.split(rb"[- :]", found["date"]))
        if hour > 23 or minute > 59 or second > 60:
            return -1
        try:
            days = (date(year, month, day) - EPOCH).days
        except ValueError:
            return -1
        seconds = days * DAY_S + hour * 3600 + minute * 60 + second
    if not 0 <= seconds <= LAST_S:
        return -1
    return seconds * NS_PER_S + int((found["fraction"] or b"").ljust(NS_DIGITS, b"0")) // NS_PER_US * NS_PER_US


def _identifier(digits: bytes) -> int:
    """Return an identifier with its flags, -1 if it is too large."""
    value = int(digits, 16)
    if len(digits) == STANDARD_DIGITS:
        return value if value <= MAX_STANDARD_ID else -1
    return -1 if value > MAX_ID else value if value & ERROR_FLAG else value | EXTENDED_FLAG


def _length(found: re.Match[bytes]) -> int:
    """Return the length of a frame, -1 if there is none such."""
    if found["code"]:
        return min(int(found["code"], 16), PAYLOAD_BYTES)
    value, most = int(found["length"]), FD_PAYLOAD_BYTES if len(found["length"]) == FD_LENGTH_DIGITS else PAYLOAD_BYTES
    return value if value <= most and IS_LENGTH[value] else -1


def _payload(found: re.Match[bytes], length: int) -> bytes | None:
    """Return the bytes of a frame, None if they are not so many or others are shown behind them."""
    words = re.findall(_BYTE, found["bytes"] or b"")
    data = bytes(int(one, 2 if len(one) == BINARY_DIGITS else 16) for one in words)
    data = data[::-1] if found["between"] == b"`" else data
    shown = bytes(one if FIRST_SHOWN <= one <= LAST_SHOWN else ord(".") for one in data)
    is_shown = found["mark"] is None or found["shown"] == (shown if found["mark"] == b"'" else shown[::-1])
    return data if len(data) == length and is_shown else None


COLOUR = re.compile(rb"\x1b\[[\d;]*m")
TIME = re.compile(rb"^\s*\((?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+|)(?P<count>\d+\.\d+|)\)\s", re.MULTILINE)
EPOCH_DIGITS = 9  # seconds since the epoch have had as many since 1973
LEAST_FALLS = 0.1  # of all steps between times: so many times of one clock never fall
NO_TIMES = "the log has no times (candump -t): every frame gets the time 1970-01-01 00:00:00"


class ConsoleLog(LineLog):
    """A log as candump prints it without ``-L``."""

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()
        self._base_ns = self._now_ns = 0
        self._is_delta = False

    def look_ahead(self, text: bytes) -> None:
        """Find out what the times are."""
        found = list(TIME.finditer(COLOUR.sub(b"", text)))
        if not found:
            self.notes.append(NO_TIMES)
        elif shown := found[0]["date"]:
            # Dates are local time, all with the offset of the first.
            as_utc, local_us = frames_of(ConsoleLog(), b"(" + shown + b") c 000 [0]").t_ns, date_us(shown)
            if local_us is not None and len(as_utc):
                self._base_ns = local_us * NS_PER_US - int(as_utc[0])
        elif len(found[0]["count"].partition(b".")[0]) < EPOCH_DIGITS:
            times_s = np.array([float(one["count"]) for one in found if one["count"]])
            steps_s = np.diff(times_s)  # of times since the frame before some fall, or all are the same above zero
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
        found = _LINE.fullmatch(line)
        if found is None:
            return MALFORMED
        t_ns, can_id, length = _time_ns(found), _identifier(found["id"]), _length(found)
        if min(t_ns, can_id, length) < 0:
            return MALFORMED
        data = bytes(length) if found["remote"] else _payload(found, length)
        now_ns = t_ns + (self._now_ns if self._is_delta else self._base_ns)
        if data is None or (found["error"] and not can_id & ERROR_FLAG) or not 0 <= now_ns <= LAST_S * NS_PER_S:
            return MALFORMED
        flags = TX_FLAG if found["direction"] == b"TX" else 0
        if found["length"] and len(found["length"]) == FD_LENGTH_DIGITS:
            marks = line[found.start("direction") :] if found["direction"] else b""
            is_fast, is_passive = marks[BRS_PLACE:][:1] == b"B", marks[ESI_PLACE:][:1] == b"E"
            flags |= FD_FLAG | BRS * is_fast | ESI * is_passive
        self._now_ns = now_ns
        can_id |= REMOTE_FLAG if found["remote"] else 0
        return Frame(now_ns, can_id, length, data, flags, self._channels.number(found["name"]))

    def read_comment(self, line: bytes) -> bool:
        """Take up that candump says it lost frames."""
        is_known = line.startswith(b"DROPCOUNT: ")
        if is_known:
            self.notes.append("candump lost frames before it could print them: its lines DROPCOUNT say how many")
        return is_known

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether all is there that the length speaks of; without bytes "remote request" might be missing."""
        return bool(frame.length[0]) or bool(frame.can_id[0] & np.uint32(REMOTE_FLAG))
