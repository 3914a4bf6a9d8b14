"""Twist of a shaft from its torque alone."""

import numpy as np
import pytest

from benchmarks.full_estimator.shaft_twist import shaft_twist
from diag_service.diagnosis.friction.paper import nominal_driveline

PERIOD_S = 1e-3


@pytest.mark.parametrize(("speed_rad_s", "tolerance"), [(60.0, 1e-4), (400.0, 3e-3)])
def test_the_torque_of_a_swinging_shaft_gives_its_twist_rate_back(speed_rad_s: float, tolerance: float) -> None:
    shaft = nominal_driveline().shafts[0]
    angle = speed_rad_s * PERIOD_S * np.arange(1000)
    twist, rate, acceleration = (
        np.sin(angle),
        speed_rad_s * np.cos(angle),
        -(speed_rad_s**2) * np.sin(angle),
    )
    torque_nm = shaft.stiffness_nm_rad * twist + shaft.damping_nms_rad * rate
    found = shaft_twist(torque_nm, PERIOD_S, shaft)
    inner = slice(20, -20)
    assert found.rate_rad_s[inner] == pytest.approx(rate[inner], abs=tolerance * speed_rad_s)
    assert found.acceleration_rad_s2[inner] == pytest.approx(acceleration[inner], abs=5.0 * tolerance * speed_rad_s**2)
