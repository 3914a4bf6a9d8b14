"""Pedal, feet, engine and shift map: what each promises by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from clutch_model.errors import CalibrationError
from ecu_emulator.driving.indices import DriveState, EngineState
from ecu_emulator.driving.laws import asked_force_n, pedal_for_force
from ecu_emulator.driving.parameters import DrivingParameters, driving_parameters, nominal_driving
from ecu_emulator.driving.trip import DriveConditions
from ecu_emulator.errors import ConfigError
from ecu_emulator.plant.state import Col
from tests.unit.ecu_emulator.driving.drives import COLD_K, driven, trace

DRIVING = nominal_driving()


@given(force_n=st.floats(-900.0, 20_000.0), speed_m_s=st.floats(0.0, 60.0), overrun_n=st.floats(-3_000.0, -1_000.0))
def test_the_driver_knows_what_the_pedal_means(force_n: float, speed_m_s: float, overrun_n: float) -> None:
    pedal = pedal_for_force(force_n, speed_m_s, overrun_n, DRIVING.pedal)
    assert 0.0 <= pedal <= 1.0
    asked_n = asked_force_n(pedal, speed_m_s, overrun_n, DRIVING.pedal)
    full_n = asked_force_n(1.0, speed_m_s, overrun_n, DRIVING.pedal)
    assert asked_n == pytest.approx(min(force_n, full_n), abs=1.0e-6)


def test_a_released_pedal_lets_the_engine_brake() -> None:
    assert asked_force_n(0.0, 20.0, -600.0, DRIVING.pedal) == -600.0
    assert asked_force_n(0.0, 20.0, 0.0, DRIVING.pedal) == 0.0
    assert pedal_for_force(-100.0, 1.0, 0.0, DRIVING.pedal) == 0.0


def test_feet_move_no_faster_than_feet_and_never_press_both(town: FloatArray, sport: FloatArray) -> None:
    for rows in (town, sport):
        pedal, brake_m_s2 = rows[:, Col.PEDAL], rows[:, Col.BRAKE]
        assert np.abs(np.diff(pedal)).max() * 1000.0 <= DRIVING.driver.pedal_release_per_s + 1.0e-6
        assert np.abs(np.diff(brake_m_s2)).max() * 1000.0 <= DRIVING.driver.brake_press_m_s3 + 1.0e-6
        assert not ((pedal > 0.0) & (brake_m_s2 > 0.0)).any()
        assert pedal.min() >= 0.0
        assert pedal.max() <= 1.0


@pytest.mark.parametrize(
    ("oil_k", "idle_rad_s"),
    [(363.15, DRIVING.engine.warm_idle_rad_s), (COLD_K, DRIVING.engine.cold_idle_rad_s)],
)
def test_the_engine_idles_at_its_speed_warm_and_cold(oil_k: float, idle_rad_s: float) -> None:
    rows = driven(trace((0, 0), (6, 0)), oil_k=oil_k, coolant_k=min(oil_k, 353.15))
    firing_rad_s = rows[rows[:, Col.ENGINE_STATE] == EngineState.FIRING, Col.ENGINE_SPEED]
    assert np.abs(firing_rad_s - idle_rad_s).max() < 12.0
    assert firing_rad_s[-1] == pytest.approx(idle_rad_s, abs=2.0)


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


def test_a_deep_pedal_keeps_lower_gears(town: FloatArray, sport: FloatArray) -> None:
    def fastest_rad_s(rows: FloatArray) -> float:
        pulling = (rows[:, Col.DRIVE_STATE] == DriveState.IN_GEAR) & (rows[:, Col.CURRENT_GEAR] == 3.0)
        return float(rows[pulling, Col.ENGINE_SPEED].max())

    assert fastest_rad_s(sport) > 1.5 * fastest_rad_s(town)


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


def _table(driving: DrivingParameters) -> dict[str, dict[str, float]]:
    return {name: record._asdict() for name, record in driving._asdict().items()}


def test_driving_parameters_are_checked_when_they_are_loaded() -> None:
    assert driving_parameters(_table(DRIVING)) == DRIVING
    for section, key, value, message in (
        ("driver", "aim_s", -1.0, "driver.aim_s must be > 0"),
        ("launch", "top_nm", float("inf"), "launch.top_nm must be > 0"),
    ):
        table = _table(DRIVING)
        table[section][key] = value
        with pytest.raises(CalibrationError, match=message):
            driving_parameters(table)
    table = _table(DRIVING)
    del table["pedal"]["power_w"]
    with pytest.raises(CalibrationError, match="power_w is missing"):
        driving_parameters(table)
