"""A point of a film, as an estimator follows it: the laws of a film, arranged otherwise."""

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.film import contact_pressure_pa, film_law, film_mobility_m, measured_film_rate_m_s
from clutch_model.film_points import film_point, point_rate_m_s, point_slope_1_s

CLUTCH = nominal_calibration().clutches[0]
LAW = film_law(CLUTCH)
VISCOSITY = 6.4e-3


@pytest.mark.parametrize("ratio", [0.05, 0.4, 1.0, 2.1, 3.2, 3.9, 3.9995, 3.99995, 4.0, 4.2, 7.0, 12.0])
def test_a_point_of_a_film_is_what_the_laws_say_there_and_a_step_thicker(ratio: float) -> None:
    film_m = ratio * LAW.roughness_m
    point = film_point(film_m, LAW)
    thicker_m = film_m + point.step_m
    assert point.step_m == pytest.approx(1e-4 * film_m)
    assert point.contact_pa == contact_pressure_pa(film_m, LAW)
    assert point.mobility_m == pytest.approx(film_mobility_m(film_m, LAW), rel=1e-14)
    assert point.thicker_contact_pa == pytest.approx(contact_pressure_pa(thicker_m, LAW), rel=1e-12)
    assert point.thicker_mobility_m == pytest.approx(film_mobility_m(thicker_m, LAW), rel=1e-12)
    for piston_pa in (0.5 * CLUTCH.touch_pressure_pa, 3.0 * CLUTCH.touch_pressure_pa):
        rates = [measured_film_rate_m_s(one, piston_pa, VISCOSITY, LAW) for one in (film_m, thicker_m)]
        assert point_rate_m_s(point, piston_pa, 1.0 / VISCOSITY, LAW) == pytest.approx(rates[0], rel=1e-12)
        slope_1_s = (rates[1] - rates[0]) / point.step_m
        assert point_slope_1_s(point, piston_pa, 1.0 / VISCOSITY, LAW) == pytest.approx(slope_1_s, rel=1e-7)
