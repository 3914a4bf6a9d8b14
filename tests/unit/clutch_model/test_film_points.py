"""A point of a film, as an estimator follows it: what the laws of a film say there, by polynomials."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    FilmLaw,
    FilmPoint,
    FilmShape,
    contact_pressure_pa,
    film_law,
    film_mobility_m,
    film_point,
    film_shape,
    point_motion,
    point_rate_m_s,
    shear_factor_difference,
)
from tests.support.film_laws import measured_film_rate_m_s

CLUTCH = nominal_calibration().clutches[0]
LAW = film_law(CLUTCH)
VISCOSITY = 6.4e-3
OPEN = LAW.open_gap_m / LAW.roughness_m
LEAST_PA = 1e4  # of contact: less is held to as much of this
BOUNDS = np.tile(
    [1e-12, 1e-12, 1e-9], 2
)  # of contact, mobility and shear, whose law takes differences of large numbers


@kernel
def point_of(film_m: float, law: FilmLaw, shape: FilmShape) -> FilmPoint:
    return film_point(film_m, law, shape)


@array_kernel
def fill(film_m: FloatArray, law: FilmLaw, shape: FilmShape, found: FloatArray, expected: FloatArray) -> None:
    for row in range(len(film_m)):
        point = film_point(film_m[row], law, shape)
        thicker_m = film_m[row] + point.step_m
        found[row, 0], expected[row, 0] = point.contact_pa, contact_pressure_pa(film_m[row], law)
        found[row, 1], expected[row, 1] = point.mobility_m, film_mobility_m(film_m[row], law)
        found[row, 2], expected[row, 2] = point.shear, shear_factor_difference(film_m[row] / law.roughness_m)
        found[row, 3], expected[row, 3] = point.thicker_contact_pa, contact_pressure_pa(thicker_m, law)
        found[row, 4], expected[row, 4] = point.thicker_mobility_m, film_mobility_m(thicker_m, law)
        found[row, 5], expected[row, 5] = point.thicker_shear, shear_factor_difference(thicker_m / law.roughness_m)


def errors(ratios: FloatArray, law: FilmLaw) -> FloatArray:
    """Return how far points and laws are apart at worst, over what the laws say: contact, mobility, shear; twice."""
    film_m, found, expected = ratios * law.roughness_m, np.empty((len(ratios), 6)), np.empty((len(ratios), 6))
    fill(film_m, law, film_shape(law), found, expected)
    least = np.array([LEAST_PA, 0.0, 0.0, LEAST_PA, 0.0, 0.0])
    return np.asarray(np.max(np.abs(found - expected) / np.maximum(np.abs(expected), least), axis=0))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"contact_stiffness_pa": 1.3 * LAW.contact_stiffness_pa, "squeeze_factor_m2": 0.6 * LAW.squeeze_factor_m2},
        {"roughness_m": 4e-6, "permeability_m2": 1e-12, "slip_coefficient": 0.3, "lining_thickness_m": 3e-4},
    ],
    ids=["nominal", "of another piston", "another surface"],
)
def test_a_point_is_what_the_laws_say_there_and_a_step_thicker(changes: dict[str, float]) -> None:
    law = LAW._replace(**changes)
    film = np.linspace(0.2, OPEN, 20_001)
    is_plain = np.all(np.abs(film[:, None] - [3.0, 7.0]) > 0.01, axis=1)  # the corners of the shear
    assert np.all(errors(film[is_plain], law) < BOUNDS)
    assert np.all(errors(np.linspace(2.99, 3.01, 1001), law) < BOUNDS)
    assert np.all(errors(np.linspace(0.012, 0.2, 1001), law) < 100.0 * BOUNDS)


@pytest.mark.parametrize("ratio", [0.05, 0.4, 1.0, 2.1, 3.2, 3.9, 3.9995, 3.99995, 4.0, 4.2, 7.0, 12.0])
def test_a_film_moves_from_a_point_as_the_laws_say(ratio: float) -> None:
    film_m = ratio * LAW.roughness_m
    point = point_of(film_m, LAW, film_shape(LAW))
    assert point.step_m == pytest.approx(1e-4 * film_m)
    for piston_pa in (0.5 * CLUTCH.touch_pressure_pa, 3.0 * CLUTCH.touch_pressure_pa):
        rates = [measured_film_rate_m_s(one, piston_pa, VISCOSITY, LAW) for one in (film_m, film_m + point.step_m)]
        rate_m_s, slope_1_s = point_motion(point, piston_pa, 1.0 / VISCOSITY, LAW)
        assert rate_m_s == point_rate_m_s(point, piston_pa, 1.0 / VISCOSITY, LAW)
        assert rate_m_s == pytest.approx(rates[0], rel=1e-11)
        assert slope_1_s == pytest.approx((rates[1] - rates[0]) / point.step_m, rel=1e-7)


def test_pistons_stiffnesses_and_mobilities_share_the_shape_of_a_surface() -> None:
    other = LAW._replace(contact_stiffness_pa=1.0, squeeze_factor_m2=2.0, piston_area_m2=3.0)
    assert film_shape(other) is film_shape(LAW)
    assert film_shape(LAW._replace(roughness_m=4e-6)) is not film_shape(LAW)


def test_a_surface_that_no_clutch_has_takes_no_more_memory() -> None:
    assert film_shape(LAW._replace(roughness_m=1e-12)).pieces.nbytes < 2_000_000


def test_what_is_no_film_is_no_number() -> None:
    assert np.isnan(point_of(float("nan"), LAW, film_shape(LAW)).mobility_m)
