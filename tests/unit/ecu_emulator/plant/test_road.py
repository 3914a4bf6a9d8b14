import pytest

from ecu_emulator.plant.driveline import (
    GRAVITY_M_S2,
    brake_force_n,
    geared_torque_nm,
    road_load_n,
    synchroniser_torque_nm,
    tanh_exact,
    twist_torque_nm,
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


def test_brakes_let_go_at_standstill() -> None:
    assert brake_force_n(0.7, 20.0, 1.0, VEHICLE) == pytest.approx(0.7 * VEHICLE.mass_kg)
    assert brake_force_n(0.7, 0.0, 1.0, VEHICLE) == 0.0
    assert brake_force_n(0.7, -1.0, 1.0, VEHICLE) == pytest.approx(-0.7 * VEHICLE.mass_kg)  # against the motion
    assert brake_force_n(0.7, 0.05, 0.1, VEHICLE) == pytest.approx(0.35 * VEHICLE.mass_kg)


def test_road_load_adds_rolling_grade_and_air() -> None:
    speed_m_s = 20.0
    air_n = 0.5 * 1.2 * 0.68 * speed_m_s**2
    weight_n = VEHICLE.mass_kg * GRAVITY_M_S2
    assert road_load_n(speed_m_s, 0.02, VEHICLE) == pytest.approx(weight_n * (0.011 + 0.02) + air_n)
    assert road_load_n(-speed_m_s, 0.0, VEHICLE) == -road_load_n(speed_m_s, 0.0, VEHICLE)


def test_tanh_shortcut_is_exact() -> None:
    assert tanh_exact(20.1) == 1.0
    assert tanh_exact(-20.1) == -1.0
    assert tanh_exact(0.3) == pytest.approx(0.2913126124515909, rel=1e-15)


def test_a_gear_loses_torque_both_ways() -> None:
    assert geared_torque_nm(100.0, 200.0, 0.98, 0.0) == pytest.approx(98.0)
    assert geared_torque_nm(-100.0, 200.0, 0.98, 0.0) == pytest.approx(-102.0)
    assert geared_torque_nm(0.0, 200.0, 0.98, 0.004) == pytest.approx(-0.8)


def test_the_synchroniser_saturates() -> None:
    assert synchroniser_torque_nm(100.0, SYNCHRONISER) == SYNCHRONISER.torque_nm
    assert synchroniser_torque_nm(-100.0, SYNCHRONISER) == -SYNCHRONISER.torque_nm
    half = 0.5 * SYNCHRONISER.full_torque_slip_rad_s
    assert synchroniser_torque_nm(half, SYNCHRONISER) == pytest.approx(0.5 * SYNCHRONISER.torque_nm)


def test_a_shaft_is_a_spring_and_a_damper() -> None:
    assert twist_torque_nm(0.01, 2.0, 8000.0, 1.5) == pytest.approx(83.0)
