"""Layouts of what programs write of a bus: CARBUS Analyzer, CANHacker, CanKing, Microchip's CAN Bus Analyzer, CRTD.

CARBUS Analyzer, versions 2 and 3, has tabs between columns, and times that begin again every minute:
``46,016 TAB 1 TAB 0004 TAB 45A TAB 8 TAB 5A 04 00 00 00 00 00 00 TAB 00000000 TAB Z``: seconds of the minute, channel,
flags, identifier, length, bytes, a checksum, the bytes as text. The date is not in the file.

CANHacker: ``00.000 00000280 8 01 00 14 0A 01 00 00 80 comment``, seconds since the minute began. An adapter that speaks
Lawicel's protocol counts 60,000 milliseconds and begins again. Identifiers have eight digits of either kind: those
that eleven bits hold are taken as standard ones.

Kvaser's CanKing: ``0  0CFBFFDB X  8  1B 31 20 EB B3 FF D9 FF  100.000139 R``, seconds from the start. Between an
identifier and a length may stand what kind of frame it is; behind the bytes stand time and direction.

Microchip's analyser, also as SavvyCAN writes its logs: ``1247;RX;0xC2;8;0x5C;0x87;0x00``, milliseconds. Between two
lines of ``//---`` stands who wrote it and when; identifiers that eleven bits hold are taken as standard.

CRTD of the Open Vehicles project, versions 1 to 3: seconds since the epoch, UTC, or since the device was started.
"""

import re
from dataclasses import replace

from canlog.logs.asc import date_us
from canlog.logs.columns.fields import REST
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import (
    BLANKS,
    HEXADECIMAL,
    MILLISECONDS,
    MINUTE_US,
    SECONDS,
    Column,
    Layout,
    Meaning,
    Role,
)

CARBUS = Layout(
    columns=(
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.CHANNEL),
        Column(role=Role.FLAGS),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.LENGTH),
        Column(role=Role.DATA, parameter=HEXADECIMAL),
        Column(role=Role.IGNORED),
        Column(role=Role.IGNORED, parameter=REST),
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
    columns=(
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.LENGTH),
        Column(role=Role.DATA, parameter=HEXADECIMAL),
    ),
    separator=BLANKS,
    comment_starts=b"Tt;#",
    has_decimal_comma=True,
)


class CanHacker(TableLog):
    """A trace of CANHacker."""

    def __init__(self) -> None:
        super().__init__(CANHACKER)

    def look_ahead(self, text: bytes) -> None:
        """Find out whether the times begin again every minute."""
        if all(int(seconds) < MINUTE_S for seconds in CANHACKER_TIME.findall(text)):
            self.set_layout(replace(self.layout, wrap_us=MINUTE_US))


CANKING_HEADER = re.compile(rb"\s*chn\s+identifier\s+flg\s+dlc\b", re.IGNORECASE)
CANKING = Layout(
    columns=(
        Column(role=Role.CHANNEL),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.MARKS),
        Column(role=Role.LENGTH),
        Column(role=Role.COUNTED, parameter=HEXADECIMAL),
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.DIRECTION),
    ),
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
    columns=(
        Column(role=Role.TIME, parameter=MILLISECONDS),
        Column(role=Role.DIRECTION),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.LENGTH),
        Column(role=Role.DATA, parameter=HEXADECIMAL),
    ),
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
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.WORD, parameter=ord("c")),  # comments, events, states: CXX, CEV, CST and more
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.DATA, parameter=HEXADECIMAL),
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
