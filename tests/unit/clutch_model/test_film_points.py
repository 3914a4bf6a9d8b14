"""A point of a film, as an estimator follows it: it moves as the law of the film says."""

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import film_law, film_point, point_motion, point_rate_m_s, thicker_m
from tests.support.film_laws import measured_film_rate_m_s

CLUTCH = nominal_calibration().clutches[0]
LAW = film_law(CLUTCH)
VISCOSITY = 6.4e-3


@pytest.mark.parametrize("ratio", [0.05, 0.4, 1.0, 2.1, 3.2, 3.9, 3.9995, 3.99995, 4.0, 4.2, 7.0, 12.0])
@pytest.mark.parametrize("piston_pa", [0.5 * CLUTCH.touch_pressure_pa, 3.0 * CLUTCH.touch_pressure_pa])
def test_a_film_moves_from_a_point_as_the_law_says(ratio: float, piston_pa: float) -> None:
    film_m = ratio * LAW.roughness_m
    point = film_point(film_m, LAW)
    rates = [measured_film_rate_m_s(one, piston_pa, VISCOSITY, LAW) for one in (film_m, thicker_m(point))]
    rate_m_s, slope_1_s = point_motion(point, piston_pa, VISCOSITY, LAW)
    assert rate_m_s == point_rate_m_s(point, piston_pa, VISCOSITY, LAW)
    assert rate_m_s == pytest.approx(rates[0], rel=1e-12)
    assert slope_1_s == pytest.approx((rates[1] - rates[0]) / (1e-4 * film_m), rel=1e-7)
