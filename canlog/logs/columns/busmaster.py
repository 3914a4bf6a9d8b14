"""BUSMASTER logs: the time of day, the time since the start, or that since the frame before; all local time.

Behind the seconds stands a count of 100 microseconds, which BUSMASTER pads to four digits (its ``%04d``) and others do
not. Where no line of the beginning has four digits, it is a count of milliseconds.
"""

import re
from dataclasses import replace

from canlog.logs.asc import date_us, local_midnight_us
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, DAY_US, DECIMAL, HEXADECIMAL, Column, Layout, Meaning, Role

START = re.compile(rb"\*\*\*START DATE AND TIME\s+(?P<date>[^*]*)")
MODE = re.compile(rb"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE\*\*\*")
PROTOCOL = re.compile(rb"\*\*\*PROTOCOL (\w+)\*\*\*")
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


def layout_of(unit_us: int, *, is_decimal: bool, is_j1939: bool) -> Layout:
    """Return the layout of lines whose clock has counts of so many microseconds."""
    base = DECIMAL if is_decimal else HEXADECIMAL
    clock, channel, word = Column(role=Role.CLOCK, parameter=unit_us), Column(role=Role.CHANNEL), Column(role=Role.WORD)
    identifier = Column(role=Role.ID, parameter=base)
    j1939 = (clock, channel, identifier, *[Column()] * J1939_COLUMNS_BETWEEN, word)
    return Layout(
        columns=(
            *(j1939 if is_j1939 else (clock, word, channel, identifier, word)),
            Column(role=Role.LENGTH),
            Column(role=Role.DATA, parameter=base),
        ),
        separator=BLANKS,
        words=J1939_WORDS if is_j1939 else WORDS,
        comment_starts=b"*",
        is_exact=True,
    )


class Busmaster(TableLog):
    """A log of BUSMASTER; a line of its header says whether identifiers and bytes are hexadecimal or decimal."""

    def __init__(self) -> None:
        self._unit_us = USUAL_UNIT_US
        self._start_us: int | None = None
        self._mode = b"SYSTEM"
        self._is_decimal = self._is_j1939 = False
        super().__init__()
        self._set_layout()

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
            self._mode = found[1]
            self._set_clock()
        elif line in BASES:
            self._is_decimal = BASES[line]
            self._set_layout()
        elif found := PROTOCOL.match(line):
            self._is_j1939 = found[1].upper() == b"J1939"
            self._set_layout()
        return True

    def _set_layout(self) -> None:
        """Take up what the header said; without a start, times count from 1970."""
        is_daytime = self._mode == b"SYSTEM"
        layout = layout_of(self._unit_us, is_decimal=self._is_decimal, is_j1939=self._is_j1939)
        self.set_layout(replace(layout, wrap_us=DAY_US if is_daytime else 0))

    def _set_clock(self) -> None:
        self._set_layout()
        start_us = self._start_us or 0
        passed_us = start_us - local_midnight_us(start_us) if self._start_us and self._mode == b"SYSTEM" else 0
        self.set_base(start_us - passed_us, passed_us, is_relative=self._mode == b"RELATIVE")
