"""Locked clutches are found by what they carry."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.full_estimator import FullSignals
from benchmarks.full_estimator.locks import lasting_least, locked_clutches, moving_mean
from benchmarks.full_estimator.torques import ClutchState
from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration

COUNT = 1000
CLUTCHES = nominal_calibration().clutches
PRESSED_PA = 5.0e5  # clutch 1 slips at 154 N m or more, clutch 2 at 116


def signals(pressure_pa: FloatArray, gears: tuple[int, int] = (3, 2)) -> FullSignals:
    """Return signals of which only the pressures matter."""
    quiet = np.zeros(COUNT)
    return FullSignals(
        period_s=1e-3,
        hub_rad_s=quiet,
        input_rad_s=np.zeros((2, COUNT)),
        pressure_pa=pressure_pa,
        flywheel_nm=quiet,
        shaft_nm=np.zeros((2, COUNT)),
        oil_k=np.full(COUNT, 360.0),
        gears=np.tile(np.array(gears)[:, None], COUNT),
        speed_std_rad_s=np.full(3, 20.0),
        pressure_std_pa=np.full(2, 2.0e4),
    )


def state(torque_nm: FloatArray, slip_rad_s: float = 0.1) -> ClutchState:
    """Return a clutch that carries this torque."""
    return ClutchState(
        torque_nm=torque_nm,
        slip_rad_s=np.full(COUNT, slip_rad_s),
        slip_std_rad_s=np.full(COUNT, 0.5),
        viscosity=np.full(COUNT, 6.4e-3),
    )


@pytest.fixture(name="noisy_pa")
def make_noisy_pa() -> FloatArray:
    """Both clutches pressed alike, as the paper's sensors show it."""
    return PRESSED_PA + 2.0e4 * np.random.default_rng(1).standard_normal((2, COUNT))


def test_a_clutch_that_carries_little_for_its_pressure_is_locked(noisy_pa: FloatArray) -> None:
    little, full = np.full(COUNT, 60.0), np.full(COUNT, 116.0)
    locked = locked_clutches(signals(noisy_pa), (state(little), state(full)), CLUTCHES)
    assert locked[0].all()
    assert not locked[1].any()
    backwards = locked_clutches(signals(noisy_pa), (state(-little), state(-full)), CLUTCHES)
    assert np.array_equal(locked, backwards)


def test_a_moment_of_slipping_unlocks_its_surroundings(noisy_pa: FloatArray) -> None:
    torque_nm = np.full(COUNT, 60.0)
    torque_nm[500] = 150.0
    locked = locked_clutches(signals(noisy_pa), (state(torque_nm), state(torque_nm)), CLUTCHES)[0]
    assert not locked[470:531].any()
    assert locked[:469].all()


def test_neither_a_fast_nor_a_light_nor_a_geared_out_clutch_is_locked(noisy_pa: FloatArray) -> None:
    little = state(np.full(COUNT, 60.0))
    fast = replace(little, slip_rad_s=np.full(COUNT, 8.0))
    assert not locked_clutches(signals(noisy_pa), (fast, fast), CLUTCHES).any()
    assert not locked_clutches(signals(noisy_pa - 3.4e5), (little, little), CLUTCHES).any()
    assert not locked_clutches(signals(noisy_pa, gears=(0, 2)), (little, little), CLUTCHES)[0].any()


def test_means_and_leasts_narrow_at_the_ends() -> None:
    values = np.array([3.0, 1.0, 2.0, 6.0])
    assert moving_mean(values, 1) == pytest.approx([2.0, 2.0, 3.0, 4.0])
    assert lasting_least(values, 1) == pytest.approx([1.0, 1.0, 1.0, 2.0])
