"""Numbers in cells: what points and commas mean, units behind numbers, and what is none."""

import math

import numpy as np
import pytest

from canlog.logs.signal_tables.cells import Marks, marks_of, number_in, numbers_in, unit_behind, without_unit

MARKS = {
    "decimals by points": ([["0.5", "1.5"], ["800", "801"]], ".", ","),
    "decimals by commas": ([["0,5", "1,5"], ["800", "801"]], ",", ""),
    "thousands by commas, decimals by points elsewhere": ([["0.5", "1.5"], ["1,080", "1,100"]], ".", ","),
    "thousands by commas in a column that has none below": ([["0", "1", "2"], ["960", "980", "1,000"]], ".", ","),
    "millions by commas": ([["0", "1"], ["1,234,567", "1,234,568"]], ".", ","),
    "both, commas first": ([["0", "1"], ["1,234.5", "1,234.6"]], ".", ","),
    "both, points first": ([["0", "1"], ["1.234,5", "1.234,6"]], ",", "."),
    "thousands by points, decimals by commas elsewhere": ([["0,5", "1,5"], ["1.080", "1.100"]], ",", "."),
    "thousands by points in a column that has none below": ([["0", "1"], ["960", "980", "1.000"]], ",", "."),
    "three decimals by commas beside others": ([["0,500", "1,000"], ["1,250", "1,300"]], ",", ""),
    "points beside decimal commas are decimals too": ([["0,5", "1,5"], ["51.12345", "51.12346"]], ",", ""),
    "integers alone": ([["0", "1"], ["800", "801"]], ".", ","),
}


@pytest.mark.parametrize("name", MARKS)
def test_marks_of_numbers_are_told_by_all_cells(name: str) -> None:
    cells, decimal, grouping = MARKS[name]
    marks = marks_of(cells)
    assert (marks.decimal, marks.grouping) == (decimal, grouping)
    assert marks.why


def test_what_nothing_shows_is_told() -> None:
    marks = marks_of([["0", "1"], ["1,080", "1,090"]], ["Time", "Pressure bar"])
    assert marks.decimal == ","
    assert marks.notes == ("1,080 is read as 1.080: nothing shows whether its comma groups thousands",)
    assert number_in("1,080", marks) == 1.08


@pytest.mark.parametrize(("cell", "read"), [("1,080", "750,125"), ("1.080", "750.125")])
def test_no_shaft_turns_once_a_minute(cell: str, read: str) -> None:
    marks = marks_of([["0", "1"], [cell, cell]], ["Time", "Engine RPM"])
    assert number_in(cell, marks) == 1080.0
    assert len(marks.notes) == 1
    assert number_in(read, marks_of([["0", "1"], [read, read]], ["Time", "Engine RPM"])) == 750.125


def test_between_commas_a_quoted_comma_groups() -> None:
    assert number_in("1,080", marks_of([["0", "1"], ["1,080", "1,090"]], separator=",")) == 1080.0


COMMAS = Marks(decimal=",", grouping=".")
CELLS = [
    ("1,080", Marks(), 1080.0), ("-12,345.5", Marks(), -12345.5), ("1,5", Marks(), 1.5), ("0,080", Marks(), 0.08),
    ("1.080", COMMAS, 1080.0), ("1.080,25", COMMAS, 1080.25), ("1,080", COMMAS, 1.08), ("0.5", COMMAS, 0.5),
    ("1 080", Marks(), 1080.0), ("1\u202f080,5", COMMAS, 1080.5), ("12'345", Marks(), 12345.0),
    ("on", Marks(), 1.0), ("", Marks(), math.nan), ("n/a", Marks(), math.nan), ("1e31", Marks(), math.inf),
    ("12 34", Marks(), math.inf), ("oops", COMMAS, math.inf), ("1,2,3", Marks(), math.inf),
]  # fmt: skip


@pytest.mark.parametrize(("cell", "marks", "value"), CELLS)
def test_a_cell_is_a_number_a_blank_or_neither(cell: str, marks: Marks, value: float) -> None:
    assert number_in(cell, marks) == pytest.approx(value, nan_ok=True)
    np.testing.assert_array_equal(numbers_in([cell, "7"], marks), [number_in(cell, marks), 7.0])


UNITS = {
    "blank before": (["800 rpm", "801 rpm", "802 rpm"], "rpm"),
    "no blank": (["12.5V", "12.6V", "", "12.5V"], "V"),
    "sign": (["80°C", "81°C", "82°C"], "°C"),
    "areas": (["1.0 kgf/cm2", "1.1 kgf/cm2", "1.2 kgf/cm2"], "kgf/cm2"),
    "some without": (["1 bar", "2 bar", "3 bar", "4"], "bar"),
    "bytes": (["1A", "2A", "3A"], ""),
    "gears": (["1st", "2nd", "3rd"], ""),
    "numbers": (["1", "2", "3"], ""),
    "few": (["1 bar", "2", "3", "4"], ""),
}


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_may_stand_behind_the_numbers_of_a_column(name: str) -> None:
    cells, unit = UNITS[name]
    assert unit_behind(cells) == unit
    assert not unit or number_in(without_unit(cells[0], unit)) == number_in(cells[0].removesuffix(unit))
