"""A trip follows its trace, keeps its energy, and does not depend on how it is asked for its rows."""

import numpy as np
import pytest

from benchmarks.tolerance import share_within_tolerance
from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import EngineState
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


def test_no_energy_appears_or_gets_lost(audited: tuple[Trip, FloatArray]) -> None:
    whole, _ = audited
    balance = whole.power_balance
    assert abs(balance.residual_ratio) < 1.0e-6
    assert abs(balance.heat_residual_ratio) < 1.0e-6
    assert balance.clutch_j > 5.0e3
    assert balance.brake_j > 4.0e4


@pytest.mark.parametrize("grade_ratio", [-0.1, 0.1])
def test_the_brakes_hold_the_car_on_a_hill(grade_ratio: float) -> None:
    rows = driven(trace((0, 0), (4, 0), grade_ratio=grade_ratio), mass_kg=2500.0)
    assert not rows[:, Col.VEHICLE_SPEED].any()
    assert not rows[:, Col.DISTANCE].any()


def test_oil_and_coolant_warm_up_as_the_engine_runs(cold_town: FloatArray) -> None:
    coolant_k, oil_k = cold_town[:, Col.COOLANT_TEMPERATURE], cold_town[:, Col.SUMP_TEMPERATURE]
    assert coolant_k[0] == pytest.approx(COLD_K, abs=0.01)
    assert 5.0 < coolant_k[-1] - COLD_K < 15.0
    assert 1.0 < oil_k[-1] - COLD_K < 8.0
    assert (np.diff(coolant_k) >= 0.0).all()


def test_a_warm_engine_stops_at_a_standstill_and_a_cold_one_does_not(town: FloatArray, cold_town: FloatArray) -> None:
    assert (town[:, Col.ENGINE_STATE] == EngineState.STOPPED).any()
    stopped = town[town[:, Col.ENGINE_STATE] == EngineState.STOPPED]
    assert stopped[:, Col.ENGINE_SPEED].min() < 0.5
    assert town[:, Col.ENGINE_SPEED].min() > -0.5
    assert not (cold_town[:, Col.ENGINE_STATE] >= EngineState.STOPPED).any()
