"""Rows of a table: the curve through them, and how far it may be from what was."""

import numpy as np
import pytest

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import row_period_ns
from diag_service.diagnosis.alignment import RowCurve, held_s

TIMES_S: FloatArray = np.arange(40, dtype=np.float64) * 0.04


def series(t_ns: Int64Array, *, sequence: int = -1, period_ns: int = 0) -> Series:
    count = len(t_ns)
    return Series(t_ns=t_ns, sequence=np.full(count, sequence), value=np.zeros(count), period_ns=period_ns)


def test_columns_with_the_times_of_one_table_have_its_period() -> None:
    rows_ns = np.arange(10) * 37_000_000
    assert row_period_ns([series(rows_ns), series(rows_ns), series(rows_ns[:9])]) == 37_000_000


@pytest.mark.parametrize("period_s", [0.02, 0.1, 0.3])
def test_a_curve_states_how_far_it_is_off_between_few_rows(period_s: float) -> None:
    """A rise and a fall with a kink in the end; sums over all of it, too: its errors are not independent."""
    far = list[float]()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        times_s = np.arange(0.0, 4.0, period_s) + rng.uniform(0.0, period_s)
        curve = RowCurve(times_s, _torque_nm(times_s) + rng.normal(0.0, 3.0, len(times_s)), 3.0, 0.0, 0.0)
        first, stop = np.searchsorted(curve.times_s, (1.0, 3.0))
        weights = np.sin(np.pi * np.arange(stop - first) / (stop - first))
        off_nm = weights @ (curve.value - _torque_nm(curve.times_s))[first:stop]
        far.append(float(off_nm / np.sqrt(9.0 * weights @ curve.covariance(first, stop) @ weights)))
    assert 0.4 < np.sqrt(np.mean(np.square(far))) < 1.2


def _torque_nm(times_s: FloatArray) -> FloatArray:
    return np.asarray(np.where(times_s < 2.4, 80.0 * np.sin(np.clip(times_s - 0.6, 0.0, None)) ** 2, 75.0))


def test_held_values_are_told_from_those_at_rest() -> None:
    moving: FloatArray = 50.0 * TIMES_S
    assert held_s(TIMES_S, moving, 0.5) == 0.0
    held: FloatArray = moving[(np.arange(40) // 3) * 3]  # asked three times as often as it is refreshed
    assert held_s(TIMES_S, held, 0.5) == pytest.approx(0.12)
    at_rest = np.where(TIMES_S < 0.8, 1.0, 2.0)
    assert held_s(TIMES_S, at_rest, 0.5) == 0.0
