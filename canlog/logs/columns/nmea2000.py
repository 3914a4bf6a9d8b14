"""What programs and gateways write of NMEA 2000: canboat, Yacht Devices and Actisense, a frame or a message a line.

canboat: ``2011-11-24-22:42:04.388,2,127251,36,255,8,7d,0b,7d,02,00,ff,ff,ff``, UTC: priority, parameter group, source,
destination, length, bytes. Yacht Devices, and Actisense as "CAN frame ASCII": ``17:33:21.107 R 19F51323 01 2F 30 70``.
Actisense "N2K ASCII": ``A173321.107 23FF7 1F513 012F3070002F30709F``: source, destination and priority, group, bytes.

A message longer than a frame becomes the fast packet that carried it, for that is what databases and ``transport`` know
([decision 0065](../../../docs/decisions/0065-long-messages.md)).
"""

from functools import partial

from canlog.logs.columns.log import TableLog
from canlog.logs.columns.roles import BLANKS, DAY_US, HEXADECIMAL, Column, Layout, Role
from canlog.logs.text_log import frames_of

CLOCK_DIGITS = 9  # hhmmss.ddd
NO_DATE = "times are times of day, taken as those of 1970-01-01"
CANBOAT = Layout(
    columns=(
        Column(role=Role.TIME, parameter=6),
        Column(role=Role.PRIORITY),
        Column(role=Role.GROUP),
        Column(role=Role.SOURCE),
        Column(role=Role.DESTINATION),
        Column(role=Role.LENGTH),
        Column(role=Role.MESSAGE, parameter=HEXADECIMAL),
    ),
    separator=ord(","),
)
YACHT_DEVICES = Layout(
    columns=(
        Column(role=Role.TIME),
        Column(role=Role.DIRECTION),
        Column(role=Role.ID, parameter=HEXADECIMAL),
        Column(role=Role.DATA, parameter=HEXADECIMAL),
    ),
    separator=BLANKS,
    extended_digits=8,
    wrap_us=DAY_US,
)
ACTISENSE = Layout(
    columns=(
        Column(role=Role.STAMP, parameter=-CLOCK_DIGITS),
        Column(role=Role.ADDRESSES),
        Column(role=Role.GROUP, parameter=HEXADECIMAL),
        Column(role=Role.MESSAGE, parameter=HEXADECIMAL),
    ),
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
