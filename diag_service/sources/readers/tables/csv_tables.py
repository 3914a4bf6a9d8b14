"""Comma-separated logs: python-can's (payload in base64, seconds since the epoch, UTC) and GVRET's (SavvyCAN).

GVRET counts microseconds, mostly from the start of the device; SavvyCAN may have set its clock to the epoch.
"""

from diag_service.sources.readers.tables.layout import COMMA, MICROSECONDS, SECONDS, Column, Layout, Meaning, Role
from diag_service.sources.readers.tables.reader import Clock

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
    columns=(*_GVRET_START, Column(role=Role.IGNORED), *_GVRET_END),
    separator=COMMA,
    comment_starts=b"tT",
    is_padded=True,
)


class PythonCanCsv:
    """The CSV of python-can's ``CSVWriter``; it does not tell CAN FD apart, but longer payloads are."""

    def __init__(self) -> None:
        self.layout = PYTHON_CAN
        self.clock = Clock()

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        return is_python_can_header(line)


class GvretCsv:
    """The CSV of GVRET devices and SavvyCAN, with or without the column of directions."""

    def __init__(self) -> None:
        self.layout = GVRET
        self.clock = Clock()

    def read_comment(self, line: bytes) -> bool:
        """Take up what a line without a frame says; return whether it belongs to the format."""
        if not is_gvret_header(line):
            return False
        self.layout = GVRET_WITH_DIRECTION if b",dir," in line.lower() else GVRET
        return True


def is_python_can_header(line: bytes) -> bool:
    """Return whether a line is the first of a CSV log of python-can."""
    return line.strip().lower() == PYTHON_CAN_HEADER


def is_gvret_header(line: bytes) -> bool:
    """Return whether a line is the first of a GVRET log."""
    return line.strip().lower().startswith(GVRET_HEADER)
