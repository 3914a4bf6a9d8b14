"""Vector ASC logs, line by line, to columns.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from typing import BinaryIO

import numpy as np

from diag_service.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from diag_service.sources.columns import NS_PER_US
from diag_service.sources.tally import LogReject, Tally

FRAMES_PER_BATCH = 65_536
MAX_LINE_BYTES = 65_536
US_PER_S = 1_000_000
EDL_FLAG = 0x1000  # in the flags of a CANFD line
MAX_EXTENDED_ID = 0x1FFF_FFFF
MAX_STANDARD_ID = 0x7FF

HEADER = re.compile(rb"(?:date|base|no\s+internal|internal|begin|end|previous|split)\b|//", re.IGNORECASE)
START = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\S.*)", re.IGNORECASE)
BASE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
STAMPED = re.compile(rb"(?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\s+(?P<event>\S.*)")
CLASSIC = re.compile(
    rb"\d+\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?:Rx|Tx)\s+(?P<kind>[dr])"
    rb"(?:\s+(?P<length>[0-9a-f]))?(?P<data>(?:\s+[0-9a-f]{1,3})*)(?:\s+\w+\s*=.*)?$",
    re.IGNORECASE,
)
FD = re.compile(
    rb"CANFD\s+\d+\s+(?:Rx|Tx)\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?:[a-z_]\w*\s+)?[01]\s+[01]\s+"
    rb"(?P<length>[0-9a-f])\s+(?P<count>\d+)(?P<rest>(?:\s+[0-9a-f]+)*)$",
    re.IGNORECASE,
)
ERROR = re.compile(rb"(?:CANFD\s+)?\d+\s+(?:(?:Rx|Tx)\s+)?ErrorFrame\b", re.IGNORECASE)
FRAME_LIKE = re.compile(rb"(?:CANFD\s+\d+|\d+\s+\S+)\s+(?:Rx|Tx)\b", re.IGNORECASE)
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]|\xff")  # in no text of either encoding
WHOLE_BYTE_AT_END = re.compile(rb"\s[0-9a-f]{2}$", re.IGNORECASE)

MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9,
    "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
DATE = re.compile(
    r"\w+\s+(?P<month>\w{3})\w*\s+(?P<day>\d{1,2})\s+(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)"
    r"(?:\.(?P<ms>\d{1,3}))?\s*(?P<half>am|pm)?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class _Frame:
    can_id: int
    length: int
    payload: bytes


@dataclass(slots=True)
class _Rows:
    """Frames gathered for one batch."""

    t_us: list[int] = field(default_factory=list)
    frames: list[_Frame] = field(default_factory=list)

    def to_batch(self) -> FrameBatch:
        payload = b"".join(frame.payload.ljust(PAYLOAD_BYTES, b"\0") for frame in self.frames)
        return FrameBatch(
            t_ns=np.array(self.t_us, np.int64) * NS_PER_US,
            can_id=np.array([frame.can_id for frame in self.frames], np.uint32),
            length=np.array([frame.length for frame in self.frames], np.uint8),
            data=np.frombuffer(payload, np.uint8).reshape(-1, PAYLOAD_BYTES),
        )


class _Parser:
    """What the header lines of an ASC file say about the lines that follow."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._start_us = 0
        self._now_us = 0
        self._base = 16
        self._is_relative = False

    def parse(self, line: bytes, number: int, *, is_terminated: bool) -> tuple[int, _Frame] | None:
        """Return time [us] and frame of a line; None, after counting it, if there is none."""
        stamped = STAMPED.match(line)
        if stamped is None:
            self._take_header(line, number, is_terminated=is_terminated)
            return None
        t_us = self._time_us(stamped)
        event = stamped["event"]
        frame = self._frame(event)
        if not is_terminated:
            is_whole = self._base == 16 and WHOLE_BYTE_AT_END.search(event) is not None
            if not (isinstance(frame, _Frame) and is_whole):
                self._cut_off(number)
                return None
        if isinstance(frame, _Frame):
            return t_us, frame
        if frame is None:
            self._tally.skipped += 1
        else:
            self._tally.reject(frame, f"line {number}")
        return None

    def _take_header(self, line: bytes, number: int, *, is_terminated: bool) -> None:
        if line and not HEADER.match(line):
            if is_terminated:
                self._tally.reject(LogReject.MALFORMED, f"line {number}")
            else:
                self._cut_off(number)
            return
        self._tally.skipped += 1
        if base := BASE.match(line):
            self._base = 10 if base["base"].lower() == b"dec" else 16
            self._is_relative = (base["kind"] or b"").lower() == b"relative"
        elif start := START.match(line):
            self._start_us = date_us(start["date"])
            self._now_us = 0

    def _cut_off(self, number: int) -> None:
        self._tally.truncated = True
        self._tally.reject(LogReject.CUT_OFF, f"line {number}")

    def _time_us(self, stamped: re.Match[bytes]) -> int:
        nanoseconds = int(stamped["fraction"].ljust(9, b"0"))
        elapsed_us = int(stamped["seconds"]) * US_PER_S + (nanoseconds + NS_PER_US // 2) // NS_PER_US
        self._now_us = self._now_us + elapsed_us if self._is_relative else elapsed_us
        return self._start_us + self._now_us

    def _frame(self, event: bytes) -> _Frame | LogReject | None:
        """Return the frame of an event, why it has none, or None if it is of another kind."""
        if classic := CLASSIC.match(event):
            return self._classic_frame(classic)
        if fd := FD.match(event):
            return self._fd_frame(fd)
        if ERROR.match(event):
            return _Frame(ERROR_FLAG, 0, b"")
        return LogReject.MALFORMED if FRAME_LIKE.match(event) or CONTROL.search(event) else None

    def _classic_frame(self, found: re.Match[bytes]) -> _Frame | LogReject:
        length = min(int(found["length"] or b"0", 16), PAYLOAD_BYTES)
        can_id = self._can_id(found)
        if can_id is None:
            return LogReject.MALFORMED
        if found["kind"].lower() == b"r":
            return _Frame(can_id | REMOTE_FLAG, length, b"")
        return self._data_frame(can_id, length, found["data"].split())

    def _fd_frame(self, found: re.Match[bytes]) -> _Frame | LogReject:
        count = int(found["count"])
        rest = found["rest"].split()
        # Behind the data come duration, length and flags; without flags the line speaks of CAN FD.
        has_flags = len(rest) > count + 2
        if not has_flags or int(rest[count + 2], 16) & EDL_FLAG or count > PAYLOAD_BYTES:
            return LogReject.CAN_FD
        can_id = self._can_id(found)
        return LogReject.MALFORMED if can_id is None else self._data_frame(can_id, count, rest[:count])

    def _can_id(self, found: re.Match[bytes]) -> int | None:
        try:
            value = int(found["id"], self._base)
        except ValueError:
            return None
        if found["extended"]:
            return value | EXTENDED_FLAG if value <= MAX_EXTENDED_ID else None
        return value if value <= MAX_STANDARD_ID else None

    def _data_frame(self, can_id: int, length: int, texts: list[bytes]) -> _Frame | LogReject:
        if len(texts) < length:
            return LogReject.MALFORMED
        try:
            return _Frame(can_id, length, bytes(int(text, self._base) for text in texts[:length]))
        except ValueError:
            return LogReject.MALFORMED


def read_asc(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of an ASC file in batches."""
    parser, rows, number = _Parser(tally), _Rows(), 0
    while line := stream.readline(MAX_LINE_BYTES):
        number += 1
        found = parser.parse(line.strip(), number, is_terminated=line.endswith(b"\n"))
        if found is None:
            continue
        rows.t_us.append(found[0])
        rows.frames.append(found[1])
        tally.frames += 1
        if len(rows.frames) == FRAMES_PER_BATCH:
            yield rows.to_batch()
            rows = _Rows()
    if rows.frames:
        yield rows.to_batch()


def is_asc_header(line: bytes) -> bool:
    """Return whether a line is one of those an ASC file begins with."""
    return bool(BASE.match(line)) or bool((start := START.match(line)) and DATE.match(decoded(start["date"])))


def date_us(text: bytes) -> int:
    """Return a date such as ``Thu Jan  1 10:00:00.005 am 2026``, local time, in microseconds since the epoch.

    0 if it is none. The digits behind the point are a count of milliseconds: python-can writes 5 ms as ``.5``.
    """
    found = DATE.match(decoded(text))
    month = MONTHS.get(found["month"].lower()) if found else None
    if found is None or month is None:
        return 0
    hour = int(found["hour"])
    if found["half"]:
        hour = hour % 12 + (12 if found["half"].lower() == "pm" else 0)
    try:
        start = datetime(  # noqa: DTZ001 - the format has no zone: local time, as its writers mean it
            int(found["year"]), month, int(found["day"]), hour, int(found["minute"]), int(found["second"])
        )
    except ValueError:
        return 0
    return int(start.timestamp()) * US_PER_S + int(found["ms"] or 0) * 1_000


def decoded(text: bytes) -> str:
    """Return text of either encoding that is in use."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")
