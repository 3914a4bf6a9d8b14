"""From clutch torque back to film and piston pressure."""

import math

import numpy as np
import pytest

from benchmarks.full_estimator.inversion import clutch_torque_nm, film_of_torque_m, heated_k
from benchmarks.full_estimator.windows import Window
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import equilibrium_film_m, film_law, friction_law
from tests.support.film_laws import measured_film_rate_m_s

CALIBRATION = nominal_calibration()
PERIOD_S, SUBSTEPS = 1e-3, 40
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


def test_a_torque_that_no_touching_film_passes_has_none() -> None:
    believed = CALIBRATION.clutches[0]
    law, friction = film_law(believed), friction_law(believed.friction)
    viscous_nm = clutch_torque_nm(4.0 * law.roughness_m, 100.0, VISCOSITY, friction, law)
    assert math.isnan(film_of_torque_m(0.9 * viscous_nm, 100.0, VISCOSITY, friction, law, 0.0))
    assert math.isnan(film_of_torque_m(1e6, 100.0, VISCOSITY, friction, law, 0.0))


@pytest.mark.parametrize("clutch", [1, 2])
def test_the_torques_of_an_engagement_give_its_pressure_back(clutch: int) -> None:
    believed = CALIBRATION.clutches[clutch - 1]
    law, friction = film_law(believed), friction_law(believed.friction)
    times_s = PERIOD_S * np.arange(500)
    speed_rad_s = 80.0 * (1.0 - times_s / times_s[-1]) ** 2 + 0.5

    def pressure_pa(at_s: float) -> float:
        return 2.5e5 + 3.0e5 * math.sin(4.0 * at_s) ** 2

    film_m = equilibrium_film_m((2.5e5 * law.piston_area_m2 - law.closed_spring_force_n) / law.lining_area_m2, law)
    films_m = []
    step_s = PERIOD_S / SUBSTEPS
    for start_s in times_s:
        films_m.append(film_m)
        for j in range(SUBSTEPS):
            at_s = float(start_s) + j * step_s
            rate = measured_film_rate_m_s(film_m, pressure_pa(at_s), VISCOSITY, law)
            middle_m = film_m + 0.5 * step_s * rate
            film_m += step_s * measured_film_rate_m_s(middle_m, pressure_pa(at_s + 0.5 * step_s), VISCOSITY, law)
    torque_nm = [
        clutch_torque_nm(film, float(speed), VISCOSITY, friction, law)
        for film, speed in zip(films_m, speed_rad_s, strict=True)
    ]
    window = Window(
        first=0,
        period_s=PERIOD_S,
        torque_nm=np.array(torque_nm),
        speed_rad_s=speed_rad_s,
        slip_std_rad_s=0.05,
        viscosity=np.full(len(times_s), VISCOSITY),
        reading_pa=np.zeros(len(times_s)),
        reading_std_pa=2.0e4,
    )
    found_pa = window.piston_pa(friction, law)
    true_pa = np.array([pressure_pa(float(one)) for one in times_s])
    settled = slice(20, -2)  # the film starts at rest under a pressure that already moves
    assert found_pa[settled] == pytest.approx(true_pa[settled], abs=20.0)  # a thousandth of the sensor's noise


def test_a_heated_pack_tends_to_where_it_sheds_what_it_gets() -> None:
    power_w, oil_k = np.full(60_000, 900.0), np.full(60_000, 360.0)
    clutch_k = heated_k(power_w, oil_k, PERIOD_S, 1500.0, 450.0)
    assert clutch_k[0] == 360.0
    times_s = PERIOD_S * np.arange(60_000)
    assert clutch_k == pytest.approx(360.0 + 2.0 * (1.0 - np.exp(-times_s * 450.0 / 1500.0)), abs=1e-3)
