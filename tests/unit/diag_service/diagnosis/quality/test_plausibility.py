"""Checks of signals against each other: repeated values and jumping zeros."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from canlog.series import Series
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.friction import FilterState
from diag_service.diagnosis.quality.plausibility import PressureZeros, is_frozen, zero_has_jumped

COUNT = 180


def series(value: FloatArray) -> Series:
    return Series(t_ns=np.arange(len(value)) * 10_000_000, sequence=np.arange(len(value)), value=value)


def noisy(std: float, step: float, seed: int = 1, count: int = COUNT) -> FloatArray:
    """Return a ramp with noise as a bus carries it, in whole steps."""
    rng = np.random.default_rng(seed)
    value: FloatArray = step * np.rint((np.linspace(0.0, 30.0, count) + rng.normal(0.0, std, count)) / step)
    return value


def frozen(value: FloatArray, first: int, count: int) -> FloatArray:
    held = value.copy()
    held[first : first + count] = held[first]
    return held


@pytest.mark.parametrize(("std", "step"), [(3.0, 1.0), (2.0, 0.25), (0.05, 0.01), (0.5, 2.0)])
def test_sound_signals_are_not_called_frozen(std: float, step: float) -> None:
    assert not any(is_frozen(series(noisy(std, step, seed)), Signal.ENGINE_TORQUE) for seed in range(300))


@pytest.mark.parametrize(("std", "step", "least"), [(3.0, 1.0, 12), (2.0, 0.25, 10)])
def test_a_value_that_stays_is_called_frozen(std: float, step: float, least: int) -> None:
    held = [frozen(noisy(std, step, seed), 60, least) for seed in range(100)]
    assert all(is_frozen(series(value), Signal.HUB_SPEED) for value in held)


def test_a_signal_frozen_throughout_is_found() -> None:
    assert is_frozen(series(np.full(COUNT, 17.0)), Signal.HUB_SPEED)


def test_a_coarse_signal_may_repeat_itself() -> None:
    """Where steps are wide against the noise, a few equal values in a row are nothing."""
    assert not is_frozen(series(np.repeat(np.arange(30.0), 6)), Signal.ENGINE_TORQUE)


def test_a_pressure_sensor_that_cannot_show_less_than_nothing_repeats_zero() -> None:
    value = np.maximum(noisy(0.05, 0.01), 0.0)
    value[:50] = 0.0
    assert not is_frozen(series(value), Signal.CLUTCH1_PRESSURE)
    assert is_frozen(series(value), Signal.ENGINE_TORQUE)


@pytest.mark.parametrize(("moved_std", "has_jumped"), [(4.9, False), (5.1, True), (-5.1, True)])
def test_a_zero_jumps_when_it_moves_further_than_both_knowledges_allow(moved_std: float, has_jumped: bool) -> None:
    known = FilterState.fresh(nominal_calibration()).pressure_zeros
    moved_pa = np.array([0.0, moved_std * np.sqrt(0.81 * known.variance_pa2[1])])
    left = known.variance_pa2 * [1.0, 0.19]
    measured = PressureZeros(mean_pa=known.mean_pa + moved_pa, variance_pa2=left)
    assert zero_has_jumped(known, measured) is has_jumped
    assert not zero_has_jumped(known, known)
