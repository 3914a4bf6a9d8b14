"""Checks of signals against each other: repeated values, jumping zeros, speeds and pressures that must agree."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.records import Reason
from diag_service.diagnosis.alignment import AlignedSignals, usable_signals
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.friction.drives import measured_drives, slip_window
from diag_service.diagnosis.friction.film import pack_laws
from diag_service.diagnosis.quality import SlippingClutch, is_frozen, plausibility_faults
from tests.support.shifts_of_a_drive import changed, first_shifts

CALIBRATION = nominal_calibration()
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


def of_shift(event: Event) -> tuple[AlignedSignals, SlippingClutch]:
    """Return the aligned signals of the shift to second gear and what is known of its clutch."""
    signals = usable_signals(event, CALIBRATION)
    assert not isinstance(signals, Reason)
    drives = measured_drives(
        signals, Posterior.fresh(CALIBRATION).known.mean, None, event.start_ns, pack_laws(CALIBRATION)
    )
    found = slip_window(signals, drives, pack_laws(CALIBRATION))
    assert found is not None
    window, clutch = found
    touch_pa = CALIBRATION.clutches[clutch - 1].touch_pressure_pa
    return signals, SlippingClutch(
        number=clutch, rows=window.slip_rows, pressure_zero_pa=0.0, touch_pressure_pa=touch_pa
    )


def faults_of(event: Event) -> tuple[Reason, ...]:
    """Return the faults of a changed shift, in the slip window of the sound one."""
    signals = usable_signals(event, CALIBRATION)
    assert not isinstance(signals, Reason)
    return plausibility_faults(event, signals, of_shift(first_shifts()[0])[1])


@pytest.mark.parametrize(
    ("signal", "change", "faults"),
    [
        (Signal.HUB_SPEED, lambda _, value: value, ()),
        (Signal.HUB_SPEED, lambda _, value: value + 2.5, (Reason.SPEEDS_DISAGREE,)),
        (Signal.HUB_SPEED, lambda t_s, value: value - 4.0 * ((t_s > 0.3) & (t_s < 0.4)), (Reason.SPEEDS_DISAGREE,)),
        (Signal.INPUT1_SPEED, lambda _, value: value + 3.0, (Reason.SPEEDS_DISAGREE,)),
        (Signal.INPUT2_SPEED, lambda _, value: value + 3.0, (Reason.SPEEDS_DISAGREE,)),
        (Signal.CLUTCH2_PRESSURE, lambda _, value: value + 0.15e5, (Reason.PRESSURE_OFF_COMMAND,)),
        (Signal.CLUTCH2_PRESSURE_COMMAND, lambda _, value: value + 0.2e5, (Reason.PRESSURE_OFF_COMMAND,)),
        (Signal.CLUTCH1_PRESSURE, lambda _, value: value + 0.15e5, ()),  # of the clutch that lets go
        (Signal.ENGINE_TORQUE, lambda t_s, value: np.where(t_s > 0.3, value[0], value), (Reason.SENSOR_FROZEN,)),
    ],
)
def test_signals_that_cannot_all_be_true(
    signal: Signal, change: Callable[[FloatArray, FloatArray], FloatArray], faults: tuple[Reason, ...]
) -> None:
    assert faults_of(changed(first_shifts()[0], signal, change)) == faults


def test_a_known_zero_is_no_fault_and_an_unknown_one_is() -> None:
    event = changed(first_shifts()[0], Signal.CLUTCH2_PRESSURE, lambda _, value: value + 0.15e5)
    signals, clutch = of_shift(event)
    assert plausibility_faults(event, signals, clutch) == (Reason.PRESSURE_OFF_COMMAND,)
    assert plausibility_faults(event, signals, replace(clutch, pressure_zero_pa=0.15e5)) == ()
