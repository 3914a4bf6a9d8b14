"""Traces of CANHacker: ``00.000 00000280 8 01 00 14 0A 01 00 00 80 comment``, seconds since the minute began.

An adapter that speaks Lawicel's protocol counts 60,000 milliseconds and begins again. Identifiers have eight digits of
either kind: those that eleven bits hold are taken as standard ones.
"""

import re
from dataclasses import replace

from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, HEXADECIMAL, MINUTE_US, Column, Layout, Role

HEADER = re.compile(rb"\s*time\s+id\s+dlc\s+data\b", re.IGNORECASE)
TIME = re.compile(rb"^\s*(\d+)[.,]\d+\s", re.MULTILINE)
MINUTE_S = 60
LAYOUT = Layout(
    columns=(
        Column(role=Role.TIME, parameter=6),
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
        super().__init__(LAYOUT)

    def look_ahead(self, text: bytes) -> None:
        """Find out whether the times begin again every minute."""
        if all(int(seconds) < MINUTE_S for seconds in TIME.findall(text)):
            self.set_layout(replace(self.layout, wrap_us=MINUTE_US))


def is_canhacker_header(line: bytes) -> bool:
    """Return whether a line names the columns of a trace of CANHacker."""
    return HEADER.match(line) is not None
