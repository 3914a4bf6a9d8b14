"""Where a clutch is locked: for a while it has carried clearly less than the torque at which it would slip."""

import numpy as np

from studies.full_estimator.signals import BoolArray, FullSignals
from studies.full_estimator.torques import ClutchState
from canlog.arrays import FloatArray
from clutch_model.calibration import ClutchCalibration
from clutch_model.pack import applied_pressure_pa, contact_torques_nm, film_law

LOAD_RATIO = 0.85  # of the least torque at which the clutch would slip
FRICTION_RATIO = 0.85  # of the calibrated friction: lower it may have fallen, then fewer samples count as locked
MEAN_S = 0.03  # over which the noise of the pressure is averaged; also several film times
PERSISTENCE_S = 0.03  # on either side of a sample
APPLIED_MIN_PA = 4.0e4  # below, the noise left is no longer small against it
SLIP_MAX_RAD_S = 0.3
SLIP_MAX_STD = 4.0


def locked_clutches(
    signals: FullSignals, states: tuple[ClutchState, ClutchState], clutches: tuple[ClutchCalibration, ClutchCalibration]
) -> BoolArray:
    """Return where each clutch is locked beyond doubt, shape (2, n): a little less than where it is."""
    first, second = (
        (signals.gears[m] > 0) & _locked(signals.pressure_pa[m], states[m], clutches[m], signals.period_s)
        for m in range(len(clutches))
    )
    return np.stack((first, second))


def _locked(pressure_pa: FloatArray, state: ClutchState, clutch: ClutchCalibration, period_s: float) -> BoolArray:
    width = max(1, round(MEAN_S / period_s))
    law = film_law(clutch)
    mean_pa = moving_mean(pressure_pa, width)
    applied_pa = lasting_least(np.array([applied_pressure_pa(one, law) for one in mean_pa]), width)
    friction = FRICTION_RATIO * min(clutch.friction.mu_c, clutch.friction.mu_s)
    slipping_nm = contact_torques_nm(np.ones_like(applied_pa), friction, applied_pa, law.contact_factor_m3)
    is_slow = np.abs(state.slip_rad_s) < SLIP_MAX_RAD_S + SLIP_MAX_STD * state.slip_std_rad_s
    is_held = (applied_pa > APPLIED_MIN_PA) & (np.abs(state.torque_nm) < LOAD_RATIO * slipping_nm) & is_slow
    locked: BoolArray = lasting_least(is_held.astype(np.float64), round(PERSISTENCE_S / period_s)) > 0.5
    return locked


def moving_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean over ``width`` samples on either side, fewer at the ends, shape (n,)."""
    sums = np.concatenate(((0.0,), np.cumsum(values)))
    index = np.arange(len(values))
    first, stop = np.maximum(index - width, 0), np.minimum(index + width + 1, len(values))
    mean: FloatArray = (sums[stop] - sums[first]) / (stop - first)
    return mean


def lasting_least(values: FloatArray, width: int) -> FloatArray:
    """Return the least value within ``width`` samples on either side, shape (n,)."""
    padded = np.pad(values, width, mode="edge")
    least: FloatArray = np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1).min(axis=1)
    return least
