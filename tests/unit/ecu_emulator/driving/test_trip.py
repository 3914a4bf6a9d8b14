"""A trip follows its trace, keeps its energy, and does not depend on how it is asked for its rows."""

import pytest

from benchmarks.tolerance import share_within_tolerance
from canlog.arrays import FloatArray
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.driving.trip import Trip
from ecu_emulator.plant.state import Col
from tests.unit.ecu_emulator.driving.drives import trace, trip

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
