"""A trip follows its trace, keeps its energy, and does not depend on how it is asked for its rows."""

import numpy as np
import pytest

from benchmarks.tolerance import share_within_tolerance
from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import DriveState, EngineState
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.driving.trip import Trip
from ecu_emulator.plant.state import Col
from tests.unit.ecu_emulator.driving.drives import COLD_K, driven, trace, trip

STOP_AND_GO = trace((0, 0), (2, 0), (8, 9), (11, 9), (15, 0), (20, 0), (26, 8), (30, 8))


@pytest.fixture(scope="module")
def audited() -> tuple[Trip, FloatArray]:
    """Return an audited trip at its end, and all its rows."""
    whole = trip(STOP_AND_GO, whim_ratio=0.5, is_audited=True)
    return whole, whole.advance(STOP_AND_GO.duration_s)


def share(road: SpeedTrace, rows: FloatArray) -> float:
    return share_within_tolerance(road, rows[:, Col.T_S], rows[:, Col.VEHICLE_SPEED])


def test_the_car_keeps_to_its_trace_warm_and_cold(
    town_trace: SpeedTrace, town: FloatArray, cold_town: FloatArray
) -> None:
    assert share(town_trace, town) > 0.995
    assert share(town_trace, cold_town) > 0.995


@pytest.mark.parametrize("grade_ratio", [-0.05, 0.05])
def test_the_car_keeps_to_its_trace_on_a_grade_heavily_loaded(grade_ratio: float) -> None:
    road = trace((0, 0), (2, 0), (8, 9), (11, 9), (15, 0), (16, 0), grade_ratio=grade_ratio)
    assert share(road, driven(road, mass_kg=2000.0)) > 0.98


def test_no_energy_appears_or_gets_lost(audited: tuple[Trip, FloatArray]) -> None:
    whole, _ = audited
    balance = whole.power_balance
    assert abs(balance.residual_ratio) < 1.0e-6
    assert abs(balance.heat_residual_ratio) < 1.0e-6
    assert balance.clutch_j > 5.0e3
    assert balance.brake_j > 4.0e4


def test_the_held_car_stands_still_to_the_last_digit(town: FloatArray) -> None:
    waiting = town[:, Col.T_S] < 2.5
    assert not town[waiting, Col.VEHICLE_SPEED].any()
    assert town[-1, Col.VEHICLE_SPEED] == 0.0
    assert town[-1, Col.DRIVE_STATE] == DriveState.STANDSTILL


@pytest.mark.parametrize("grade_ratio", [-0.1, 0.1])
def test_the_brakes_hold_the_car_on_a_hill(grade_ratio: float) -> None:
    rows = driven(trace((0, 0), (4, 0), grade_ratio=grade_ratio), mass_kg=2500.0)
    assert not rows[:, Col.VEHICLE_SPEED].any()
    assert not rows[:, Col.DISTANCE].any()


def test_hill_hold_lets_the_car_start_without_rolling_back() -> None:
    rows = driven(trace((0, 0), (2, 0), (8, 6), grade_ratio=0.12), mass_kg=2000.0)
    assert rows[:, Col.DISTANCE].min() > -0.02
    assert rows[-1, Col.VEHICLE_SPEED] > 4.0


def test_oil_and_coolant_warm_up_as_the_engine_runs(cold_town: FloatArray) -> None:
    coolant_k, oil_k = cold_town[:, Col.COOLANT_TEMPERATURE], cold_town[:, Col.SUMP_TEMPERATURE]
    assert coolant_k[0] == pytest.approx(COLD_K, abs=0.01)
    assert 5.0 < coolant_k[-1] - COLD_K < 15.0
    assert 1.0 < oil_k[-1] - COLD_K < 8.0
    assert (np.diff(coolant_k) >= 0.0).all()


def test_a_cold_open_clutch_drags_within_bounds(cold_town: FloatArray) -> None:
    standing = cold_town[:, Col.T_S] < 3.0
    drag_nm = cold_town[standing, Col.CLUTCH1_TORQUE]
    assert 5.0 < drag_nm.mean() < 9.0


def test_a_warm_engine_stops_at_a_standstill_and_a_cold_one_does_not(town: FloatArray, cold_town: FloatArray) -> None:
    assert (town[:, Col.ENGINE_STATE] == EngineState.STOPPED).any()
    stopped = town[town[:, Col.ENGINE_STATE] == EngineState.STOPPED]
    assert stopped[:, Col.ENGINE_SPEED].min() < 0.5
    assert town[:, Col.ENGINE_SPEED].min() > -0.5
    assert not (cold_town[:, Col.ENGINE_STATE] >= EngineState.STOPPED).any()


def test_the_output_shaft_rings_shortly_when_a_synchroniser_engages(town: FloatArray) -> None:
    engaged = np.flatnonzero((town[1:, Col.SHAFT1_GEAR] == 3.0) & (town[:-1, Col.SHAFT1_GEAR] == 0.0))[0]
    twisting_rad_s = town[:, Col.DIFF_SPEED] - town[:, Col.WHEEL_SPEED]
    assert np.ptp(twisting_rad_s[engaged - 100 : engaged + 20]) > 0.15
    assert np.ptp(twisting_rad_s[engaged + 300 : engaged + 400]) < 0.08
