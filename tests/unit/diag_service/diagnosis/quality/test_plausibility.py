"""Checks of signals against each other: repeated values, jumping zeros, speeds and pressures that must agree."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.alignment import AlignedSignals
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.friction.drives import measured_drives, slip_window
from diag_service.diagnosis.friction.evidence import State
from diag_service.diagnosis.friction.film import pack_laws
from diag_service.diagnosis.quality.data_quality import LIMITS, QualityLimits, usable_signals
from diag_service.diagnosis.quality.plausibility import (
    PressureZeros,
    SlippingClutch,
    geared_stretches,
    is_frozen,
    plausibility_faults,
    shaft_gap_rad_s,
    zero_has_jumped,
)
from diag_service.diagnosis.records import Reason
from tests.unit.diag_service.diagnosis.shifts_of_a_drive import changed, first_shifts

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


def test_a_signal_without_noise_may_rest() -> None:
    """An idle torque, then a smooth rise: on a sound sensor without noise a rest says nothing."""
    rising = np.rint(np.linspace(0.0, 70.0, COUNT - 60) ** 1.2)
    assert not is_frozen(series(np.concatenate((np.full(60, 17.0), 17.0 + rising))), Signal.ENGINE_TORQUE)


def test_a_pressure_sensor_that_cannot_show_less_than_nothing_repeats_zero() -> None:
    value = np.maximum(noisy(0.05, 0.01), 0.0)
    value[:50] = 0.0
    assert not is_frozen(series(value), Signal.CLUTCH1_PRESSURE)
    assert is_frozen(series(value), Signal.ENGINE_TORQUE)


@pytest.mark.parametrize(("moved_std", "has_jumped"), [(4.9, False), (5.1, True), (-5.1, True)])
def test_a_zero_jumps_when_it_moves_further_than_both_knowledges_allow(moved_std: float, has_jumped: bool) -> None:
    fresh = Posterior.fresh(CALIBRATION).known
    zeros = slice(State.ZERO1, State.ZERO2 + 1)
    known = PressureZeros(mean_pa=fresh.mean[zeros], variance_pa2=np.diag(fresh.covariance)[zeros])
    moved_pa = np.array([0.0, moved_std * np.sqrt(0.81 * known.variance_pa2[1])])
    left = known.variance_pa2 * [1.0, 0.19]
    measured = PressureZeros(mean_pa=known.mean_pa + moved_pa, variance_pa2=left)
    assert zero_has_jumped(known, measured) is has_jumped
    assert not zero_has_jumped(known, known)


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


def faults_of(event: Event, limits: QualityLimits = LIMITS) -> tuple[Reason, ...]:
    """Return the faults of a changed shift, in the slip window of the sound one."""
    signals = usable_signals(event, CALIBRATION)
    assert not isinstance(signals, Reason)
    return plausibility_faults(event, signals, of_shift(first_shifts()[0])[1], limits)


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


@pytest.mark.parametrize("late_s", [-0.02, 0.02])
def test_the_command_has_a_clock_of_its_own(late_s: float) -> None:
    """Speeds that come later than commands are not held against the pressures."""
    event = first_shifts()[0]
    command = event.columns[Signal.CLUTCH2_PRESSURE_COMMAND]
    other = event.columns[Signal.CLUTCH1_PRESSURE_COMMAND]
    moved = {
        Signal.CLUTCH2_PRESSURE_COMMAND: replace(command, t_ns=command.t_ns + round(late_s * 1e9)),
        Signal.CLUTCH1_PRESSURE_COMMAND: replace(other, t_ns=other.t_ns + round(late_s * 1e9)),
    }
    assert faults_of(replace(event, columns={**event.columns, **moved})) == ()


def with_shaft_gears(event: Event, *, second_from_ns: int) -> Event:
    """Return an event in which shaft 2 has 2nd gear from a time on, 4th before; shaft 1 stays in 1st."""
    t_ns = np.arange(event.start_ns - 500_000_000, event.end_ns, 20_000_000)
    rows = np.arange(len(t_ns))
    second = np.where(t_ns < second_from_ns, 4.0, 2.0)
    gears = {
        Signal.INPUT1_GEAR: Series(t_ns=t_ns, sequence=rows, value=np.ones(len(t_ns))),
        Signal.INPUT2_GEAR: Series(t_ns=t_ns, sequence=rows, value=second),
    }
    return replace(event, columns={**event.columns, **gears})


def with_second_shaft_slower(event: Event, until_ns: int, ratio: float) -> Event:
    """Return an event whose second input shaft turns slower up to a time, as in a higher gear."""
    speed = event.columns[Signal.INPUT2_SPEED]
    value = np.where(speed.t_ns < until_ns, ratio * speed.value, speed.value)
    return replace(event, columns={**event.columns, Signal.INPUT2_SPEED: replace(speed, value=value)})


def test_a_shaft_may_change_its_gear_inside_an_event() -> None:
    """Held against the other shaft up to the ratio of the gear that it has: a new gear is no fault, a jump is one."""
    event = first_shifts()[0]
    half_ns = (event.start_ns + event.end_ns) // 2
    regeared = with_second_shaft_slower(event, half_ns, 0.6)
    grid_s = np.arange(0.0, (event.end_ns - event.start_ns) * 1e-9, 1e-3)
    clutch = SlippingClutch(number=2, rows=slice(0, len(grid_s)), pressure_zero_pa=0.0, touch_pressure_pa=0.0)
    gaps = []
    for told in (with_shaft_gears(regeared, second_from_ns=half_ns), with_shaft_gears(regeared, second_from_ns=0)):
        signals = usable_signals(told, CALIBRATION)
        assert isinstance(signals, AlignedSignals)
        gaps.append([shaft_gap_rad_s(signals, rows) for rows in geared_stretches(told, signals.grid_s, clutch)])
    assert [len(one) for one in gaps] == [2, 1]
    assert max(gaps[0]) < LIMITS.speeds_rad_s < max(gaps[1])
