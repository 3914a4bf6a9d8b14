"""How often a message really comes, where that is less often than its database says.

A vehicle may send every 20 ms what its database has every 10 ms. Held against the database it would lose every second
frame and run late for ever; held against its own cycle it is as regular as any other. The alive counter tells the two
apart: frames that were sent and lost leave gaps in it.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.jit import array_kernel

SLOWEST: Final = 5  # cycles of the database: what comes less often is not believed to be meant so
SLOWER_RATIO: Final = 1.25  # below it the database is believed: jitter is no other cycle
LEAST_STEPS: Final = 8
LEAST_REGULAR: Final = 0.5  # share of the steps that must be near the typical one
NEAR: Final = 0.25  # of the typical step
LEAST_SHARED: Final = 0.8  # of the times of columns: cells may be blank
NS_PER_MS: Final = 1_000_000
_NO_SAMPLES: Final = np.empty(0, np.int64)


def own_period_ns(series: Series) -> int:
    """Return the cycle that the samples of a stretch keep [ns]; the database's unless they plainly keep a slower one.

    Cycles are whole milliseconds. A stretch that is too short, without a regular step, or slower than ``SLOWEST``
    cycles of the database is held against the database, and fails there.
    """
    if series.period_ns <= 0 or len(series.t_ns) <= LEAST_STEPS:
        return series.period_ns
    if most_are_shorter(series.t_ns, series.sequence, SLOWER_RATIO * series.period_ns):
        return series.period_ns  # what follows would say so too, at length
    mean_ns = _mean_step_ns(series)
    steps_ns = _steps_ns(series)
    typical_ns = float(np.median(steps_ns))
    if not SLOWER_RATIO * series.period_ns <= typical_ns <= (SLOWEST + NEAR) * series.period_ns:
        return series.period_ns
    if abs(mean_ns - typical_ns) > NEAR * typical_ns:
        return series.period_ns  # a sender that waits too long and then makes up for it keeps its cycle
    regular_ns = steps_ns[np.abs(steps_ns - typical_ns) <= NEAR * typical_ns]
    if len(regular_ns) < LEAST_REGULAR * len(steps_ns):
        return series.period_ns
    own_ns = round(float(regular_ns.mean()) / NS_PER_MS) * NS_PER_MS
    return own_ns if series.period_ns < own_ns <= SLOWEST * series.period_ns else series.period_ns


def row_period_ns(columns: Sequence[Series]) -> int:
    """Return the time from row to row [ns] of a table whose columns these are; 0 if they are none of one."""
    times_ns = columns[0].t_ns
    return int(np.median(np.diff(times_ns))) if len(times_ns) > 1 and share_rows(columns) else 0


def share_rows(columns: Sequence[Series]) -> bool:
    """Return whether columns have the times of the rows of one table; messages of a bus have their own, or counters."""
    if any(one.period_ns or not len(one.t_ns) or one.sequence[0] >= 0 for one in columns):
        return False
    return all(np.isin(one.t_ns, columns[0].t_ns).mean() >= LEAST_SHARED for one in columns[1:])


@array_kernel
def most_are_shorter(t_ns: Int64Array, sequence: Int64Array, limit_ns: float) -> bool:
    """Return whether more than half of the steps, and so the typical one, are shorter than a limit [ns]."""
    count = 0
    for number in range(1, len(t_ns)):
        step_ns = float(t_ns[number] - t_ns[number - 1])
        if sequence[0] >= 0:
            step_ns /= max(sequence[number] - sequence[number - 1], 1)
        count += step_ns < limit_ns
    return 2 * count > len(t_ns) - 1


def compile_now() -> None:
    """Have it compiled before the first frames come: they must not wait for it."""
    most_are_shorter(_NO_SAMPLES, _NO_SAMPLES, 0.0)


def _mean_step_ns(series: Series) -> float:
    """Return the time from one transmission to the next over the whole stretch."""
    count = len(series.t_ns) - 1 if series.sequence[0] < 0 else int(series.sequence[-1] - series.sequence[0])
    return int(series.t_ns[-1] - series.t_ns[0]) / max(count, 1)


def _steps_ns(series: Series) -> FloatArray:
    """Return the time from one transmission to the next, wherever two samples tell it, shape (n - 1,)."""
    steps_ns: FloatArray = np.diff(series.t_ns).astype(np.float64)
    if series.sequence[0] >= 0:
        steps_ns /= np.maximum(np.diff(series.sequence), 1)
    return steps_ns
