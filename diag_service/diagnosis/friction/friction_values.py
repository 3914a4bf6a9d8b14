"""Friction coefficients and what can be said of them without the common scale; docs/model.md eqs. (34) to (37).

What a vehicle shows while it drives is how much torque it reads for how much pressure: friction times the gain of the
torque reading times the piston area. Where two such numbers are divided by each other, or one by what it was before,
the gain is gone, and in one clutch the area too.
"""

import math
from statistics import NormalDist
from typing import NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.evidence import Knowledge
from diag_service.diagnosis.friction.parameters import (
    FRICTION_COUNT,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    State,
    friction_rows,
)
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.records import ClutchRatio, FrictionEstimate, FrictionTrend, ScaleFreeFriction

MODEL_STD_RATIO = 0.004  # by which a real clutch differs from the law alike in all events: they do not average it out
_GAIN = STATE_COUNT + Considered.TORQUE_GAIN
_WIDTH = STATE_COUNT + Considered.STRIBECK_SPEED
_AREAS = (STATE_COUNT + Considered.PISTON_AREA1, STATE_COUNT + Considered.PISTON_AREA2)


class _Pair(NamedTuple):
    """Both coefficients of a clutch, times a factor, and how well they are known."""

    mu_c: float
    mu_s: float
    variance_c: float
    variance_s: float
    covariance: float

    @classmethod
    def of(cls, known: Knowledge, clutch: int, place: int, factor: float, slope: float) -> Self:
        """Return them, times a factor that has some slope over the parameter in this place."""
        rows = friction_rows(clutch)
        own_c, own_s = known.mean[rows].tolist()
        (c_c, c_s), (_, s_s) = known.covariance[rows, rows].tolist()
        (c_f, s_f), f_f = known.covariance[rows, place].tolist(), float(known.covariance[place, place])
        by_c, by_s = slope * own_c, slope * own_s
        mu_c, mu_s = factor * own_c, factor * own_s
        return cls(
            mu_c=mu_c,
            mu_s=mu_s,
            variance_c=factor * (factor * c_c + 2.0 * by_c * c_f) + by_c**2 * f_f + (MODEL_STD_RATIO * mu_c) ** 2,
            variance_s=factor * (factor * s_s + 2.0 * by_s * s_f) + by_s**2 * f_f + (MODEL_STD_RATIO * mu_s) ** 2,
            covariance=factor * (factor * c_s + by_s * c_f + by_c * s_f) + by_c * by_s * f_f,
        )

    @property
    def correlation(self) -> float:
        """Correlation of the errors of both."""
        return self.covariance / math.sqrt(self.variance_c * self.variance_s)


def friction(state: Posterior, clutch: int) -> FrictionEstimate:
    """Return the friction of clutch 1 or 2 as now estimated."""
    known, gain = state.known, state.torque_gain + float(state.known.mean[_GAIN])
    pair, free = _Pair.of(known, clutch, _GAIN, 1.0 / gain, -1.0 / gain**2), scale_free(state, clutch)
    width = state.stribeck_speed_rad_s[clutch - 1] * (1.0 + float(known.mean[_WIDTH]))
    difference = NormalDist(pair.mu_c - pair.mu_s, math.sqrt(pair.variance_c + pair.variance_s - 2.0 * pair.covariance))
    return FrictionEstimate(
        mu_c=pair.mu_c,
        mu_s=pair.mu_s,
        std_mu_c=math.sqrt(pair.variance_c),
        std_mu_s=math.sqrt(pair.variance_s),
        correlation=pair.correlation,
        random_std_mu_c=pair.mu_c * free.std_mu_c / free.mu_c,
        random_std_mu_s=pair.mu_s * free.std_mu_s / free.mu_s,
        slope_s_rad=difference.mean / width,
        std_slope_s_rad=difference.stdev / width,
        probability_negative_slope=difference.cdf(0.0),
    )


def scale_free(state: Posterior, clutch: int) -> ScaleFreeFriction:
    """Return the friction of clutch 1 or 2 times the true gain of the torque reading and the true piston area.

    The area counts as a ratio to what the calibration says.
    """
    area = _AREAS[clutch - 1]
    pair = _Pair.of(state.known, clutch, area, 1.0 + float(state.known.mean[area]), 1.0)
    return ScaleFreeFriction(
        mu_c=pair.mu_c,
        mu_s=pair.mu_s,
        std_mu_c=math.sqrt(pair.variance_c),
        std_mu_s=math.sqrt(pair.variance_s),
        correlation=pair.correlation,
    )


def common_margin(state: Posterior, new_margins: tuple[float, float]) -> NormalDist:
    """Return which part of ``mu_C - mu_S`` of new fluid is left if both clutches, which slip in one oil, lost the same.

    ``new_margins`` are those of new fluid. The better known clutch weighs more, by its variance; what both share is in
    the deviation.
    """
    known = state.known
    gain = float(state.torque_gain + known.mean[_GAIN])
    slope, own = np.zeros((2, PARAMETER_COUNT)), np.zeros(2)
    for m, new_margin in enumerate(new_margins):
        rows = friction_rows(m + 1)
        mu_c, mu_s = known.mean[rows] / gain
        slope[m, rows] = np.array([1.0, -1.0]) / (gain * new_margin)
        slope[m, _GAIN] = -(mu_c - mu_s) / (gain * new_margin)
        own[m] = (MODEL_STD_RATIO * np.hypot(mu_c, mu_s) / new_margin) ** 2
    left = slope[:, :FRICTION_COUNT] @ known.mean[:FRICTION_COUNT]
    covariance = slope @ known.covariance @ slope.T + np.diag(own)
    weights = 1.0 / np.diag(covariance)
    weights /= weights.sum()
    return NormalDist(float(weights @ left), float(np.sqrt(weights @ covariance @ weights)))


def common_scale_std_ratio(state: Posterior, clutch: int) -> float:
    """Return the relative deviation of gain times piston area: what all friction of clutch 1 or 2 shares, for good."""
    known, rows = state.known, [_GAIN, _AREAS[clutch - 1]]
    by_part = np.array([1.0 / (state.torque_gain + known.mean[_GAIN]), 1.0 / (1.0 + known.mean[rows[1]])])
    return float(np.sqrt(by_part @ known.covariance[np.ix_(rows, rows)] @ by_part))


def trend(state: Posterior, clutch: int) -> FrictionTrend | None:
    """Return what became of the friction of clutch 1 or 2 since its baseline, or None before there is one.

    The deviation is that of the difference: errors which both have are not in it.
    """
    baseline, later_count = state.baselines[clutch - 1], state.later_count(clutch)
    if baseline is None or later_count <= 0:
        return None
    known, rows = state.known, friction_rows(clutch)
    gain = float(state.torque_gain + known.mean[_GAIN])
    now, then = known.mean[rows], baseline.mean
    spread = known.covariance[rows, rows], baseline.covariance, state.cross(clutch)[rows]
    change, ratio = (now - then) / gain, now / then - 1.0
    std = _std_of_difference(np.ones(2), np.ones(2), spread) / gain
    relative_std = _std_of_difference(1.0 / then, now / then**2, spread)
    return FrictionTrend(
        change_mu_c=float(change[0]),
        change_mu_s=float(change[1]),
        std_change_mu_c=float(std[0]),
        std_change_mu_s=float(std[1]),
        change_mu_c_ratio=float(ratio[0]),
        change_mu_s_ratio=float(ratio[1]),
        std_change_mu_c_ratio=float(relative_std[0]),
        std_change_mu_s_ratio=float(relative_std[1]),
        baseline_end_bus_ns=baseline.end_ns,
        baseline_shift_count=baseline.shift_count,
        later_shift_count=later_count,
    )


def _std_of_difference(
    by_now: FloatArray, by_then: FloatArray, spread: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """Return the deviation of ``by_now * now - by_then * then``, shape (2,), by the covariances of each and of both."""
    now, then, cross = (np.diag(one) for one in spread)
    return np.asarray(np.sqrt(np.maximum(by_now**2 * now + by_then**2 * then - 2.0 * by_now * by_then * cross, 0.0)))


def clutch_ratio(state: Posterior) -> ClutchRatio | None:
    """Return the friction of clutch 1 over that of clutch 2, or None before both have had a shift."""
    if not all(state.shift_counts):
        return None
    known = state.known
    mean, covariance = known.mean[:FRICTION_COUNT].tolist(), known.covariance[:FRICTION_COUNT, :FRICTION_COUNT].tolist()
    (ratio_c, std_c), (ratio_s, std_s) = (_ratio(mean, covariance, one) for one in (State.MU_C1, State.MU_S1))
    return ClutchRatio(mu_c_ratio=ratio_c, mu_s_ratio=ratio_s, std_mu_c_ratio=std_c, std_mu_s_ratio=std_s)


def _ratio(mean: list[float], covariance: list[list[float]], first: int) -> tuple[float, float]:
    """Return a coefficient of clutch 1 over that of clutch 2, and its deviation."""
    second = first + 2
    ratio = mean[first] / mean[second]
    shared = covariance[first][first] - 2.0 * ratio * covariance[first][second] + ratio**2 * covariance[second][second]
    return ratio, math.sqrt(max(shared / mean[second] ** 2, 0.0) + 2.0 * (MODEL_STD_RATIO * ratio) ** 2)
