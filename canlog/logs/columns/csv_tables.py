"""Comma-separated logs: python-can's (payload in base64, seconds since the epoch, UTC) and GVRET's (SavvyCAN).

GVRET counts microseconds, mostly from the start of the device; SavvyCAN may have set its clock to the epoch, and what
it made relative to a later frame begins below zero. Other programs write milliseconds or seconds under the same header:
the load of the bus tells.
"""

import re
from dataclasses import replace

from canlog.logs.columns.header import in_unit
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import COMMA, HEXADECIMAL, MICROSECONDS, SECONDS, Column, Layout, Role
from canlog.logs.text_log import frames_of
from canlog.logs.time_watch import likely_unit

PYTHON_CAN_HEADER = re.compile(rb"\s*timestamp,arbitration_id,extended,remote,error,dlc,data\s*\Z", re.IGNORECASE)
GVRET_HEADER = re.compile(rb"\s*time stamp,id,extended,", re.IGNORECASE)

PYTHON_CAN = Layout(
    columns=(
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.EXTENDED),
        Column(role=Role.REMOTE),
        Column(role=Role.ERROR),
        Column(role=Role.LENGTH),
        Column(role=Role.BASE64),
    ),
    separator=COMMA,
    comment_starts=b"tT",
    is_exact=True,
)
_GVRET_START = (
    Column(role=Role.TIME, parameter=MICROSECONDS),
    Column(role=Role.ID, parameter=HEXADECIMAL),
    Column(role=Role.EXTENDED),
)
_GVRET_END = (Column(role=Role.CHANNEL), Column(role=Role.LENGTH), Column(role=Role.DATA, parameter=HEXADECIMAL))
GVRET = Layout(columns=_GVRET_START + _GVRET_END, separator=COMMA, comment_starts=b"tT", is_exact=True, is_padded=True)
GVRET_WITH_DIRECTION = replace(GVRET, columns=(*_GVRET_START, Column(role=Role.DIRECTION), *_GVRET_END))


class PythonCanCsv(TableLog):
    """The CSV of python-can's ``CSVWriter``; it does not tell CAN FD apart, but longer payloads are."""

    def __init__(self) -> None:
        super().__init__(PYTHON_CAN)

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        return PYTHON_CAN_HEADER.match(line) is not None


class GvretCsv(TableLog):
    """The CSV of GVRET devices and SavvyCAN, with or without the column of directions."""

    def __init__(self) -> None:
        super().__init__(GVRET)
        self._unit = MICROSECONDS

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if not GVRET_HEADER.match(line):
            return False
        self._set_layout(GVRET_WITH_DIRECTION if b",dir," in line.lower() else GVRET)
        return True

    def look_ahead(self, text: bytes) -> None:
        """Find out the unit of times."""
        self._unit, note = likely_unit(frames_of(GvretCsv(), text))
        self._set_layout(self.layout)
        self.notes += note

    def _set_layout(self, layout: Layout) -> None:
        self.set_layout(replace(layout, columns=in_unit(layout.columns, self._unit)))
