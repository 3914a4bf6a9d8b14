"""The curve through the few rows of a table's column, and how sure it is."""

import math

import numpy as np

from canlog.arrays import FloatArray

POINT_S, POINTS_PER_ROW = 0.01, 4  # of the curve through rows: as near as frames, or as is of use
WALK_RATIO = 2.0  # of what slopes near by say: of four each may be small by chance
LEAST_WALK = 1.0  # of what the noise of three rows alone would look like
HELD_STEPS, HELD_ROWS, LEAST_RUNS = 2.5, 1.5, 4  # of the resolution, of the rows, of what must agree


class RowCurve:
    """The curve through the rows of a column that bends as little as its rows do, and how sure it is.

    What the column does between rows is a random walk of its slope, as large as the slopes of rows near by differ; what
    is off in each row is independent; an age that all rows share moves the whole curve.

    Parameters
    ----------
    times_s, value : (n,) array
        The column; n >= 2.
    noise_std
        Of its sensor.
    age_std_s, own_age_std_s
        Of the age that all rows share, and of that which each has of its own.
    """

    def __init__(
        self, times_s: FloatArray, value: FloatArray, noise_std: float, age_std_s: float, own_age_std_s: float
    ) -> None:
        from scipy.linalg import cho_solve_banded, cholesky_banded  # noqa: PLC0415 - it takes a while to load

        rise, moved = np.diff(value), np.abs(np.diff(value)) > 0.0
        step = float(np.abs(rise[moved]).min()) if moved.any() else 0.0
        own_s = math.hypot(own_age_std_s, held_s(times_s, value, step) / math.sqrt(12.0))
        variance = noise_std**2 + step**2 / 12.0 + (own_s * np.gradient(value, times_s)) ** 2
        period_s = float(np.median(np.diff(times_s)))
        spacing_s = max(POINT_S, period_s / POINTS_PER_ROW)
        count = max(3, math.ceil((times_s[-1] - times_s[0]) / spacing_s) + 1)
        self.times_s, spacing_s = np.linspace(times_s[0], times_s[-1], count, retstep=True)
        walk = _slope_walk(times_s, value, noise_std)[np.searchsorted(times_s[1:-1], self.times_s[1:-1])]
        stiffness = 1.0 / (walk * spacing_s**3)
        bands = np.zeros((3, count))  # of the information, upper form
        for k, first in enumerate((1.0, -2.0, 1.0)):
            for j, second in enumerate((1.0, -2.0, 1.0)[k:]):
                bands[2 - j, k + j : count - 2 + k + j] += first * second * stiffness
        left = np.minimum(((times_s - times_s[0]) / spacing_s).astype(np.int64), count - 2)
        share = (times_s - self.times_s[left]) / spacing_s
        rows, at = np.zeros((len(value), count)), np.arange(len(value))  # each by the points, in deviations
        rows[at, left], rows[at, left + 1] = 1.0 - share, share
        rows /= np.sqrt(variance)[:, None]
        bands[2] += (rows**2).sum(axis=0)
        bands[1, 1:] += (rows[:, :-1] * rows[:, 1:]).sum(axis=0)
        self._root, self._noise_std = cholesky_banded(bands), noise_std
        self._by_rows = cho_solve_banded((self._root, False), rows.T)
        self.value = self._by_rows @ (value / np.sqrt(variance))
        self._moved_by_age = age_std_s * np.gradient(self.value, spacing_s)

    def covariance(self, first: int, stop: int) -> FloatArray:
        """Return that of the points ``first <= point < stop``, in variances of the sensor."""
        from scipy.linalg import cho_solve_banded  # noqa: PLC0415 - it takes a while to load

        unit = np.eye(len(self.value), stop - first, -first)
        by_age = self._moved_by_age[first:stop]
        covariance = cho_solve_banded((self._root, False), unit)[first:stop] + np.outer(by_age, by_age)
        return np.asarray(covariance / self._noise_std**2)

    def followed(self, first: int, stop: int) -> FloatArray:
        """Return likewise how far points are off where they are high: by what noise of rows the loose walk lets in."""
        by_rows = self._by_rows[first:stop] / self._noise_std
        return np.asarray((1.0 - 1.0 / WALK_RATIO) * by_rows @ by_rows.T)


def _slope_walk(times_s: FloatArray, value: FloatArray, noise_std: float) -> FloatArray:
    """Return by how much the variance of a column's slope grows in a second between its rows, shape (n - 1,)."""
    periods_s = np.diff(times_s)
    if len(value) < 3:
        return np.full(1, (np.ptp(value) + noise_std) ** 2 / periods_s[0] ** 3)
    spans_s = periods_s[1:] + periods_s[:-1]
    walk = 3.0 * np.diff(np.diff(value) / periods_s) ** 2 / spans_s
    walk = np.pad(walk, 2, mode="edge")
    near = (walk[:-3] + walk[1:-2] + walk[2:-1] + walk[3:]) * (WALK_RATIO / 4.0)
    return np.asarray(np.maximum(near, LEAST_WALK * noise_std**2 / np.median(periods_s) ** 3))


def held_s(times_s: FloatArray, value: FloatArray, step: float) -> float:
    """Return for how long [s] a column holds a value while it moves; 0 if each row has its own.

    Where runs of one value end in a jump of several steps they were held, not at rest.
    """
    starts = np.flatnonzero(np.diff(value, prepend=np.nan) != 0.0)
    if len(starts) < LEAST_RUNS:
        return 0.0
    jumps = np.abs(np.diff(value[starts])) > HELD_STEPS * step
    lengths_s = np.diff(times_s[starts])[jumps]
    if len(lengths_s) < LEAST_RUNS:
        return 0.0
    held = float(np.median(lengths_s))
    return held if held > HELD_ROWS * float(np.median(np.diff(times_s))) else 0.0
