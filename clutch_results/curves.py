"""Friction over slip, as it is estimated and as new fluid has it, and how much of its margin is left."""

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_results.records import ClutchVerdict, FrictionEstimate


def curve_band(
    slip_rad_s: FloatArray, friction: FrictionEstimate, reference: FrictionCurve
) -> tuple[FloatArray, FloatArray]:
    """Return the estimated friction coefficient over slip and its standard deviation, shape (n,) each.

    The coefficient is linear in both estimates, docs/model.md eq. (8), so their covariance carries over exactly.
    """
    weight_s = _stribeck_weights(slip_rad_s, reference)
    weight_c = 1.0 - weight_s
    variance = (
        (weight_c * friction.std_mu_c) ** 2
        + (weight_s * friction.std_mu_s) ** 2
        + 2.0 * friction.correlation * weight_c * friction.std_mu_c * weight_s * friction.std_mu_s
    )
    return weight_c * friction.mu_c + weight_s * friction.mu_s, np.sqrt(np.maximum(variance, 0.0))


def new_curve(slip_rad_s: FloatArray, reference: FrictionCurve) -> FloatArray:
    """Return the friction coefficient of new fluid over slip, shape (n,)."""
    weight_s = _stribeck_weights(slip_rad_s, reference)
    return reference.mu_c + (reference.mu_s - reference.mu_c) * weight_s


def _stribeck_weights(slip_rad_s: FloatArray, reference: FrictionCurve) -> FloatArray:
    from clutch_model.pack import friction_law, stribeck_weights  # noqa: PLC0415 - it loads numba, for this alone

    return stribeck_weights(slip_rad_s, friction_law(reference))


CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up; of new, and of the own baseline
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
CALIBRATED_RATIO = 0.7  # of what driving tells of a vehicle: from there on it is no longer said to be calibrating


def level_at(margin_ratio: float) -> float:
    """Return the level of mu_C that counts as much as a margin: both are 1 of new fluid, and have the same limits."""
    return CHANGE_LEVEL_RATIO + margin_ratio * (1.0 - CHANGE_LEVEL_RATIO)


def margin_left(verdict: ClutchVerdict, new: FrictionCurve) -> tuple[float, float]:
    """Return which part of its friction margin a clutch has left, and the standard deviation; NaN while unknown.

    It is 1 of new fluid, `WATCH_MARGIN_RATIO` at the limit of watch, 0 at that of a change: the margin against shudder,
    or the level of mu_C against new or its own baseline, whichever has less left.
    """
    friction, slope, trend = verdict.friction, verdict.slope, verdict.trend
    if friction is None:
        fresh = 1.0 - new.mu_s / new.mu_c
        return (np.nan, np.nan) if slope is None else ((1.0 - slope.mu_s_ratio) / fresh, slope.std_mu_s_ratio / fresh)
    fresh = new.mu_c - new.mu_s
    levels = [(friction.mu_c / new.mu_c, friction.std_mu_c / new.mu_c)]
    levels += [] if trend is None else [(1.0 + trend.change_mu_c_ratio, trend.std_change_mu_c_ratio)]
    span = 1.0 - CHANGE_LEVEL_RATIO
    left = [((level - CHANGE_LEVEL_RATIO) / span, std / span) for level, std in levels]
    margin = (friction.mu_c - friction.mu_s) / fresh, friction.std_slope_s_rad * new.stribeck_speed_rad_s / fresh
    return min(margin, *left)
