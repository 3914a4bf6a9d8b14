"""Layouts of what programs and gateways write of a bus, a line for each frame or message, in columns."""

import re
from dataclasses import replace
from functools import partial

from canlog.logs.columns.fields import REST
from canlog.logs.columns.header import in_unit
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, COMMA, DAY_US, HEXADECIMAL, MINUTE_US, Column, Layout, Meaning, Role
from canlog.logs.dates import date_us
from canlog.logs.log_counts import MICROSECONDS, MILLISECONDS, SECONDS, likely_unit
from canlog.logs.text_log import frames_of

PYTHON_CAN_HEADER = re.compile(rb"\s*timestamp,arbitration_id,extended,remote,error,dlc,data\s*\Z", re.IGNORECASE)
GVRET_HEADER = re.compile(rb"\s*time stamp,id,extended,", re.IGNORECASE)

# What many have.
HEX_ID, HEX_DATA, HEX_MESSAGE = (Column(role, HEXADECIMAL) for role in (Role.ID, Role.DATA, Role.MESSAGE))
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


CLOCK_DIGITS = 9  # hhmmss.ddd
NO_DATE = "times are times of day, taken as those of 1970-01-01"
CANBOAT = Layout(
    columns=(
        Column(Role.TIME, 6),
        Column(Role.PRIORITY),
        Column(Role.GROUP),
        Column(Role.SOURCE),
        Column(Role.DESTINATION),
        LENGTH,
        HEX_MESSAGE,
    ),
    separator=ord(","),
)
YACHT_DEVICES = Layout(
    columns=(Column(Role.TIME), DIRECTION, HEX_ID, HEX_DATA),
    separator=BLANKS,
    extended_digits=8,
    wrap_us=DAY_US,
)
ACTISENSE = Layout(
    columns=(Column(Role.STAMP, -CLOCK_DIGITS), Column(Role.ADDRESSES), Column(Role.GROUP, HEXADECIMAL), HEX_MESSAGE),
    separator=BLANKS,
    comment_starts=b"#$!",  # sentences of NMEA 0183, which gateways mix in
    wrap_us=DAY_US,
)


class MessageLog(TableLog):
    """A log of whole messages."""

    def look_ahead(self, text: bytes) -> None:
        """Find out which groups have messages longer than a frame: their shorter ones are fast packets, too."""
        frames_of(self, text)
        self.restart()


Canboat = partial(MessageLog, CANBOAT)
YachtDevices = partial(TableLog, YACHT_DEVICES, NO_DATE)
Actisense = partial(MessageLog, ACTISENSE, NO_DATE)


CARBUS = Layout(
    columns=(
        TIME_S,
        CHANNEL,
        Column(Role.FLAGS),
        HEX_ID,
        LENGTH,
        HEX_DATA,
        Column(Role.IGNORED),
        Column(Role.IGNORED, REST),
    ),
    separator=ord("\t"),
    comment_starts=b"@#",
    has_decimal_comma=True,
    wrap_us=MINUTE_US,
)


CARBUS_HEADER = re.compile(rb"@ TEXT @", re.IGNORECASE)
CANHACKER_HEADER = re.compile(rb"\s*time\s+id\s+dlc\s+data\b", re.IGNORECASE)
CANHACKER_TIME = re.compile(rb"^\s*(\d+)[.,]\d+\s", re.MULTILINE)
MINUTE_S = 60
CANHACKER = Layout(
    columns=(TIME_S, HEX_ID, LENGTH, HEX_DATA),
    separator=BLANKS,
    comment_starts=b"Tt;#",
    has_decimal_comma=True,
)


class CanHacker(TableLog):
    def __init__(self) -> None:
        super().__init__(CANHACKER)

    def look_ahead(self, text: bytes) -> None:
        """Find out whether the times begin again every minute."""
        if all(int(seconds) < MINUTE_S for seconds in CANHACKER_TIME.findall(text)):
            self.set_layout(replace(self.layout, wrap_us=MINUTE_US))


CANKING_HEADER = re.compile(rb"\s*chn\s+identifier\s+flg\s+dlc\b", re.IGNORECASE)
CANKING = Layout(
    columns=(CHANNEL, HEX_ID, Column(Role.MARKS), LENGTH, Column(Role.COUNTED, HEXADECIMAL), TIME_S, DIRECTION),
    separator=BLANKS,
    comment_starts=b"CcLl#;",  # its header, and "Logging stopped."
    has_decimal_comma=True,
)


MICROCHIP_HEADER = re.compile(rb"Microchip Technology Inc")
MICROCHIP_LINE = re.compile(rb"^\s*\d+;[RT]X;", re.MULTILINE)
MICROCHIP_START = re.compile(
    rb"Logging Started:\s*(?P<date>\d{1,2}/\d{1,2}/\d{4}\s+\d{1,2}:\d{1,2}:\d{1,2}(?:\s+[AP]M)?)", re.IGNORECASE
)
MICROCHIP = Layout(
    columns=(Column(Role.TIME, MILLISECONDS), DIRECTION, HEX_ID, LENGTH, HEX_DATA),
    separator=ord(";"),
    comment_starts=b"/",
)


class Microchip(TableLog):
    """A log of Microchip's CAN Bus Analyzer."""

    def __init__(self) -> None:
        super().__init__(MICROCHIP)

    def look_ahead(self, text: bytes) -> None:
        """Find where the frames begin, and the date before them."""
        first = MICROCHIP_LINE.search(text)
        head = text[: first.start()] if first else b""
        self.set_layout(replace(self.layout, header_lines=head.count(b"\n")))
        if start := MICROCHIP_START.search(head):
            start_us = date_us(start["date"])
            if start_us is None:
                self.notes.append(f"the date {start[0].decode()!r} may be two days: times count from 1970")
            else:
                self.set_base(start_us)


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
