"""Texts of Kvaser's CanKing: ``0  0CFBFFDB X  8  1B 31 20 EB B3 FF D9 FF  100.000139 R``, seconds from the start.

Between an identifier and a length may stand what kind of frame it is; behind the bytes stand time and direction.
"""

import re

from canlog.logs.columns.roles import BLANKS, HEXADECIMAL, Column, Layout, Role

HEADER = re.compile(rb"\s*chn\s+identifier\s+flg\s+dlc\b", re.IGNORECASE)
LAYOUT = Layout(
    columns=(
        Column(role=Role.CHANNEL),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.MARKS),
        Column(role=Role.LENGTH),
        Column(role=Role.COUNTED, parameter=HEXADECIMAL),
        Column(role=Role.TIME, parameter=6),
        Column(role=Role.DIRECTION),
    ),
    separator=BLANKS,
    comment_starts=b"CcLl#;",  # its header, and "Logging stopped."
    has_decimal_comma=True,
)


def is_canking_header(line: bytes) -> bool:
    """Return whether a line names the columns of a text of CanKing."""
    return HEADER.match(line) is not None
