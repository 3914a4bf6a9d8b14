"""From clutch torque back to film and piston pressure."""

import pytest

from benchmarks.full_estimator.inversion import clutch_torque_nm, film_of_torque_m
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import film_law, friction_law

CALIBRATION = nominal_calibration()
VISCOSITY = 6.42e-3


@pytest.mark.parametrize("clutch", [1, 2])
@pytest.mark.parametrize("film_ratio", [0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("slip_rad_s", [0.3, 5.0, 120.0])
def test_a_torque_leads_back_to_its_film(clutch: int, film_ratio: float, slip_rad_s: float) -> None:
    believed = CALIBRATION.clutches[clutch - 1]
    law, friction = film_law(believed), friction_law(believed.friction)
    film_m = film_ratio * law.roughness_m
    torque_nm = clutch_torque_nm(film_m, slip_rad_s, VISCOSITY, friction, law)
    assert film_of_torque_m(torque_nm, slip_rad_s, VISCOSITY, friction, law, 0.0) == pytest.approx(film_m, rel=1e-11)
