"""The cycle that a message keeps, where it is slower than its database says."""

import numpy as np
import pytest

from canlog.arrays import Int64Array, Series
from canlog.e2e.alive_counter import SLOWEST, own_period_ns

MS = 1_000_000
NOMINAL_NS = 10 * MS
COUNT = 100


def series(t_ns: Int64Array, sequence: Int64Array | None = None, period_ns: int = NOMINAL_NS) -> Series:
    numbers = np.arange(len(t_ns)) if sequence is None else sequence
    return Series(t_ns=t_ns, sequence=numbers, value=np.zeros(len(t_ns)), period_ns=period_ns)


def every(period_ns: int, count: int = COUNT) -> Int64Array:
    return np.arange(count, dtype=np.int64) * period_ns


@pytest.mark.parametrize("cycle_ms", [13, 15, 20, 50])
def test_a_slower_cycle_is_found_in_spite_of_jitter_and_gaps(cycle_ms: int) -> None:
    rng = np.random.default_rng(cycle_ms)
    t_ns = every(cycle_ms * MS) + rng.integers(0, MS, COUNT)
    t_ns[60:] += 300 * MS  # the bus was silent
    is_kept = rng.random(COUNT) < 0.9
    found = series(t_ns[is_kept], np.arange(COUNT)[is_kept])
    assert own_period_ns(found) == cycle_ms * MS


@pytest.mark.parametrize("t_ns", [every(9 * MS), every(NOMINAL_NS), every(12 * MS), every((SLOWEST + 1) * NOMINAL_NS)])
def test_jitter_and_what_is_far_too_slow_leave_the_database_right(t_ns: Int64Array) -> None:
    assert own_period_ns(series(t_ns)) == NOMINAL_NS
