"""Layouts of what programs write of a bus, a line for each frame, in columns."""

import re
from dataclasses import replace

from canlog.logs.columns.header import in_unit
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, COMMA, HEXADECIMAL, Column, Layout, Meaning, Role
from canlog.logs.log_counts import MICROSECONDS, SECONDS, likely_unit
from canlog.logs.text_log import frames_of

PYTHON_CAN_HEADER = re.compile(rb"\s*timestamp,arbitration_id,extended,remote,error,dlc,data\s*\Z", re.IGNORECASE)
GVRET_HEADER = re.compile(rb"\s*time stamp,id,extended,", re.IGNORECASE)

# What many have.
HEX_ID, HEX_DATA = (Column(role, HEXADECIMAL) for role in (Role.ID, Role.DATA))
LENGTH, CHANNEL, DIRECTION = (Column(role) for role in (Role.LENGTH, Role.CHANNEL, Role.DIRECTION))
TIME_S = Column(Role.TIME, SECONDS)

PYTHON_CAN = Layout(
    columns=(
        TIME_S,
        HEX_ID,
        Column(Role.EXTENDED),
        Column(Role.REMOTE),
        Column(Role.ERROR),
        LENGTH,
        Column(Role.BASE64),
    ),
    separator=COMMA,
    comment_starts=b"tT",
    is_exact=True,
)
_GVRET_START = (Column(Role.TIME, MICROSECONDS), HEX_ID, Column(Role.EXTENDED))
_GVRET_END = (CHANNEL, LENGTH, HEX_DATA)
GVRET = Layout(columns=_GVRET_START + _GVRET_END, separator=COMMA, comment_starts=b"tT", is_exact=True, is_padded=True)
GVRET_WITH_DIRECTION = replace(GVRET, columns=(*_GVRET_START, DIRECTION, *_GVRET_END))


class PythonCanCsv(TableLog):
    """The CSV of python-can's ``CSVWriter``; it does not tell CAN FD apart, but longer payloads are."""

    def __init__(self) -> None:
        super().__init__(PYTHON_CAN)

    def read_comment(self, line: bytes) -> bool:
        return PYTHON_CAN_HEADER.match(line) is not None


class GvretCsv(TableLog):
    """The CSV of GVRET devices and SavvyCAN, with or without the column of directions."""

    def __init__(self) -> None:
        super().__init__(GVRET)
        self._unit = MICROSECONDS

    def read_comment(self, line: bytes) -> bool:
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


CRTD = Layout(
    columns=(
        TIME_S,
        Column(Role.WORD, ord("c")),  # comments, events, states: CXX, CEV, CST and more
        HEX_ID,
        HEX_DATA,
    ),
    separator=BLANKS,
    comment_starts=b"",
    is_exact=True,
    words={
        "r11": Meaning.NOTHING,
        "t11": Meaning.SENT,
        "r29": Meaning.EXTENDED,
        "t29": Meaning.SENT | Meaning.EXTENDED,
    },
)
