"""Pedal, feet, engine and shift map: what each promises by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import DriveState, EngineState
from ecu_emulator.driving.laws import asked_force_n, pedal_for_force
from ecu_emulator.driving.parameters import nominal_driving
from ecu_emulator.driving.trip import DriveConditions
from ecu_emulator.errors import ConfigError
from ecu_emulator.plant.state import Col

DRIVING = nominal_driving()


@given(force_n=st.floats(-900.0, 20_000.0), speed_m_s=st.floats(0.0, 60.0), overrun_n=st.floats(-3_000.0, -1_000.0))
def test_the_driver_knows_what_the_pedal_means(force_n: float, speed_m_s: float, overrun_n: float) -> None:
    pedal = pedal_for_force(force_n, speed_m_s, overrun_n, DRIVING.pedal)
    assert 0.0 <= pedal <= 1.0
    asked_n = asked_force_n(pedal, speed_m_s, overrun_n, DRIVING.pedal)
    full_n = asked_force_n(1.0, speed_m_s, overrun_n, DRIVING.pedal)
    assert asked_n == pytest.approx(min(force_n, full_n), abs=1.0e-6)


def test_feet_move_no_faster_than_feet_and_never_press_both(town: FloatArray, sport: FloatArray) -> None:
    for rows in (town, sport):
        pedal, brake_m_s2 = rows[:, Col.PEDAL], rows[:, Col.BRAKE]
        assert np.abs(np.diff(pedal)).max() * 1000.0 <= DRIVING.driver.pedal_release_per_s + 1.0e-6
        assert np.abs(np.diff(brake_m_s2)).max() * 1000.0 <= DRIVING.driver.brake_press_m_s3 + 1.0e-6
        assert not ((pedal > 0.0) & (brake_m_s2 > 0.0)).any()
        assert pedal.min() >= 0.0
        assert pedal.max() <= 1.0


def test_the_engine_that_the_car_turns_gets_no_fuel(sport: FloatArray) -> None:
    cut = sport[sport[:, Col.ENGINE_STATE] == EngineState.FUEL_CUT]
    assert len(cut) > 500
    settled = cut[cut[:, Col.DRIVE_STATE] == DriveState.IN_GEAR][100:]
    assert settled[:, Col.ENGINE_TORQUE].max() < -30.0
    assert cut[:, Col.PEDAL].max() < 0.1


def test_a_running_engine_never_stalls(town: FloatArray, cold_town: FloatArray, sport: FloatArray) -> None:
    for rows in (town, cold_town, sport):
        firing = rows[rows[:, Col.ENGINE_STATE] <= EngineState.FUEL_CUT]
        assert firing[:, Col.ENGINE_SPEED].min() > 50.0
        assert firing[:, Col.ENGINE_SPEED].max() < DRIVING.engine.top_rad_s + 10.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"oil_k": 100.0}, "oil_k"),
        ({"coolant_k": float("nan")}, "coolant_k"),
        ({"dt_s": 3.0e-4}, "dt_s"),
        ({"dt_s": 1.7e-4}, "divide 1 ms"),
        ({"whim_ratio": 1.5}, "whim_ratio"),
    ],
)
def test_conditions_outside_their_ranges_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DriveConditions(**changes)  # type: ignore[arg-type]  # all of them are numbers
