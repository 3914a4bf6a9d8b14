"""BUSMASTER logs: the time of day, the time since the start, or that since the frame before; all local time."""

import re
from datetime import datetime, timedelta

from diag_service.sources.readers.tables.kernel import ABSOLUTE, DAYTIME, RELATIVE
from diag_service.sources.readers.tables.layout import Column, Layout, Meaning, Role
from diag_service.sources.readers.tables.reader import Clock

START = re.compile(rb"\*\*\*START DATE AND TIME (\d+):(\d+):(\d{4}) (\d+):(\d+):(\d+):(\d{1,3})")
MODE = re.compile(rb"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
MODES = {b"SYSTEM": DAYTIME, b"ABSOLUTE": ABSOLUTE, b"RELATIVE": RELATIVE}
DECIMAL = b"***DEC***"

LAYOUT = Layout(
    columns=(
        Column(role=Role.CLOCK),
        Column(role=Role.WORD),
        Column(role=Role.CHANNEL),
        Column(role=Role.ID),
        Column(role=Role.WORD),
        Column(role=Role.LENGTH),
        Column(role=Role.DATA),
    ),
    words={
        "rx": Meaning.NOTHING,
        "tx": Meaning.NOTHING,
        "s": Meaning.NOTHING,
        "x": Meaning.EXTENDED,
        "sr": Meaning.REMOTE,
        "xr": Meaning.EXTENDED | Meaning.REMOTE,
        "s-fd": Meaning.FD,
        "x-fd": Meaning.FD | Meaning.EXTENDED,
    },
    comment_starts=b"*",
)


class Busmaster:
    """A log of BUSMASTER, with identifiers and data in hexadecimal."""

    def __init__(self) -> None:
        self.layout = LAYOUT
        self.clock = Clock()
        self._start: datetime | None = None
        self._mode = DAYTIME

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if not line.startswith(b"***"):
            return False
        if found := START.match(line):
            self._start = _start(found)
        elif found := MODE.match(line):
            self._mode = MODES[found[1]]
        else:
            return line != DECIMAL
        self._set_clock()
        return True

    def _set_clock(self) -> None:
        if self._start is None:
            self.clock.set(0, self._mode)
            return
        midnight = self._start.replace(hour=0, minute=0, second=0, microsecond=0)
        if self._mode == DAYTIME:
            passed_us = (self._start - midnight) // timedelta(microseconds=1)
            self.clock.set(_epoch_us(midnight), DAYTIME, passed_us)
        else:
            self.clock.set(_epoch_us(self._start), self._mode)


def _start(found: re.Match[bytes]) -> datetime | None:
    """Return the start of the session, day before month; None if there is no such time."""
    day, month, year, hour, minute, second, milliseconds = (int(found[number]) for number in range(1, 8))
    try:
        return datetime(year, month, day, hour, minute, second, milliseconds * 1000)  # noqa: DTZ001 - local, as logged
    except ValueError:
        return None


def _epoch_us(local: datetime) -> int:
    try:
        return max(0, int(local.timestamp())) * 1_000_000 + local.microsecond
    except (OverflowError, OSError, ValueError):
        return 0
