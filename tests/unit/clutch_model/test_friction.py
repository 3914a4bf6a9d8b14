import math

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import contact_torque_nm, friction_law, kinetic_friction, stribeck_weight

LAW = friction_law(nominal_calibration().clutches[0].friction)


@pytest.mark.parametrize("slip_rad_s", [0.0, 0.05, -0.1, 0.1])
def test_friction_is_static_inside_the_lock_band(slip_rad_s: float) -> None:
    assert kinetic_friction(slip_rad_s, LAW) == LAW.mu_s


def test_friction_is_coulombs_at_high_slip() -> None:
    assert kinetic_friction(400.0, LAW) == pytest.approx(LAW.mu_c, rel=1e-12)


def test_the_stribeck_speed_is_where_the_weight_is_1_over_e() -> None:
    assert stribeck_weight(LAW.lock_band_rad_s + LAW.stribeck_speed_rad_s, LAW) == pytest.approx(math.exp(-1.0))


def test_the_exponent_bends_the_curve() -> None:
    excess = 0.5
    bent = LAW._replace(stribeck_exponent=2.0)
    weight = stribeck_weight(LAW.lock_band_rad_s + excess * LAW.stribeck_speed_rad_s, bent)
    assert weight == pytest.approx(math.exp(-(excess**2)))


def test_contact_torque_has_the_sign_of_its_direction() -> None:
    assert contact_torque_nm(-1.0, 0.1, 2.0e5, 5.0e-3) == pytest.approx(-100.0)
