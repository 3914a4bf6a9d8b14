"""Rows of a table: how far their values may be from those of their moment."""

import numpy as np
import pytest

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import row_period_ns
from diag_service.diagnosis.alignment import FRAME_AGE_STD_S, held_s, row_doubt

TIMES_S: FloatArray = np.arange(40, dtype=np.float64) * 0.04


def series(t_ns: Int64Array, *, sequence: int = -1, period_ns: int = 0) -> Series:
    count = len(t_ns)
    return Series(t_ns=t_ns, sequence=np.full(count, sequence), value=np.zeros(count), period_ns=period_ns)


def test_columns_with_the_times_of_one_table_have_its_period() -> None:
    rows_ns = np.arange(10) * 37_000_000
    assert row_period_ns([series(rows_ns), series(rows_ns), series(rows_ns[:9])]) == 37_000_000


@pytest.mark.parametrize(
    "other",
    [
        series(np.arange(10) * 37_000_000 + 1_000_000),  # a message with times of its own
        series(np.arange(10) * 37_000_000, sequence=3),  # one with a counter
        series(np.arange(10) * 37_000_000, period_ns=10_000_000),  # one with a cycle
        series(np.empty(0, np.int64)),
    ],
)
def test_messages_of_a_bus_are_no_table(other: Series) -> None:
    assert row_period_ns([series(np.arange(10) * 37_000_000), other]) == 0


def test_a_value_at_rest_is_as_good_as_its_sensor() -> None:
    assert row_doubt(TIMES_S, np.full(40, 5.0), 0.01) == pytest.approx(np.zeros(40))


def test_a_value_that_moves_is_unsure_by_its_age() -> None:
    rising: FloatArray = 100.0 * TIMES_S
    doubt = row_doubt(TIMES_S, rising, 0.01)
    step = 100.0 * 0.04
    assert doubt == pytest.approx(np.sqrt(step**2 / 12.0 + 1e4 * (0.01**2 + FRAME_AGE_STD_S**2)))


def test_a_bend_between_rows_is_bounded() -> None:
    """The straight line between two rows of a parabola is off by no more than is stated."""
    value: FloatArray = 200.0 * (TIMES_S - 0.8) ** 2
    middle_s = (TIMES_S[1:] + TIMES_S[:-1]) / 2.0
    off = np.abs((value[1:] + value[:-1]) / 2.0 - 200.0 * (middle_s - 0.8) ** 2)
    assert np.all(off <= row_doubt(TIMES_S, value, 0.0)[1:] + 1e-9)


def test_held_values_are_told_from_those_at_rest() -> None:
    moving: FloatArray = 50.0 * TIMES_S
    assert held_s(TIMES_S, moving, 0.5) == 0.0
    held: FloatArray = moving[(np.arange(40) // 3) * 3]  # asked three times as often as it is refreshed
    assert held_s(TIMES_S, held, 0.5) == pytest.approx(0.12)
    at_rest = np.where(TIMES_S < 0.8, 1.0, 2.0)
    assert held_s(TIMES_S, at_rest, 0.5) == 0.0
