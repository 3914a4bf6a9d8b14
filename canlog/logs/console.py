"""What candump prints for people: ``(1767225600.000000)  can0  TX - -  0A0   [4]  11 22 33 44               '."3D'``.

Behind ``-t`` stands what its times are: ``a`` since the epoch, ``A`` a date in local time, ``z`` since the start, ``d``
since the frame before. The last two look alike: times that keep falling are those of ``d``.
"""

import re

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import REMOTE_FLAG, FrameBatch
from canlog.logs.asc_dates import date_us
from canlog.logs.channels import ChannelNames
from canlog.logs.console_kernel import BASE_NS, CLOCK_FIELDS, IS_DELTA, NS_PER_US, parse_lines
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_kernels import NEW_CHANNEL, POSITION, STOP
from canlog.logs.text_log import MAX_LINE_BYTES, TextLog, frames_of

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
            self._set_zone(date)
        elif len(found[0]["count"].partition(b".")[0]) < EPOCH_DIGITS:
            times_s = np.array([float(one["count"]) for one in found if one["count"]])
            self._clock[IS_DELTA] = are_steps(times_s)
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

    def _set_zone(self, date: bytes) -> None:
        """Take dates as local time, all with the offset of the first."""
        as_utc = frames_of(ConsoleLog(), b"(" + date + b") c 000 [0]").t_ns
        local_us = date_us(date)
        if local_us is not None and len(as_utc):
            self._clock[BASE_NS] = local_us * NS_PER_US - int(as_utc[0])


def are_steps(times_s: "np.typing.NDArray[np.float64]") -> bool:
    """Return whether times are those since the frame before: they fall, or stay the same above zero."""
    steps_s = np.diff(times_s)
    is_constant = len(times_s) > 2 and times_s[1] > 0.0 and not steps_s[1:].any()
    return bool(is_constant or np.count_nonzero(steps_s < 0.0) > LEAST_FALLS * len(steps_s))
