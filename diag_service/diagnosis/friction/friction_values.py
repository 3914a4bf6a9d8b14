"""Friction coefficients and what can be said of them without the common scale; docs/model.md eqs. (34) to (37).

What a vehicle shows while it drives is how much torque it reads for how much pressure: friction times the gain of the
torque reading times the piston area. Where two such numbers are divided by each other, or one by what it was before,
the gain is gone, and in one clutch the area too.
"""

from statistics import NormalDist

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.evidence import Knowledge
from diag_service.diagnosis.friction.parameters import (
    FRICTION_COUNT,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    friction_rows,
)
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.records import ClutchRatio, FrictionEstimate, FrictionTrend, ScaleFreeFriction

MODEL_STD_RATIO = 0.004  # by which a real clutch differs from the law alike in all events: they do not average it out
_GAIN = STATE_COUNT + Considered.TORQUE_GAIN
_WIDTH = STATE_COUNT + Considered.STRIBECK_SPEED
_AREAS = (STATE_COUNT + Considered.PISTON_AREA1, STATE_COUNT + Considered.PISTON_AREA2)


def friction(state: Posterior, clutch: int) -> FrictionEstimate:
    """Return the friction of clutch 1 or 2 as now estimated."""
    known, gain = state.known, state.torque_gain + state.known.mean[_GAIN]
    mu = known.mean[friction_rows(clutch)] / gain
    total = _covariance(known, clutch, _GAIN, 1.0 / gain, -mu / gain) + np.diag((MODEL_STD_RATIO * mu) ** 2)
    std, free = np.sqrt(total.diagonal()), scale_free(state, clutch)
    width = state.stribeck_speed_rad_s[clutch - 1] * (1.0 + float(known.mean[_WIDTH]))
    std_difference = float(np.sqrt(total[0, 0] + total[1, 1] - 2.0 * total[0, 1]))
    mu_c, mu_s = mu.tolist()
    return FrictionEstimate(
        mu_c=mu_c,
        mu_s=mu_s,
        std_mu_c=float(std[0]),
        std_mu_s=float(std[1]),
        correlation=float(total[0, 1] / (std[0] * std[1])),
        random_std_mu_c=mu_c * free.std_mu_c / free.mu_c,
        random_std_mu_s=mu_s * free.std_mu_s / free.mu_s,
        slope_s_rad=(mu_c - mu_s) / width,
        std_slope_s_rad=std_difference / width,
        probability_negative_slope=NormalDist(mu_c - mu_s, std_difference).cdf(0.0),
    )


def scale_free(state: Posterior, clutch: int) -> ScaleFreeFriction:
    """Return the friction of clutch 1 or 2 times the true gain of the torque reading and the true piston area.

    The area counts as a ratio to what the calibration says.
    """
    known, own, area = state.known, state.known.mean[friction_rows(clutch)], _AREAS[clutch - 1]
    area_ratio = 1.0 + known.mean[area]
    mu = own * area_ratio
    covariance = _covariance(known, clutch, area, area_ratio, own) + np.diag((MODEL_STD_RATIO * mu) ** 2)
    std = np.sqrt(covariance.diagonal())
    return ScaleFreeFriction(
        mu_c=float(mu[0]),
        mu_s=float(mu[1]),
        std_mu_c=float(std[0]),
        std_mu_s=float(std[1]),
        correlation=float(covariance[0, 1] / (std[0] * std[1])),
    )


def _covariance(known: Knowledge, clutch: int, scale: int, by_friction: float, by_scale: FloatArray) -> FloatArray:
    """Return the covariance of both coefficients of a clutch, shape (2, 2), by their slopes.

    ``by_friction`` is the slope over each coefficient itself, ``by_scale`` those over the parameter that scales both,
    shape (2,).
    """
    rows = friction_rows(clutch)
    own, shared = known.covariance[rows, rows], np.outer(by_friction * known.covariance[rows, scale], by_scale)
    scales = known.covariance[scale, scale] * np.outer(by_scale, by_scale)
    return np.asarray(by_friction**2 * own + shared + shared.T + scales)


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
    first, second = known.mean[friction_rows(1)], known.mean[friction_rows(2)]
    by_state = np.hstack((np.diag(1.0 / second), np.diag(-first / second**2)))
    covariance = by_state @ known.covariance[:FRICTION_COUNT, :FRICTION_COUNT] @ by_state.T
    ratio = first / second
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0) + 2.0 * (MODEL_STD_RATIO * ratio) ** 2)
    return ClutchRatio(
        mu_c_ratio=float(ratio[0]),
        mu_s_ratio=float(ratio[1]),
        std_mu_c_ratio=float(std[0]),
        std_mu_s_ratio=float(std[1]),
    )
