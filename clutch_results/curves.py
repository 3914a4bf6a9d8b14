"""Friction over slip, as it is estimated and as new fluid has it."""

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import FrictionCurve
from clutch_model.pack import friction_law, stribeck_weights
from clutch_results.records import FrictionEstimate


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


CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up; of new, and of the own baseline
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
