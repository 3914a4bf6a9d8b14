"""Vector ASC logs to columns: usual lines compiled, headers and everything else line by line.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frame_columns import NS_PER_US
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
)
from canlog.logs.arena import BLOCK_BYTES, MAX_LINE_BYTES, Arena, end_of_line, lines_of
from canlog.logs.asc_dates import date_us, decoded
from canlog.logs.asc_kernel import (
    BASE,
    HEXADECIMAL,
    IS_RELATIVE,
    LAST_US,
    MAX_EXTENDED_ID,
    MAX_STANDARD_ID,
    NOW_US,
    SAID_FD,
    SAID_REMOTE,
    START_US,
    US_PER_S,
    parse_usual_lines,
)
from canlog.logs.tally import LogReject, Tally
from canlog.logs.text_kernels import LENGTH_OF_CODE, LINES, POSITION, ROWS, STOP, WIDEN

LONGEST_SHOWN = 60  # bytes of a date
MIN_LINE_BYTES = 16  # "0.0 1 1 Rx d 0" is about the shortest line with a frame

HEADER = re.compile(rb"(?:date|base|no\s+internal|internal|begin|end|previous|split)\b|//", re.IGNORECASE)
START = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\S.*)", re.IGNORECASE)
BASE_LINE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
STAMPED = re.compile(rb"(?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\s+(?P<event>\S.*)")
CLASSIC = re.compile(
    rb"(?P<channel>\d{1,3})\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?P<direction>[RT])x\s+(?P<kind>[dr])"
    rb"(?:\s+(?P<length>[0-9a-f]{1,2}))?(?P<data>(?:\s+[0-9a-f]{1,3})*)(?:\s+\w+\s*=.*|\s*//.*)?$",
    re.IGNORECASE,
)
FD = re.compile(
    rb"CANFD\s+(?P<channel>\d{1,3})\s+(?P<direction>[RT])x\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?:[a-z_]\w*\s+)?"
    rb"(?P<fast>[01])\s+(?P<passive>[01])\s+"
    rb"(?P<length>[0-9a-f]{1,2})\s+(?P<count>\d{1,3})(?P<rest>(?:\s+[0-9a-f]+)*)(?:\s*//.*)?$",
    re.IGNORECASE,
)
ERROR = re.compile(rb"(?:CANFD\s+)?(?P<channel>\d{1,3})\s+(?:(?P<direction>[RT])x\s+)?ErrorFrame\b", re.IGNORECASE)
FRAME_LIKE = re.compile(rb"(?:CANFD\s+\d+|\d+\s+\S+)\s+(?:Rx|Tx)\b", re.IGNORECASE)
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]|\xff")  # in no text of either encoding
DIGITS_OF_BYTE = 2  # in hexadecimal; the numbers behind the bytes of a CANFD line may have one
MOST_CODES = len(LENGTH_OF_CODE)
WHOLE_BYTE_AT_END = re.compile(rb"\s[0-9a-f]{2}$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Frame:
    can_id: int
    channel: int
    length: int = 0
    payload: bytes = b""
    flags: int = 0


class _Parser:
    """What the header lines of an ASC file say about the lines that follow, and the frames of those."""

    def __init__(self, tally: Tally, rows: int) -> None:
        self._tally = tally
        self._arena = Arena.of(rows)
        self._lines = 0
        self._clock = np.zeros(4, np.int64)
        self._clock[BASE] = HEXADECIMAL

    def parse(self, text: UInt8Array, *, is_terminated: bool) -> FrameBatch:
        """Return the frames of whole lines; count what is not a frame."""
        report = np.zeros(4, np.int64)
        while report[POSITION] < len(text):
            arena = self._arena
            if is_terminated:
                parse_usual_lines(
                    text, self._clock, arena.t_ns, arena.can_id, arena.length, arena.flags, arena.channel, arena.data,
                    report,
                )  # fmt: skip
            if report[STOP] == WIDEN:
                arena.widen(int(report[ROWS]))
            elif report[POSITION] < len(text):
                end = end_of_line(text, int(report[POSITION]))
                report[LINES] += 1
                line = text[report[POSITION] : end].tobytes().strip()
                frame = self._parse_line(line, self._lines + int(report[LINES]), is_terminated=is_terminated)
                report[ROWS] += frame is not None and self._store(frame, int(report[ROWS]))
                report[POSITION] = end
        self._lines += int(report[LINES])
        return self._arena.batch(int(report[ROWS]))

    def _store(self, frame: _Frame, row: int) -> bool:
        """Write a frame into a row; return whether its time is one."""
        time_us = int(self._clock[START_US] + self._clock[NOW_US])
        if not 0 <= time_us <= LAST_US:
            self._tally.reject(LogReject.MALFORMED, f"line {self._lines + 1} and further")
            return False
        if frame.length > self._arena.data.shape[1]:
            self._arena.widen(row)
        arena = self._arena
        arena.t_ns[row] = time_us * NS_PER_US
        arena.can_id[row], arena.length[row], arena.flags[row] = frame.can_id, frame.length, frame.flags
        arena.channel[row] = frame.channel
        arena.data[row] = 0
        arena.data[row, : len(frame.payload)] = np.frombuffer(frame.payload, np.uint8)
        return True

    def _parse_line(self, line: bytes, number: int, *, is_terminated: bool) -> _Frame | None:
        """Return the frame of a line and set the time; None, after counting it, if there is none."""
        stamped = STAMPED.match(line)
        if stamped is None:
            self._take_header(line, number, is_terminated=is_terminated)
            return None
        self._advance(stamped)
        event = stamped["event"]
        frame = self._frame(event)
        if not is_terminated:
            is_whole = self._clock[BASE] == HEXADECIMAL and WHOLE_BYTE_AT_END.search(event) is not None
            if not (isinstance(frame, _Frame) and is_whole and not frame.flags & FD_FLAG):
                self._cut_off(number)
                return None
        if isinstance(frame, _Frame):
            return frame
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
        if base := BASE_LINE.match(line):
            self._clock[BASE] = 10 if base["base"].lower() == b"dec" else HEXADECIMAL
            self._clock[IS_RELATIVE] = (base["kind"] or b"").lower() == b"relative"
        elif start := START.match(line):
            self._take_start(start["date"])

    def _take_start(self, date: bytes) -> None:
        start_us = date_us(date)
        self._clock[NOW_US] = 0
        if start_us is not None:
            self._clock[START_US] = start_us
        elif not self._clock[START_US]:
            shown = decoded(date[:LONGEST_SHOWN]).encode("ascii", "backslashreplace").decode()
            self._tally.note(f"the date {shown!r} is not understood: times count from 1970")

    def _cut_off(self, number: int) -> None:
        self._tally.truncated = True
        self._tally.reject(LogReject.CUT_OFF, f"line {number}")

    def _advance(self, stamped: re.Match[bytes]) -> None:
        nanoseconds = int(stamped["fraction"].ljust(9, b"0"))
        elapsed_us = int(stamped["seconds"]) * US_PER_S + (nanoseconds + NS_PER_US // 2) // NS_PER_US
        now_us = int(self._clock[NOW_US]) + elapsed_us if self._clock[IS_RELATIVE] else elapsed_us
        self._clock[NOW_US] = min(now_us, LAST_US + 1)  # what is later is no time, and must stay a number

    def _frame(self, event: bytes) -> _Frame | LogReject | None:
        """Return the frame of an event, why it has none, or None if it is of another kind."""
        if classic := CLASSIC.match(event):
            return self._classic_frame(classic)
        if fd := FD.match(event):
            return self._fd_frame(fd)
        if error := ERROR.match(event):
            return _Frame(can_id=ERROR_FLAG, channel=channel_of(error), flags=sent_flag(error))
        return LogReject.MALFORMED if FRAME_LIKE.match(event) or CONTROL.search(event) else None

    def _classic_frame(self, found: re.Match[bytes]) -> _Frame | LogReject:
        is_remote, texts = found["kind"].lower() == b"r", found["data"].split()
        code = int(found["length"] or b"0", int(self._clock[BASE])) if is_digits(found["length"], self._clock) else -1
        length = min(code, PAYLOAD_BYTES)
        if is_remote and (found["length"] is None or 0 <= code < MOST_CODES):
            can_id = self._can_id(found)
            if can_id is None:
                return LogReject.MALFORMED
            flagged = can_id | REMOTE_FLAG
            return _Frame(can_id=flagged, channel=channel_of(found), length=max(length, 0), flags=sent_flag(found))
        if not 0 <= code < MOST_CODES or len(texts) != length:
            return LogReject.MALFORMED
        return self._data_frame(found, length, texts, 0)

    def _fd_frame(self, found: re.Match[bytes]) -> _Frame | LogReject:
        count, code = int(found["count"]), -1
        if is_digits(found["length"], self._clock):
            code = int(found["length"], int(self._clock[BASE]))
        rest = found["rest"].split()
        # Behind the data come duration, length and flags; without flags the line speaks of CAN FD.
        said = int(rest[count + 2], 16) if len(rest) > count + 2 else SAID_FD
        is_fd = bool(said & SAID_FD)
        if not 0 <= code < MOST_CODES:
            return LogReject.MALFORMED
        length = int(LENGTH_OF_CODE[code]) if is_fd else min(code, PAYLOAD_BYTES)
        if said & SAID_REMOTE:
            can_id = self._can_id(found)
            if can_id is None or is_fd or count not in {0, length}:
                return LogReject.MALFORMED
            return _Frame(can_id=can_id | REMOTE_FLAG, channel=channel_of(found), length=length, flags=sent_flag(found))
        texts = rest[:count]
        is_hexadecimal = self._clock[BASE] == HEXADECIMAL
        if count != length or (is_hexadecimal and any(len(text) != DIGITS_OF_BYTE for text in texts)):
            return LogReject.MALFORMED
        flags = FD_FLAG | BRS_FLAG * int(found["fast"]) | ESI_FLAG * int(found["passive"])
        return self._data_frame(found, count, texts, flags if is_fd else 0)

    def _can_id(self, found: re.Match[bytes]) -> int | None:
        try:
            value = int(found["id"], int(self._clock[BASE]))
        except ValueError:
            return None
        if found["extended"]:
            return value | EXTENDED_FLAG if value <= MAX_EXTENDED_ID else None
        return value if value <= MAX_STANDARD_ID else None

    def _data_frame(self, found: re.Match[bytes], length: int, texts: list[bytes], flags: int) -> _Frame | LogReject:
        can_id = self._can_id(found)
        if can_id is None or len(texts) != length:
            return LogReject.MALFORMED
        try:
            payload = bytes(int(text, int(self._clock[BASE])) for text in texts)
        except ValueError:
            return LogReject.MALFORMED
        return _Frame(
            can_id=can_id,
            channel=channel_of(found),
            length=length,
            payload=payload,
            flags=flags | sent_flag(found),
        )


def is_digits(text: bytes | None, clock: Int64Array) -> bool:
    """Return whether a text is a number in the base of the file."""
    return text is not None and (clock[BASE] == HEXADECIMAL or text.isdigit())


def sent_flag(found: re.Match[bytes]) -> int:
    """Return the flag of a frame that the recorder sent itself, 0 for one that it received."""
    return TX_FLAG if (found["direction"] or b"").upper() == b"T" else 0


def channel_of(found: re.Match[bytes]) -> int:
    """Return the channel of an event."""
    return min(int(found["channel"]), 255)


def read_asc(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of an ASC file, one batch for each 2 MiB of text."""
    parser = _Parser(tally, (BLOCK_BYTES + MAX_LINE_BYTES) // MIN_LINE_BYTES + 1)
    for lines in lines_of(stream):
        batch = parser.parse(lines.text, is_terminated=lines.is_terminated)
        if len(batch):
            tally.frames += len(batch)
            yield batch


def is_asc_header(line: bytes) -> bool:
    """Return whether a line is one of those an ASC file begins with."""
    start = START.match(line)
    return bool(BASE_LINE.match(line)) or (start is not None and date_us(start["date"]) is not None)
