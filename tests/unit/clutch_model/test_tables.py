import math

import pytest

from clutch_model.errors import CalibrationError
from clutch_model.tables import check_keys, number, numbers, subtable


def test_unknown_and_missing_keys_are_named() -> None:
    check_keys("film", ["a", "b"], ["b", "a"])
    with pytest.raises(CalibrationError, match=r"film: unknown key \['c'\]"):
        check_keys("film", ["a", "c"], ["a"])
    with pytest.raises(CalibrationError, match=r"film: missing key \['b'\]"):
        check_keys("film", ["a"], ["a", "b"])


def test_an_integer_is_a_number() -> None:
    value = number(3, "mass_kg")
    assert value == 3.0
    assert isinstance(value, float)


@pytest.mark.parametrize("value", ["3", True, None, math.nan, math.inf, [1.0]])
def test_what_is_not_a_finite_number_is_refused(value: object) -> None:
    with pytest.raises(CalibrationError, match="mass_kg"):
        number(value, "mass_kg")


@pytest.mark.parametrize("value", [[1.0], [1.0, 2.0, 3.0], "12", 1.0, [1.0, "2"]])
def test_lists_have_their_length_and_numbers(value: object) -> None:
    assert numbers([1, 2.5], "gear_ratios", 2) == (1.0, 2.5)
    with pytest.raises(CalibrationError, match="gear_ratios"):
        numbers(value, "gear_ratios", 2)


def test_a_table_is_a_table() -> None:
    assert subtable({"a": 1}, "engine") == {"a": 1}
    with pytest.raises(CalibrationError, match="engine must be a table"):
        subtable([1], "engine")
