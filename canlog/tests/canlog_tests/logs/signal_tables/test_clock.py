"""Clocks of tables: which column they are, how their times are written, and why there is none."""

import numpy as np
import pytest

from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.cells import Marks
from canlog.logs.signal_tables.clock import NoRowClock, RowClock, clock_of, pace_of

COUNT = 40
DAY_S = 86_400.0
ROWS = np.arange(COUNT)
VALUES = [str(800 + row % 7) for row in ROWS]


def column(name: str) -> SignalColumn:
    return SignalColumn(name, "")


def found(*columns: tuple[str, list[str]]) -> RowClock | NoRowClock:
    return clock_of([column(name) for name, _ in columns], [cells for _, cells in columns])


def counted(step: float, start: float = 0.0, digits: int = 3) -> list[str]:
    return [f"{start + step * row:.{digits}f}" for row in ROWS]


CLOCKS: dict[str, tuple[list[tuple[str, list[str]]], str, str]] = {
    "named": ([("A", counted(1.0)), ("Time", counted(0.1))], "Time", ""),
    "row number before a part of a name": (
        [("LogID", [str(row + 1) for row in ROWS]), ("LogEntrySeconds", counted(0.094, 0.22, 5)), ("A", VALUES)],
        "LogEntrySeconds",
        "",
    ),
    "first column": ([("x", counted(0.05)), ("A", VALUES)], "x", ""),
    "duration that rises": ([("Seconds", counted(0.1)), ("Shift Time", counted(1.0, 300.0, 0))], "Seconds", ""),
    "nothing named": (
        [("A", VALUES), ("Ticks", counted(0.05))], "Ticks",
        "no column is named as a time: 'Ticks' alone rises in steady steps, and is taken as the time",
    ),
    "days of a spreadsheet": (
        [("Date", counted(1.0 / DAY_S, 45255.59375, 9)), ("A", VALUES)], "Date",
        "times are taken as days since 1899-12-30, as spreadsheets count them",
    ),
    "parts of a day": (
        [("Time", counted(0.1 / DAY_S, 0.59375, 9)), ("A", VALUES)], "Time",
        "times are taken as parts of a day, as spreadsheets keep times of day",
    ),
    "a fast recorder": ([("Time", counted(1e-4, 0.0, 5)), ("A", VALUES)], "Time", ""),
    "minutes of an hour": (
        [("Time", [f"14:{row:02d}.5" for row in ROWS]), ("A", VALUES)], "Time",
        "times of 'Time' are minutes and seconds: their hour is not told",
    ),
    "month first by a number": (
        [("When", [f"11/25/2023 14:15:{row:02d}" for row in ROWS]), ("A", VALUES)], "When", "",
    ),
    "month first by the halves of a day": (
        [("Date Time", [f"3/4/2026 2:15:{row:02d} PM" for row in ROWS]), ("A", VALUES)], "Date Time", "",
    ),
    "month or day first": (
        [("Date Time", [f"03/04/2026 14:15:{row:02d}" for row in ROWS]), ("A", VALUES)], "Date Time",
        "03/04/2026 14:15:00 is taken as a date with the day first: no number in it is above 12",
    ),
    "date and time": (
        [("Date", ["2026-03-15"] * COUNT), ("Time", [f"22:34:{row:02d}.5" for row in ROWS]), ("A", VALUES)], "Time", "",
    ),
}  # fmt: skip
FIRST_S = {
    "days of a spreadsheet": 1700921700.0,
    "parts of a day": 51300.0,
    "minutes of an hour": 840.5,
    "month first by a number": 1700921700.0,
    "month first by the halves of a day": 1772633700.0,
    "month or day first": 1775225700.0,
    "date and time": 1773614040.5,
}


@pytest.mark.parametrize("name", CLOCKS)
def test_the_clock_of_a_table(name: str) -> None:
    columns, place, note = CLOCKS[name]
    clock = found(*columns)
    assert isinstance(clock, RowClock)
    assert columns[clock.place][0] == place
    assert clock.why.startswith(repr(place))
    assert not note or note in clock.notes
    assert clock.time_us[0] / 1e6 == pytest.approx(FIRST_S.get(name, float(clock.time_us[0]) / 1e6), abs=1e-3)
    assert np.all(np.diff(clock.time_us) > 0.0)


NO_CLOCKS: dict[str, tuple[list[tuple[str, list[str]]], str]] = {
    "rows counted": ([("No", [str(row) for row in ROWS]), ("A", VALUES)], "'No' only counts the rows"),
    "index without a name": (
        [("", [str(row) for row in ROWS]), ("A", VALUES)],
        "the first column only counts the rows",
    ),
    "catalogue": (
        [("ID", [str(100 + 7 * row) for row in ROWS]), ("Name", [f"Speed{row}" for row in ROWS])],
        "each row names another thing: a list or catalogue, not a log",
    ),
    "cycle times": (
        [("Message", [f"Speed{row}" for row in ROWS]), ("Cycle time", counted(10.0))],
        "each row names another thing: a list or catalogue, not a log",
    ),
    "two that rise": ([("A", VALUES), ("B", counted(0.1)), ("C", counted(0.2))], "no column holds times that rise"),
    "words as times": ([("Time", ["soon"] * COUNT), ("A", VALUES)], "the times in 'Time' cannot be read"),
    "standing": ([("Time", ["1.0"] * COUNT), ("A", VALUES)], "the times in 'Time' cannot be read or do not rise"),
}


@pytest.mark.parametrize("name", NO_CLOCKS)
def test_why_there_is_no_clock(name: str) -> None:
    columns, why = NO_CLOCKS[name]
    clock = found(*columns)
    assert isinstance(clock, NoRowClock)
    assert clock.why.startswith(why)
    assert clock.is_list is why.startswith("each row")


def test_a_pause_and_a_clock_that_begins_again_are_no_other_pace() -> None:
    row_us = np.concatenate([np.arange(30.0), 6000.0 + np.arange(30.0)]) * 1e5
    again = [f"{row % 30 / 10:.1f}" for row in range(60)]
    assert pace_of(again, SignalColumn("elapsed_time", "s"), row_us) == pytest.approx(1.0)
    slow = [f"{row / 100:.2f}" for row in range(60)]
    assert pace_of(slow, SignalColumn("slow time", "s"), np.arange(60.0) * 1e5) == pytest.approx(0.1)


def test_decimal_commas_are_times_too() -> None:
    cells = [cell.replace(".", ",") for cell in counted(0.1)]
    clock = clock_of([column("Zeit"), column("A")], [cells, VALUES], Marks(decimal=",", grouping=""))
    assert isinstance(clock, RowClock)
    assert clock.time_us[1] == pytest.approx(1e5)
