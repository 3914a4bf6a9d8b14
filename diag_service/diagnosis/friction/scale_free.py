"""What a running state tells without knowing the common scale; docs/model.md, section "Estimator", eqs. (34) to (37).

What a vehicle shows while it drives is how much torque it reads for how much pressure: friction times the gain of the
torque reading times the piston area. Where two such numbers are divided by each other, or one by what it was before,
the gain is gone, and in one clutch the area too.
"""

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.filter_state import FilterState
from diag_service.diagnosis.friction.parameters import FRICTION_COUNT, Considered, friction_rows
from diag_service.diagnosis.records import ClutchRatio, FrictionTrend, ScaleFreeFriction

PISTON_AREAS = (Considered.PISTON_AREA1, Considered.PISTON_AREA2)


def scale_free(state: FilterState, clutch: int) -> ScaleFreeFriction:
    """Return the friction of clutch 1 or 2 times the true gain of the torque reading and the true piston area.

    The area counts as a ratio to what the calibration says. The gain has a part in the stated deviation only where it
    multiplies a mass, the inertia torque of the engine; the area only where it is not the lever of the friction.
    """
    rows = friction_rows(clutch)
    mu_c, mu_s = state.mean[rows].tolist()
    sensitivity = state.sensitivity[rows].copy()
    sensitivity[:, PISTON_AREAS[clutch - 1]] -= state.mean[rows]
    covariance = state.covariance[rows, rows] + sensitivity @ state.considered @ sensitivity.T
    std = np.sqrt(np.diag(covariance))
    return ScaleFreeFriction(
        mu_c=mu_c,
        mu_s=mu_s,
        std_mu_c=float(std[0]),
        std_mu_s=float(std[1]),
        correlation=float(covariance[0, 1] / (std[0] * std[1])),
    )


def common_scale_std_ratio(state: FilterState, clutch: int) -> float:
    """Return the relative deviation of gain times piston area: what all friction of clutch 1 or 2 shares, for good."""
    rows = [Considered.TORQUE_GAIN, PISTON_AREAS[clutch - 1]]
    by_part = np.array([1.0 / state.torque_gain, 1.0])
    return float(np.sqrt(by_part @ state.considered[np.ix_(rows, rows)] @ by_part))


def trend(state: FilterState, clutch: int) -> FrictionTrend | None:
    """Return what became of the friction of clutch 1 or 2 since its baseline, or None before there is one.

    The deviation is that of the difference: errors which both have are not in it.
    """
    baseline = state.baselines[clutch - 1]
    if baseline is None or not baseline.later_count:
        return None
    rows = friction_rows(clutch)
    now, then = state.mean[rows], baseline.mean
    random = state.covariance[rows, rows], baseline.covariance, baseline.cross[rows]
    sensitivity = state.sensitivity[rows], baseline.sensitivity
    change, ratio = (now - then) / state.torque_gain, now / then - 1.0
    by_gain = np.zeros((2, len(Considered)))
    by_gain[:, Considered.TORQUE_GAIN] = change  # no scale, no change
    unit = np.ones(2)
    std = _std_of_difference(unit, unit, random, sensitivity, state.considered, by_gain) / state.torque_gain
    relative_std = _std_of_difference(1.0 / then, now / then**2, random, sensitivity, state.considered)
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
        later_shift_count=baseline.later_count,
    )


def _std_of_difference(
    by_now: FloatArray,
    by_then: FloatArray,
    random: tuple[FloatArray, FloatArray, FloatArray],
    sensitivity: tuple[FloatArray, FloatArray],
    considered: FloatArray,
    common: FloatArray | float = 0.0,
) -> FloatArray:
    """Return the deviation of ``by_now * now - by_then * then``, shape (2,).

    ``random`` holds the covariance of now, of then, and between the two; ``common`` is a further dependence on the
    considered parameters.
    """
    now, then, cross = (np.diag(one) for one in random)
    variance = by_now**2 * now + by_then**2 * then - 2.0 * by_now * by_then * cross
    part = by_now[:, None] * sensitivity[0] - by_then[:, None] * sensitivity[1] + common
    return np.asarray(np.sqrt(np.maximum(variance + np.einsum("ij,jk,ik->i", part, considered, part), 0.0)))


def clutch_ratio(state: FilterState) -> ClutchRatio | None:
    """Return the friction of clutch 1 over that of clutch 2, or None before both have had a shift."""
    if not all(state.shift_counts):
        return None
    first, second = state.mean[friction_rows(1)], state.mean[friction_rows(2)]
    by_state = np.hstack((np.diag(1.0 / second), np.diag(-first / second**2)))
    covariance = by_state @ state.total_covariance(slice(FRICTION_COUNT)) @ by_state.T
    ratio, std = first / second, np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return ClutchRatio(
        mu_c_ratio=float(ratio[0]),
        mu_s_ratio=float(ratio[1]),
        std_mu_c_ratio=float(std[0]),
        std_mu_s_ratio=float(std[1]),
    )
