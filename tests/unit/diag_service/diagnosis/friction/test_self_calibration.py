"""What a vehicle says about itself: derivatives, refusals, and the answer where the truth is known."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.evidence import STATE_COUNT, State
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.self_calibration import SelfCalibration, self_calibrate
from ecu_emulator.scenario.scenario import Truth, WorkshopRoutine
from tests.support.builders import drive_scenario
from tests.support.shifts_of_a_drive import events_of

NOMINAL = nominal_calibration()
TORQUE_LATENCY_S, PRESSURE_LATENCY_S, SPEED_LATENCY_S = 0.023, 0.011, 0.004
GAIN, OFFSET_NM, INERTIA = 1.03, -6.0, 0.96
SPEEDS = ("engine_speed_rad_s", "hub_speed_rad_s", "input1_speed_rad_s", "input2_speed_rad_s")


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
    return events_of(
        replace(base, sensors=sensors, truth=truth, routine=WorkshopRoutine(open_revs=4, closed_revs=4)), NOMINAL
    )


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
