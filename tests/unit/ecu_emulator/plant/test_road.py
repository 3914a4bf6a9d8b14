import pytest

from ecu_emulator.plant.driveline import (
    GRAVITY_M_S2,
    road_load_n,
    tyre_force_n,
)
from ecu_emulator.plant.parameters import nominal_parameters

PARAMETERS = nominal_parameters()
VEHICLE, SYNCHRONISER = PARAMETERS.vehicle, PARAMETERS.synchroniser


def test_a_rolling_wheel_pulls_nothing() -> None:
    assert tyre_force_n(10.0 / VEHICLE.wheel_radius_m, 10.0, VEHICLE) == pytest.approx(0.0, abs=1e-9)


def test_a_spinning_wheel_pulls_no_more_than_its_grip() -> None:
    grip_n = VEHICLE.tyre_friction_ratio * VEHICLE.driven_load_ratio * VEHICLE.mass_kg * GRAVITY_M_S2
    assert tyre_force_n(500.0, 10.0, VEHICLE) == pytest.approx(grip_n)
    assert tyre_force_n(0.0, 10.0, VEHICLE) == pytest.approx(-grip_n)


def test_road_load_adds_rolling_grade_and_air() -> None:
    speed_m_s = 20.0
    air_n = 0.5 * 1.2 * 0.68 * speed_m_s**2
    weight_n = VEHICLE.mass_kg * GRAVITY_M_S2
    assert road_load_n(speed_m_s, 0.02, VEHICLE) == pytest.approx(weight_n * (0.011 + 0.02) + air_n)
    assert road_load_n(-speed_m_s, 0.0, VEHICLE) == -road_load_n(speed_m_s, 0.0, VEHICLE)
