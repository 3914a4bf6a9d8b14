"""Recordings one behind the other: headers that come again, and clocks that begin again."""

import numpy as np
import pytest

from canlog.logs.signal_tables.recordings import AS_BEFORE, LaterHeader, first_rows, later_header
from canlog.logs.signal_tables.table import TableHeader, table_of

TEXT = "Time,Speed,Gear\ns,km/h,\n" + "".join(f"{row / 10},{row},{row % 5}\n" for row in range(20))
NAN = np.nan
ROWS = {
    "a row of values": ("2.1,20,3", None),
    "the header": ("Time,Speed,Gear", AS_BEFORE),
    "its units": ("s,km/h,", AS_BEFORE),
    "other order": ("Time,Gear,Speed", LaterHeader(order=(0, 2, 1))),
    "more": (
        "Time,Boost,Gear,Speed",
        LaterHeader(order=(0, 3, 2), new_names=frozenset({"Boost"})),
    ),
    "others": ("Time,Boost", LaterHeader(order=(0, None, None), is_unknown=True, new_names=frozenset({"Boost"}))),
}


@pytest.mark.parametrize("name", ROWS)
def test_a_row_between_others_may_be_a_header(name: str) -> None:
    header = table_of(TEXT.encode())
    assert isinstance(header, TableHeader)
    line, later = ROWS[name]
    assert later_header(line.split(","), header) == later


@pytest.mark.parametrize(
    ("clocks", "behind_header", "rows"),
    [
        ([[0.0, 1.0, 0.0, 1.0]], [], [0]),  # of one clock values stay as they come
        ([[0.0, 1.0, 2.0], [0.5, 1.5, 2.5]], [], [0]),
        ([[0.0, 1.0, 0.0, 1.0], [0.5, 1.5, 0.5, 1.5]], [], [0, 2]),
        ([[0.0, 1.0, 0.0, 1.0], [0.5, 1.5, 1.6, 1.7]], [], [0]),  # one cell is damaged
        ([[0.0, 1.0, 0.0, 1.0], [0.5, 1.5, NAN, NAN]], [], [0, 2]),
        ([[0.0, 1.0, 2.0], [0.5, 1.5, 2.5]], [2], [0, 2]),
        ([[0.0, 1.0, 2.0], [0.5, 1.5, 2.5]], [3], [0]),
    ],
)
def test_a_recording_begins_where_a_header_stood_or_all_clocks_fall(
    clocks: list[list[float]], behind_header: list[int], rows: list[int]
) -> None:
    assert first_rows([np.array(clock) for clock in clocks], behind_header) == rows
