"""Logs of Microchip's CAN Bus Analyzer, also as SavvyCAN writes them: ``1247;RX;0xC2;8;0x5C;0x87;0x00``, milliseconds.

Between two lines of ``//---`` stands who wrote it and when; identifiers that eleven bits hold are taken as standard.
"""

import re
from dataclasses import replace

from canlog.logs.asc_dates import date_us
from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import HEXADECIMAL, Column, Layout, Role

FRAME_LINE = re.compile(rb"^\s*\d+;[RT]X;", re.MULTILINE)
START = re.compile(
    rb"Logging Started:\s*(?P<date>\d{1,2}/\d{1,2}/\d{4}\s+\d{1,2}:\d{1,2}:\d{1,2}(?:\s+[AP]M)?)", re.IGNORECASE
)
LAYOUT = Layout(
    columns=(
        Column(role=Role.TIME, parameter=3),
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
        super().__init__(LAYOUT)

    def look_ahead(self, text: bytes) -> None:
        """Find where the frames begin, and the date before them."""
        first = FRAME_LINE.search(text)
        head = text[: first.start()] if first else b""
        self.set_layout(replace(self.layout, header_lines=head.count(b"\n")))
        if start := START.search(head):
            start_us = date_us(start["date"])
            if start_us is None:
                self.notes.append(f"the date {start[0].decode()!r} may be two days: times count from 1970")
            else:
                self.set_base(start_us)


def is_microchip_header(line: bytes) -> bool:
    """Return whether a line says that Microchip's CAN Bus Analyzer wrote the log, or another for it."""
    return line.startswith(b"Microchip Technology Inc")
