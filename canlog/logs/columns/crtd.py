"""CRTD logs of the Open Vehicles project: seconds since the epoch, UTC, or since the device was started."""

from canlog.logs.columns.roles import BLANKS, HEXADECIMAL, SECONDS, Column, Layout, Meaning, Role

LAYOUT = Layout(
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
