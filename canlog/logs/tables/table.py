"""Text tables of any layout."""

import re

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FrameBatch
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.tables.kernel import ABSOLUTE, BASE_US, CLOCK_FIELDS, FIELDS, MODE, NOW_US, parse_lines
from canlog.logs.tables.layout import Layout, Role
from canlog.logs.text_log import TextLog

HALF_BYTES_AT_END = {
    Role.DATA: re.compile(rb"[^0-9A-Fa-f][0-9A-Fa-f]\n"),
    Role.DECIMAL_DATA: re.compile(rb"[^0-9][0-9]{1,2}\n"),
}
ENOUGH_BYTES = 8  # of a format without lengths: a frame with so many is whole


class Table(TextLog):
    """A format: the layout of its lines, which its comments may change, and what its times are relative to."""

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.layout = layout
        self._clock = np.zeros(CLOCK_FIELDS, np.int64)
        self._line = np.zeros(FIELDS, np.int64)

    @property
    def layout(self) -> Layout:
        """The layout of the lines that follow."""
        return self._layout

    @layout.setter
    def layout(self, layout: Layout) -> None:
        self._layout, self._program = layout, layout.program()

    def set_clock(self, base_us: int, mode: int = ABSOLUTE, now_us: int = 0) -> None:
        """Count times from ``base_us`` since the epoch; ``now_us`` is the time already passed."""
        self._clock[[BASE_US, MODE, NOW_US]] = base_us, mode, now_us

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines up to a comment."""
        parse_lines(text, rows, self._program, self._clock, self._line, progress)

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:
        """Return whether no digit of the last byte can be missing, and no byte."""
        roles = [column.role for column in self.layout.columns]
        half = HALF_BYTES_AT_END.get(roles[-1])
        tells_length = not {Role.LENGTH, Role.LENGTH_CODE}.isdisjoint(roles)
        is_halved = half is not None and half.search(line[-4:]) is not None
        return not is_halved and bool(frame.length[0] >= (1 if tells_length else ENOUGH_BYTES))
