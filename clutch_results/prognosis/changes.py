"""Fluid changes that nobody noted: a step of friction towards new fluid, held against trend and temperature.

A test for a change alone would take slow ageing for one. Here a straight line over the distance, a temperature
coefficient and a step explain the last results; the step is believed where it explains them so much better that chance
hardly does so in the life of a vehicle.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from clutch_results.prognosis.assumptions import REFERENCE_K
from clutch_results.prognosis.history import History, robust_noise_ratio

# Rows that say where friction was: share of chi-square that each reaches.
BEFORE_COUNTS: Final = {480: 1.0, 60: 0.7, 30: 0.5}
LEAST_BEFORE: Final = 20
AFTER_COUNTS: Final = {6: 1.5, 8: 1.3, 11: 1.1, 15: 1.0}  # rows that say where it is now: share likewise
LEAST_AFTER: Final = min(AFTER_COUNTS)
STEP_CHI_SQUARE: Final = 36.0  # of two coefficients; set on simulated lives, docs/accuracy.md
CLIP_STD: Final = 3.5  # a row farther from its neighbours counts as if it were so far
SLOPE_STD_PER_M: Final = 1.0e-8  # of mu_C and mu_S over their means: 10 % in 10,000 km, ten times what is usual
WARMTH_STD_PER_K: Final = 5.0e-4
_UNIT_M: Final = 1.0e7  # keeps the normal equations well scaled


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidStart:
    """Where another fluid begins in a history."""

    row: int
    odometer_m: float
    is_noted: bool  # by a fill; else found in the friction
    noticed_row: int  # with this one it was known


def fluid_starts(history: History) -> tuple[FluidStart, ...]:
    """Return where each fluid begins, the first one included, whether its fill was noted or not."""
    starts: list[FluidStart] = []
    noted = [0, *(np.flatnonzero(np.diff(history.fluid_number)) + 1).tolist(), len(history)]
    for first, stop in pairwise(noted):
        starts.append(_start(history, first, first, is_noted=True))
        change = _next_change(history, first, stop)
        while change is not None:
            starts.append(_start(history, *change, is_noted=False))
            change = _next_change(history, change[0], stop)
    return tuple(starts)


def _start(history: History, row: int, noticed_row: int, *, is_noted: bool) -> FluidStart:
    return FluidStart(row=row, odometer_m=float(history.odometer_m[row]), is_noted=is_noted, noticed_row=noticed_row)


def _next_change(history: History, first: int, stop: int) -> tuple[int, int] | None:
    """Return the first row of a new fluid that nobody noted between two rows, and the row with which it shows."""
    if stop - first < LEAST_BEFORE + LEAST_AFTER:
        return None
    relative, std = _clean(history, first, stop)
    sums = _Sums.of(history, first, stop, std)
    correlation = float(np.median(history.random_correlation[first:stop]))
    best, place = _scan(sums, relative, correlation, stop - first)
    rows = np.flatnonzero(best > STEP_CHI_SQUARE)
    if not len(rows):
        return None
    last = int(rows[0])
    settled = last + int(np.argmax(best[last : last + LEAST_AFTER + 1]))  # the next rows say more exactly where
    return first + int(place[settled]), first + last


def _clean(history: History, first: int, stop: int) -> tuple[FloatArray, FloatArray]:
    """Return both coefficients over their means and their deviations, shape (2, n), outliers pulled in."""
    values, stds = [], []
    for mu, std in ((history.mu_c, history.random_std_mu_c), (history.mu_s, history.random_std_mu_s)):
        mean = float(np.mean(mu[first:stop]))
        value, wide = mu[first:stop] / mean, std[first:stop] / mean
        wide = wide * robust_noise_ratio(value, wide)
        # Of each row, the two before and the two after it; at the ends what is there counts twice.
        around = np.lib.stride_tricks.sliding_window_view(np.pad(value, 2, mode="reflect"), 5)
        middle = np.asarray(np.median(around, axis=1))
        values.append(middle + np.clip(value - middle, -CLIP_STD * wide, CLIP_STD * wide))
        stds.append(wide)
    return np.array(values), np.array(stds)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sums:
    """Running sums of the normal equations of a straight line with temperature, shape (..., 2, n + 1)."""

    weight: FloatArray  # (2, n)
    regressors: FloatArray  # (3, n): one, distance, temperature
    outer: FloatArray  # (3, 3, 2, n + 1)

    @classmethod
    def of(cls, history: History, first: int, stop: int, std: FloatArray) -> "_Sums":
        """Sum over some rows of a history."""
        odometer_m, warmth_k = history.odometer_m[first:stop], history.sump_temperature_k[first:stop] - REFERENCE_K
        distance = (odometer_m - odometer_m[0]) / _UNIT_M
        regressors = np.array([np.ones(stop - first), distance, warmth_k])
        weight = std**-2
        products = weight * (regressors[:, None] * regressors[None, :])[:, :, None]
        return cls(weight=weight, regressors=regressors, outer=_running(products))

    def moments(self, relative: FloatArray) -> FloatArray:
        """Return running sums of regressors times values, shape (3, 2, n + 1)."""
        return _running(self.weight * (relative - 1.0) * self.regressors[:, None])


def _running(values: FloatArray) -> FloatArray:
    """Return the sums of everything before each row, along the last axis, which becomes one longer."""
    return np.concatenate((np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)), axis=-1)


def _scan(sums: _Sums, relative: FloatArray, correlation: float, count: int) -> tuple[FloatArray, Int64Array]:
    """Return for each row by how much a step right before the last few rows explains them better, and where it is."""
    moments = sums.moments(relative)
    best, place = np.zeros(count), np.zeros(count, np.int64)
    for after, after_share in AFTER_COUNTS.items():
        ends = np.arange(LEAST_BEFORE + after, count + 1)
        if not len(ends):
            break
        changes = ends - after
        chi_square = np.full(len(ends), np.inf)
        for before, share in BEFORE_COUNTS.items():
            steps, stds = _steps(sums.outer, moments, np.maximum(changes - before, 0), changes, ends)
            is_towards_new = steps[0] > steps[1]  # mu_C rises against mu_S; a step the other way is something else
            z = steps / stds
            both = z[0] ** 2 + z[1] ** 2 - 2.0 * correlation * z[0] * z[1]
            better = np.where(is_towards_new, both / (1.0 - correlation**2), 0.0)
            chi_square = np.minimum(chi_square, better / (share * after_share))
        is_better = chi_square > best[ends - 1]
        rows = ends[is_better] - 1
        best[rows], place[rows] = chi_square[is_better], changes[is_better]
    return best, place


def _steps(
    outer: FloatArray, moments: FloatArray, firsts: Int64Array, changes: Int64Array, ends: Int64Array
) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares steps of both coefficients and their deviations, shape (2, number of stretches)."""
    line = outer[..., ends] - outer[..., firsts]
    line[1, 1] += (SLOPE_STD_PER_M * _UNIT_M) ** -2
    line[2, 2] += WARMTH_STD_PER_K**-2
    step = outer[0][..., ends] - outer[0][..., changes]
    normal = [[*line[0], step[0]], [*line[1], step[1]], [*line[2], step[2]], [*step, step[0]]]
    moment = moments[..., ends] - moments[..., firsts]
    right = [*moment, moments[0][..., ends] - moments[0][..., changes]]
    for done in range(3):  # elimination: what is left in the last place is of the step alone
        for row in range(done + 1, 4):
            share = normal[done][row] / normal[done][done]
            for column in range(row, 4):
                normal[row][column] = normal[row][column] - share * normal[done][column]
            right[row] = right[row] - share * right[done]
    return np.asarray(right[3] / normal[3][3]), np.asarray(1.0 / np.sqrt(normal[3][3]))
