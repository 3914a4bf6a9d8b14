"""Friction values: coefficients, their curve, what can be said without the common scale, calibration progress.

What a vehicle shows while it drives is how much torque it reads for how much pressure: friction times the gain of the
torque reading times the piston area. Where two such numbers are divided by each other, or one by what it was before,
the gain is gone, and in one clutch the area too.
"""

import math
from statistics import NormalDist
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.clutch import FrictionCurve
from clutch_model.friction import friction_law, stribeck_weights
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    STATE_COUNT,
    Considered,
    Knowledge,
    State,
    friction_rows,
    type_std,
)
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.records import ClutchRatio, FrictionEstimate, FrictionTrend, ScaleFreeFriction

MODEL_STD_RATIO = 0.004  # by which a real clutch differs from the law alike in all events: they do not average it out
_GAIN = STATE_COUNT + Considered.TORQUE_GAIN
_WIDTH = STATE_COUNT + Considered.STRIBECK_SPEED
_AREAS = (STATE_COUNT + Considered.PISTON_AREA1, STATE_COUNT + Considered.PISTON_AREA2)
_FRICTION_AND_GAIN = np.ix_([*range(FRICTION_COUNT), _GAIN], [*range(FRICTION_COUNT), _GAIN])  # of a covariance


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
    return _with_scale(state, clutch, _without_scale(state, clutch))


def both_frictions(state: Posterior, clutch: int) -> tuple[FrictionEstimate, ScaleFreeFriction]:
    """Return the friction of clutch 1 or 2 as now estimated, and what `scale_free` says of it."""
    free = _without_scale(state, clutch)
    return _with_scale(state, clutch, free), _scale_free(free)


def _with_scale(state: Posterior, clutch: int, free: _Pair) -> FrictionEstimate:
    known, gain = state.known, state.torque_gain + float(state.known.mean[_GAIN])
    pair = _Pair.of(known, clutch, _GAIN, 1.0 / gain, -1.0 / gain**2)
    width = state.stribeck_speed_rad_s[clutch - 1] * (1.0 + float(known.mean[_WIDTH]))
    difference = NormalDist(pair.mu_c - pair.mu_s, math.sqrt(pair.variance_c + pair.variance_s - 2.0 * pair.covariance))
    return FrictionEstimate(
        mu_c=pair.mu_c,
        mu_s=pair.mu_s,
        std_mu_c=math.sqrt(pair.variance_c),
        std_mu_s=math.sqrt(pair.variance_s),
        correlation=pair.correlation,
        random_std_mu_c=pair.mu_c * math.sqrt(free.variance_c) / free.mu_c,
        random_std_mu_s=pair.mu_s * math.sqrt(free.variance_s) / free.mu_s,
        slope_s_rad=difference.mean / width,
        std_slope_s_rad=difference.stdev / width,
        probability_negative_slope=difference.cdf(0.0),
    )


def scale_free(state: Posterior, clutch: int) -> ScaleFreeFriction:
    """Return the friction of clutch 1 or 2 times the true gain of the torque reading and the true piston area.

    The area counts as a ratio to what the calibration says.
    """
    return _scale_free(_without_scale(state, clutch))


def _scale_free(pair: _Pair) -> ScaleFreeFriction:
    return ScaleFreeFriction(
        mu_c=pair.mu_c,
        mu_s=pair.mu_s,
        std_mu_c=math.sqrt(pair.variance_c),
        std_mu_s=math.sqrt(pair.variance_s),
        correlation=pair.correlation,
    )


def _without_scale(state: Posterior, clutch: int) -> _Pair:
    area = _AREAS[clutch - 1]
    return _Pair.of(state.known, clutch, area, 1.0 + float(state.known.mean[area]), 1.0)


def common_margin(state: Posterior, new_margins: tuple[float, float]) -> NormalDist:
    """Return which part of ``mu_C - mu_S`` of new fluid is left if both clutches, which slip in one oil, lost the same.

    ``new_margins`` are those of new fluid. The better known clutch weighs more, by its variance; what both share is in
    the deviation.
    """
    known, gain = state.known, state.torque_gain + float(state.known.mean[_GAIN])
    c_1, s_1, c_2, s_2 = known.mean[:FRICTION_COUNT].tolist()
    by_1, by_2 = (1.0 / (gain * new_margin) for new_margin in new_margins)
    left_1, left_2 = by_1 * (c_1 - s_1), by_2 * (c_2 - s_2)
    slope = np.array([[by_1, -by_1, 0.0, 0.0, -left_1 / gain], [0.0, 0.0, by_2, -by_2, -left_2 / gain]])
    (first, both), (_, second) = (slope @ known.covariance[_FRICTION_AND_GAIN] @ slope.T).tolist()
    first += (MODEL_STD_RATIO * by_1 * math.hypot(c_1, s_1)) ** 2
    second += (MODEL_STD_RATIO * by_2 * math.hypot(c_2, s_2)) ** 2
    weight_1, weight_2 = second / (first + second), first / (first + second)
    variance = weight_1**2 * first + 2.0 * weight_1 * weight_2 * both + weight_2**2 * second
    return NormalDist(weight_1 * left_1 + weight_2 * left_2, math.sqrt(variance))


def common_scale_std_ratio(state: Posterior, clutch: int) -> float:
    """Return the relative deviation of gain times piston area: what all friction of clutch 1 or 2 shares, for good."""
    mean, covariance, area = state.known.mean, state.known.covariance, _AREAS[clutch - 1]
    by_gain, by_area = 1.0 / (state.torque_gain + float(mean[_GAIN])), 1.0 / (1.0 + float(mean[area]))
    gain, both, own = float(covariance[_GAIN, _GAIN]), float(covariance[_GAIN, area]), float(covariance[area, area])
    return math.sqrt(by_gain**2 * gain + 2.0 * by_gain * by_area * both + by_area**2 * own)


def trend(state: Posterior, clutch: int) -> FrictionTrend | None:
    """Return what became of the friction of clutch 1 or 2 since its baseline, or None before there is one.

    The deviation is that of the difference: errors which both have are not in it.
    """
    baseline, later_count = state.baselines[clutch - 1], state.later_count(clutch)
    if baseline is None or later_count <= 0:
        return None
    known, rows = state.known, friction_rows(clutch)
    gain = state.torque_gain + float(known.mean[_GAIN])
    now, then = known.mean[rows].tolist(), baseline.mean.tolist()
    spread = known.covariance[rows, rows], baseline.covariance, state.cross(clutch)[rows]
    mu_c, mu_s = map(_Change.of, now, then, zip(*(one.diagonal().tolist() for one in spread), strict=True))
    return FrictionTrend(
        change_mu_c=mu_c.difference / gain,
        change_mu_s=mu_s.difference / gain,
        std_change_mu_c=mu_c.std / gain,
        std_change_mu_s=mu_s.std / gain,
        change_mu_c_ratio=mu_c.ratio,
        change_mu_s_ratio=mu_s.ratio,
        std_change_mu_c_ratio=mu_c.std_ratio,
        std_change_mu_s_ratio=mu_s.std_ratio,
        baseline_end_bus_ns=baseline.end_ns,
        baseline_shift_count=baseline.shift_count,
        later_shift_count=later_count,
    )


class _Change(NamedTuple):
    """What became of one coefficient, times a factor."""

    difference: float
    std: float
    ratio: float
    std_ratio: float

    @classmethod
    def of(cls, now: float, then: float, spread: tuple[float, float, float]) -> Self:
        """Return it, by the variances of both values and their covariance."""
        return cls(
            difference=now - then,
            std=_std_of_difference(1.0, 1.0, spread),
            ratio=now / then - 1.0,
            std_ratio=_std_of_difference(1.0 / then, now / then**2, spread),
        )


def _std_of_difference(by_now: float, by_then: float, spread: tuple[float, float, float]) -> float:
    """Return the deviation of ``by_now * now - by_then * then``, by the variances of both and their covariance."""
    now, then, both = spread
    return math.sqrt(max(by_now**2 * now + by_then**2 * then - 2.0 * by_now * by_then * both, 0.0))


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


def curve_band(
    slip_rad_s: FloatArray, friction: FrictionEstimate, reference: FrictionCurve
) -> tuple[FloatArray, FloatArray]:
    """Return the estimated friction coefficient over slip and its standard deviation, shape (n,) each.

    The coefficient is linear in both estimates, docs/model.md eq. (8), so their covariance carries over exactly.
    """
    weight_s = stribeck_weights(slip_rad_s, friction_law(reference))
    weight_c = 1.0 - weight_s
    variance = (
        (weight_c * friction.std_mu_c) ** 2
        + (weight_s * friction.std_mu_s) ** 2
        + 2.0 * friction.correlation * weight_c * friction.std_mu_c * weight_s * friction.std_mu_s
    )
    return weight_c * friction.mu_c + weight_s * friction.mu_s, np.sqrt(np.maximum(variance, 0.0))


def new_curve(slip_rad_s: FloatArray, reference: FrictionCurve) -> FloatArray:
    """Return the friction coefficient of new fluid over slip, shape (n,)."""
    weight_s = stribeck_weights(slip_rad_s, friction_law(reference))
    return reference.mu_c + (reference.mu_s - reference.mu_c) * weight_s


_LEARNT: Final = np.array((
    State.TORQUE_OFFSET,
    State.TOUCH1,
    State.TOUCH2,
    State.ZERO1,
    State.ZERO2,
    STATE_COUNT + Considered.VISCOSITY,
    STATE_COUNT + Considered.TORQUE_LATENCY,
    STATE_COUNT + Considered.PRESSURE_LATENCY,
))  # fmt: skip
"""What ordinary shifts tell; gain of torque and piston areas they do not."""
_AMONG_NUISANCES: Final = (_LEARNT - FRICTION_COUNT).tolist()


def calibration_ratio(state: Posterior, calibration: Calibration) -> float:
    """Return by how much the deviations of sensors, oil and latencies have shrunk from those of the type, 0 to 1."""
    variances, stds = state.known.covariance[_LEARNT, _LEARNT].tolist(), type_std(calibration)
    of_type = [stds[row] for row in _AMONG_NUISANCES]
    left = [math.sqrt(now) / std if std else 0.0 for now, std in zip(variances, of_type, strict=True)]
    return sum(1.0 - min(one, 1.0) for one in left) / len(left)
