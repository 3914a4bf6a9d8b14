"""BUSMASTER logs: the time of day, the time since the start, or that since the frame before; all local time.

Behind the seconds stands a count of 100 microseconds, which BUSMASTER pads to four digits (its ``%04d``) and others do
not. Where no line of the beginning has four digits, it is a count of milliseconds.
"""

import re

from canlog.logs.asc_dates import date_us, local_midnight_us
from canlog.logs.tables.kernel import ABSOLUTE, DAYTIME, RELATIVE
from canlog.logs.tables.layout import Column, Layout, Meaning, Role
from canlog.logs.tables.table import Table

START = re.compile(rb"\*\*\*START DATE AND TIME\s+(?P<date>[^*]*)")
MODE = re.compile(rb"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
PROTOCOL = re.compile(rb"\*\*\*PROTOCOL (\w+)\*\*\*")
MODES = {b"SYSTEM": DAYTIME, b"ABSOLUTE": ABSOLUTE, b"RELATIVE": RELATIVE}
BASES = {b"***DEC***": True, b"***HEX***": False}
COUNT = re.compile(rb"^\s*\d+:\d+:\d+:(\d+)\s", re.MULTILINE)
USUAL_DIGITS, USUAL_UNIT_US = 4, 100
MILLISECOND_US = 1_000

WORDS = {
    "rx": Meaning.NOTHING,
    "tx": Meaning.SENT,
    "s": Meaning.NOTHING,
    "x": Meaning.EXTENDED,
    "sr": Meaning.REMOTE,
    "xr": Meaning.EXTENDED | Meaning.REMOTE,
    "s-fd": Meaning.FD,
    "x-fd": Meaning.FD | Meaning.EXTENDED,
}


J1939_WORDS = {"rx": Meaning.EXTENDED, "tx": Meaning.EXTENDED | Meaning.SENT}
J1939_COLUMNS_BETWEEN = 5  # group, kind, source, destination and priority, all of them parts of the identifier


def j1939_layout_of(unit_us: int, *, is_decimal: bool) -> Layout:
    """Return the layout of lines of a J1939 log, whose clock has counts of so many microseconds."""
    return Layout(
        columns=(
            Column(role=Role.CLOCK, parameter=unit_us),
            Column(role=Role.CHANNEL),
            Column(role=Role.DECIMAL_ID if is_decimal else Role.ID),
            *[Column(role=Role.IGNORED)] * J1939_COLUMNS_BETWEEN,
            Column(role=Role.WORD),
            Column(role=Role.LENGTH),
            Column(role=Role.DECIMAL_DATA if is_decimal else Role.DATA),
        ),
        words=J1939_WORDS,
        comment_starts=b"*",
    )


def layout_of(unit_us: int, *, is_decimal: bool) -> Layout:
    """Return the layout of lines whose clock has counts of so many microseconds."""
    return Layout(
        columns=(
            Column(role=Role.CLOCK, parameter=unit_us),
            Column(role=Role.WORD),
            Column(role=Role.CHANNEL),
            Column(role=Role.DECIMAL_ID if is_decimal else Role.ID),
            Column(role=Role.WORD),
            Column(role=Role.LENGTH),
            Column(role=Role.DECIMAL_DATA if is_decimal else Role.DATA),
        ),
        words=WORDS,
        comment_starts=b"*",
    )


class Busmaster(Table):
    """A log of BUSMASTER; a line of its header says whether identifiers and bytes are hexadecimal or decimal."""

    def __init__(self) -> None:
        self._unit_us = USUAL_UNIT_US
        super().__init__(layout_of(self._unit_us, is_decimal=False))
        self._start_us: int | None = None
        self._mode = DAYTIME
        self._is_decimal = self._is_j1939 = False

    def look_ahead(self, text: bytes) -> None:
        """Find out the unit of the clock's counts."""
        digits = max((len(count) for count in COUNT.findall(text)), default=USUAL_DIGITS)
        if digits < USUAL_DIGITS:
            self.notes.append(
                f"times are taken as milliseconds: none has the {USUAL_DIGITS} digits that BUSMASTER writes"
            )
        self._unit_us = MILLISECOND_US if digits < USUAL_DIGITS else USUAL_UNIT_US if digits == USUAL_DIGITS else 1
        self._set_layout()

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if not line.startswith(b"***"):
            return False
        if found := START.match(line):
            self._start_us = date_us(found["date"])
            if self._start_us is None:
                self.notes.append("the start of the log is not understood: times count from 1970")
            self._set_clock()
        elif found := MODE.match(line):
            self._mode = MODES[found[1]]
            self._set_clock()
        elif line in BASES:
            self._is_decimal = BASES[line]
            self._set_layout()
        elif found := PROTOCOL.match(line):
            self._is_j1939 = found[1].upper() == b"J1939"
            self._set_layout()
        return True

    def _set_layout(self) -> None:
        layout = j1939_layout_of if self._is_j1939 else layout_of
        self.layout = layout(self._unit_us, is_decimal=self._is_decimal)

    def _set_clock(self) -> None:
        if self._start_us is None:
            self.set_clock(0, self._mode)
        elif self._mode == DAYTIME:
            midnight_us = local_midnight_us(self._start_us)
            self.set_clock(midnight_us, DAYTIME, self._start_us - midnight_us)
        else:
            self.set_clock(self._start_us, self._mode)
