"""CRTD logs of the Open Vehicles project: seconds since the epoch, UTC, or since the device was started."""

from canlog.logs.tables.layout import SECONDS, Column, Layout, Meaning, Role
from canlog.logs.tables.table import Table

LAYOUT = Layout(
    columns=(
        Column(role=Role.TIME, parameter=SECONDS),
        Column(role=Role.WORD, parameter=ord("c")),  # comments, events, states: CXX, CEV, CST and more
        Column(role=Role.ID),
        Column(role=Role.DATA),
    ),
    words={
        "r11": Meaning.NOTHING,
        "t11": Meaning.SENT,
        "r29": Meaning.EXTENDED,
        "t29": Meaning.SENT | Meaning.EXTENDED,
    },
)


class Crtd(Table):
    """A log in CRTD, version 1 to 3."""

    def __init__(self) -> None:
        super().__init__(LAYOUT)
