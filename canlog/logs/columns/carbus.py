"""Traces of CARBUS Analyzer, versions 2 and 3: tabs between columns, and times that begin again every minute.

``46,016 TAB 1 TAB 0004 TAB 45A TAB 8 TAB 5A 04 00 00 00 00 00 00 TAB 00000000 TAB Z``: seconds of the minute, channel,
flags, identifier, length, bytes, a checksum, the bytes as text. The date is not in the file.
"""

from canlog.logs.columns.fields import REST
from canlog.logs.columns.roles import HEXADECIMAL, MINUTE_US, Column, Layout, Role

LAYOUT = Layout(
    columns=(
        Column(role=Role.TIME, parameter=6),
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


def is_carbus_header(line: bytes) -> bool:
    """Return whether a line is the first of a trace of CARBUS Analyzer."""
    return line.upper().startswith(b"@ TEXT @")
