"""Vector ASC logs to columns: what its header lines say, and the lines that they speak of.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FD_FLAG, FrameBatch
from canlog.logs.asc_dates import date_us, decoded
from canlog.logs.asc_fields import DECIMAL, HEXADECIMAL
from canlog.logs.asc_kernel import BASE, CLOCK_FIELDS, IS_RELATIVE, NOW_US, START_US, parse_lines
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_log import TextLog

LONGEST_SHOWN = 60  # bytes of a date

HEADER = re.compile(rb"(?:date|base|no\s+internal|internal|begin|end|previous|split)\b|//", re.IGNORECASE)
START = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\S.*)", re.IGNORECASE)
BASE_LINE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
FIRST_LINE = re.compile(rb"base\s+(?:hex|dec)|(?:date|begin\s+triggerblock)\s+\S", re.IGNORECASE)
WHOLE_BYTE_AT_END = re.compile(rb"\s[0-9a-f]{2}\s*$", re.IGNORECASE)


class AscLog(TextLog):
    """A log of Vector's tools; its header says in which base numbers are, and what times count from."""

    shortest_line_bytes = 13  # "0.0 1 1 Rx r"

    def __init__(self) -> None:
        super().__init__()
        self._clock = np.zeros(CLOCK_FIELDS, np.int64)
        self._clock[BASE] = HEXADECIMAL

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines up to one of a header."""
        parse_lines(text, rows, self._clock, progress)

    def read_comment(self, line: bytes) -> bool:
        """Take up what a header line says; return whether it is one."""
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
