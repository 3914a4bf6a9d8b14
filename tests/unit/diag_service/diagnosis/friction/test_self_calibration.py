"""What a vehicle says about itself: derivatives, refusals, and the answer where the truth is known."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.records import Reason
from dbc.contract import load_contract
from diag_service.diagnosis.alignment import Resampled, usable_signals
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.balance import Balance, measurements_of, noise_of
from diag_service.diagnosis.friction.drives import SlipWindow, measured_drives, slip_window
from diag_service.diagnosis.friction.evidence import STATE_COUNT, Considered, Measurement, State
from diag_service.diagnosis.friction.film import VehicleLaws
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.self_calibration import SelfCalibration, self_calibrate
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario import Scenario, Truth, WorkshopRoutine
from studies.builders import to_batch
from tests.support.builders import drive_scenario

NOMINAL = nominal_calibration()
TORQUE_LATENCY_S, PRESSURE_LATENCY_S, SPEED_LATENCY_S = 0.023, 0.011, 0.004
GAIN, OFFSET_NM, INERTIA = 1.03, -6.0, 0.96
SPEEDS = ("engine_speed_rad_s", "hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s")

AS_DRIVEN = Posterior.fresh(NOMINAL).known.mean.copy()
"""Parameters of the emulated vehicle, whose readings are not late."""
AS_DRIVEN[STATE_COUNT + Considered.TORQUE_LATENCY] = -NOMINAL.bias.torque_latency_s
AS_DRIVEN[STATE_COUNT + Considered.PRESSURE_LATENCY] = -NOMINAL.bias.pressure_latency_s


def seen(scenario: Scenario) -> tuple[tuple[Event, ...], tuple[Event, ...]]:
    frames, _ = frames_of(scenario)
    decoder, shift_finder, run_up_finder = (
        Decoder(load_contract(), load_profile()),
        ShiftFinder(),
        RunUpFinder(NOMINAL),
    )
    shifts: list[Event] = []
    run_ups: list[Event] = []
    for columns in decoder.feed(to_batch(frames)):
        shifts += shift_finder.feed(columns)
        run_ups += run_up_finder.feed(columns)
    return tuple(shifts + shift_finder.flush()), tuple(run_ups + run_up_finder.flush())


@lru_cache
def unlike_its_type() -> tuple[tuple[Event, ...], tuple[Event, ...]]:
    """Return shifts and run-ups of a vehicle that is not what its type promises."""
    base = drive_scenario(seed=4, cycles=2)
    sensors = {
        name: replace(sensor, latency_s=SPEED_LATENCY_S) if name in SPEEDS else sensor
        for name, sensor in base.sensors.items()
    }
    torque = sensors["engine_torque_nm"]
    sensors["engine_torque_nm"] = replace(torque, gain_ratio=GAIN, offset=OFFSET_NM, latency_s=TORQUE_LATENCY_S)
    for name in ("clutch1_pressure_pa", "clutch2_pressure_pa"):
        sensors[name] = replace(sensors[name], latency_s=PRESSURE_LATENCY_S)
    inertia_kg_m2 = INERTIA * NOMINAL.input_side.engine_inertia_kg_m2
    truth = Truth(calibration={"input_side.engine_inertia_kg_m2": inertia_kg_m2})
    return seen(replace(base, sensors=sensors, truth=truth, routine=WorkshopRoutine(open_revs=4, closed_revs=4)))


def found(shifts: Sequence[Event], run_ups: Sequence[Event]) -> SelfCalibration:
    result = self_calibrate(shifts, run_ups, NOMINAL, "test")
    assert isinstance(result, SelfCalibration), result
    return result


@lru_cache
def calibrated() -> SelfCalibration:
    """Return what that vehicle says of itself."""
    return found(*unlike_its_type())


def test_driving_tells_latencies_offset_and_inertia_over_gain() -> None:
    shifts, _ = unlike_its_type()
    result = found(shifts, ())
    bias = result.calibration.bias
    product = bias.torque_gain * result.calibration.input_side.engine_inertia_kg_m2
    assert bias.torque_latency_s == pytest.approx(TORQUE_LATENCY_S - SPEED_LATENCY_S, abs=0.004)
    assert bias.pressure_latency_s == pytest.approx(PRESSURE_LATENCY_S - SPEED_LATENCY_S, abs=0.004)
    assert bias.torque_offset_nm == pytest.approx(OFFSET_NM, abs=2.0)
    assert product == pytest.approx(GAIN * INERTIA * NOMINAL.input_side.engine_inertia_kg_m2, rel=0.05)
    assert result.shift_counts == (10, 10)
    assert result.std("torque_gain") > 0.015  # driving does not tell it


def test_revs_with_open_and_closed_clutches_tell_the_gain() -> None:
    result = calibrated()
    assert result.run_up_counts == (4, 4)
    assert result.std("torque_gain") < 0.015
    assert result.calibration.bias.torque_gain == pytest.approx(GAIN, abs=4.0 * result.std("torque_gain"))
    for clutch in (1, 2):
        friction = friction_of(result.state, clutch)
        assert friction.mu_c == pytest.approx(0.140, abs=4.0 * friction.std_mu_c)
        assert friction.mu_s == pytest.approx(0.119, abs=4.0 * friction.std_mu_s)


def test_the_found_calibration_holds_its_own_uncertainty_and_starts_a_state_with_it() -> None:
    result = calibrated()
    fresh = Posterior.fresh(result.calibration).known
    for name, state in (("torque_offset", State.TORQUE_OFFSET), ("touch1", State.TOUCH1)):
        assert fresh.std()[state] == pytest.approx(result.std(name), rel=1e-6)
    assert np.allclose(fresh.mean[State.TORQUE_OFFSET : STATE_COUNT], result.mean[State.TORQUE_OFFSET : STATE_COUNT])


def test_a_vehicle_is_calibrated_from_its_type_only() -> None:
    shifts, run_ups = unlike_its_type()
    again = self_calibrate(shifts, run_ups, calibrated().calibration, "again")
    assert isinstance(again, str)
    assert "start from its type" in again


def test_too_few_shifts_are_refused() -> None:
    shifts, run_ups = unlike_its_type()
    refusal = self_calibrate(shifts[:6], run_ups, NOMINAL, "test")
    assert isinstance(refusal, str)
    assert "usable shifts" in refusal


def test_another_vehicle_type_is_refused() -> None:
    """Half the engine's inertia cannot be this type, however the parameters bend."""
    shifts, _ = unlike_its_type()
    side = NOMINAL.input_side
    other = replace(NOMINAL, input_side=replace(side, engine_inertia_kg_m2=0.4 * side.engine_inertia_kg_m2))
    refusal = self_calibrate(shifts, (), other, "test")
    assert isinstance(refusal, str)
    assert "not a vehicle of this type" in refusal


def test_an_interrupted_rev_is_not_used() -> None:
    shifts, run_ups = unlike_its_type()
    broken = [replace(run_up, end_reason=EndReason.INTERRUPTED) for run_up in run_ups]
    assert found(shifts, broken).run_up_counts == (0, 0)


@lru_cache
def without_noise() -> tuple[tuple[Event, ...], tuple[Event, ...]]:
    base = drive_scenario(seed=5)
    sensors = {name: replace(sensor, noise_std=0.0) for name, sensor in base.sensors.items()}
    return seen(replace(base, sensors=sensors, routine=WorkshopRoutine(open_revs=1, closed_revs=1)))


def test_noise_of_one_signal_for_engine_and_hub_is_in_what_both_share_with_the_residual() -> None:
    event, laws = without_noise()[0][0], VehicleLaws.of(NOMINAL).displaced(AS_DRIVEN)
    signals = usable_signals(event, laws)
    assert not isinstance(signals, Reason)
    one = signals.engine_speed
    overlaps = []
    for hub in (one, Resampled(one.times_s, one.value.copy(), signals.grid_s)):
        rows = replace(signals, hub_speed=hub, row_s=0.04)
        drives = measured_drives(rows, AS_DRIVEN, None, event.start_ns, laws.packs)
        found = slip_window(rows, drives, laws.packs)
        assert found is not None
        there = Balance(rows, found[0], drives, laws, AS_DRIVEN)
        (seen,) = measurements_of(there, noise_of(rows))
        assert seen.overlap is not None
        overlaps.append(seen.overlap[STATE_COUNT + np.array([Considered.TORQUE_GAIN, Considered.ENGINE_INERTIA])])
    (gain, inertia), (apart_gain, apart_inertia) = overlaps
    assert gain < 1.1 * apart_gain < 0.0
    assert inertia < 1.1 * apart_inertia < 0.0


def shift_residual(event: Event, at: FloatArray, window: SlipWindow | None) -> tuple[Measurement, SlipWindow]:
    laws = VehicleLaws.of(NOMINAL).displaced(at)
    signals = usable_signals(event, laws)
    assert not isinstance(signals, Reason)
    drives = measured_drives(signals, at, None, event.start_ns, laws.packs)
    found = slip_window(signals, drives, laws.packs)
    assert found is not None
    chosen = window or found[0]
    there = Balance(signals, chosen, drives, laws, at)
    (seen,) = measurements_of(there, noise_of(signals))
    return seen, chosen


def test_a_shift_tells_only_the_product_of_torque_gain_and_inertia() -> None:
    seen, _ = shift_residual(without_noise()[0][0], AS_DRIVEN, None)
    assert seen.overlap is not None
    laws = VehicleLaws.of(NOMINAL).displaced(AS_DRIVEN)
    gain, side = laws.bias.torque_gain, laws.input_side
    turned_ratio = 1.0 + side.hub_inertia_kg_m2 / side.engine_inertia_kg_m2
    by_gain, by_inertia = STATE_COUNT + Considered.TORQUE_GAIN, STATE_COUNT + Considered.ENGINE_INERTIA
    assert gain * seen.jacobian[:, by_gain] == pytest.approx(turned_ratio * seen.jacobian[:, by_inertia])
    assert gain * seen.overlap[by_gain] == pytest.approx(turned_ratio * seen.overlap[by_inertia])
