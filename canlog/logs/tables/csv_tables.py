"""Comma-separated logs: python-can's (payload in base64, seconds since the epoch, UTC) and GVRET's (SavvyCAN).

GVRET counts microseconds, mostly from the start of the device; SavvyCAN may have set its clock to the epoch, and what
it made relative to a later frame begins below zero. Other programs write milliseconds or seconds under the same header:
the load of the bus tells.
"""

from dataclasses import replace

from canlog.logs.tables.layout import COMMA, MICROSECONDS, SECONDS, Column, Layout, Meaning, Role
from canlog.logs.tables.table import Table
from canlog.logs.tables.time_unit import likely_unit
from canlog.logs.text_log import frames_of

PYTHON_CAN_HEADER = b"timestamp,arbitration_id,extended,remote,error,dlc,data"
GVRET_HEADER = b"time stamp,id,extended,"

PYTHON_CAN = Layout(
    columns=(
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.ID),
        Column(role=Role.SWITCH, parameter=Meaning.EXTENDED),
        Column(role=Role.SWITCH, parameter=Meaning.REMOTE),
        Column(role=Role.SWITCH, parameter=Meaning.ERROR),
        Column(role=Role.LENGTH),
        Column(role=Role.BASE64),
    ),
    separator=COMMA,
    comment_starts=b"tT",
)
_GVRET_START = (
    Column(role=Role.TIME, parameter=MICROSECONDS),
    Column(role=Role.ID),
    Column(role=Role.SWITCH, parameter=Meaning.EXTENDED),
)
_GVRET_END = (Column(role=Role.CHANNEL), Column(role=Role.LENGTH), Column(role=Role.DATA))
GVRET = Layout(columns=_GVRET_START + _GVRET_END, separator=COMMA, comment_starts=b"tT", is_padded=True)
GVRET_WITH_DIRECTION = Layout(
    columns=(*_GVRET_START, Column(role=Role.DIRECTION), *_GVRET_END),
    separator=COMMA,
    comment_starts=b"tT",
    is_padded=True,
)


class PythonCanCsv(Table):
    """The CSV of python-can's ``CSVWriter``; it does not tell CAN FD apart, but longer payloads are."""

    def __init__(self) -> None:
        super().__init__(PYTHON_CAN)

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        return is_python_can_header(line)


class GvretCsv(Table):
    """The CSV of GVRET devices and SavvyCAN, with or without the column of directions."""

    def __init__(self) -> None:
        super().__init__(GVRET)
        self._unit = MICROSECONDS

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if not is_gvret_header(line):
            return False
        self.layout = in_unit(GVRET_WITH_DIRECTION if b",dir," in line.lower() else GVRET, self._unit)
        return True

    def look_ahead(self, text: bytes) -> None:
        """Find out the unit of times."""
        self._unit, note = likely_unit(frames_of(GvretCsv(), text))
        self.layout = in_unit(self.layout, self._unit)
        self.notes += note


def in_unit(layout: Layout, unit: int) -> Layout:
    """Return a layout with its times in another unit."""
    time = Column(role=Role.TIME, parameter=unit)
    return replace(layout, columns=(time, *layout.columns[1:]))


def is_python_can_header(line: bytes) -> bool:
    """Return whether a line is the first of a CSV log of python-can."""
    return line.strip().lower() == PYTHON_CAN_HEADER


def is_gvret_header(line: bytes) -> bool:
    """Return whether a line is the first of a GVRET log."""
    return line.strip().lower().startswith(GVRET_HEADER)
