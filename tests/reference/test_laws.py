"""Values of an independent implementation of the laws, default parameters (docs/model.md, "Golden values")."""

import math

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.film import (
    applied_pressure_pa,
    contact_pressure_pa,
    equilibrium_film_m,
    film_law,
    film_mobility_m,
    shear_factor_difference,
    squeeze_rate_m_s,
)
from clutch_model.friction import contact_torque_nm, friction_law, kinetic_friction
from clutch_model.units import k_from_degc
from clutch_model.viscosity import viscosity_pa_s

CALIBRATION = nominal_calibration()
LAWS = [film_law(clutch) for clutch in CALIBRATION.clutches]
FRICTION = friction_law(CALIBRATION.clutches[0].friction)


def viscosity_at(temperature_degc: float) -> float:
    oil = CALIBRATION.viscosity
    return viscosity_pa_s(k_from_degc(temperature_degc), oil.a_pa_s, oil.b_k, oil.pole_k)


@pytest.mark.parametrize(
    ("film_ratio", "expected"),
    [(0.5, 0.207037), (1.0, 0.489824), (1.2, 0.671941), (1.5, 0.899603), (2, 1.013909), (3, 0.867053), (5, 0.996039)],
)
def test_shear_factor_difference(film_ratio: float, expected: float) -> None:
    assert shear_factor_difference(film_ratio) == pytest.approx(expected, abs=6e-7)


def test_shear_factor_has_the_papers_thresholds() -> None:
    assert shear_factor_difference(1.1206) == pytest.approx(0.6, abs=1e-4)
    assert shear_factor_difference(1.4220) == pytest.approx(0.85, abs=1e-4)
    assert shear_factor_difference(2.841) == pytest.approx(0.8590, abs=5e-5)


@pytest.mark.parametrize(
    ("film_ratio", "expected_pa"), [(0.5, 665672.97), (1.0, 233214.19), (1.5, 67453.70), (2.0, 14778.49)]
)
def test_contact_pressure(film_ratio: float, expected_pa: float) -> None:
    assert contact_pressure_pa(film_ratio * LAWS[0].roughness_m, LAWS[0]) == pytest.approx(expected_pa, abs=0.006)


@pytest.mark.parametrize(("temperature_degc", "expected_pa_s"), [(40, 25.5e-3), (90, 6.424e-3), (100, 5.31e-3)])
def test_viscosity(temperature_degc: float, expected_pa_s: float) -> None:
    assert viscosity_at(temperature_degc) == pytest.approx(expected_pa_s, rel=2e-3)


def test_geometry_factors() -> None:
    first, second = LAWS
    assert first.squeeze_factor_m2 == pytest.approx(2.56171566e-4, rel=1e-8)
    assert (first.contact_factor_m3, second.contact_factor_m3) == pytest.approx((5.16434e-3, 3.64056e-3), rel=2e-6)
    assert (first.viscous_factor_m4, second.viscous_factor_m4) == pytest.approx((4.15893e-4, 2.21007e-4), rel=2e-6)


@pytest.mark.parametrize(
    ("film_um", "expected_m_s"),
    [(100, -7.177793e-2), (30, -2.429797e-3), (12, -7.015069e-5), (9, 3.261209e-4)],
)
def test_squeeze_rate(film_um: float, expected_m_s: float) -> None:
    rate_m_s = squeeze_rate_m_s(film_um * 1e-6, 1e5, viscosity_at(90), LAWS[0])
    assert rate_m_s == pytest.approx(expected_m_s, rel=1e-6)


@pytest.mark.parametrize(
    ("slip_rad_s", "expected"), [(0.1, 0.119), (1, 0.121925), (6, 0.132145), (12, 0.137110), (50, 0.139995)]
)
def test_stribeck_curve(slip_rad_s: float, expected: float) -> None:
    assert kinetic_friction(slip_rad_s, FRICTION) == pytest.approx(expected, abs=6e-7)


@pytest.mark.parametrize(
    ("clutch", "piston_pa", "applied_pa", "film_um", "capacity_nm"),
    [
        (1, 5e5, 249923, 8.152, 153.6),
        (1, 10e5, 591857, 4.709, 363.7),
        (2, 5e5, 266916, 7.904, 115.6),
        (2, 10e5, 648225, 4.320, 280.8),
    ],
)
def test_equilibrium(clutch: int, piston_pa: float, applied_pa: float, film_um: float, capacity_nm: float) -> None:
    law = LAWS[clutch - 1]
    pressure_pa = applied_pressure_pa(piston_pa, law)
    film_m = equilibrium_film_m(pressure_pa, law)
    torque_nm = contact_torque_nm(1.0, FRICTION.mu_s, contact_pressure_pa(film_m, law), law.contact_factor_m3)
    assert pressure_pa == pytest.approx(applied_pa, abs=0.6)
    assert film_m == pytest.approx(film_um * 1e-6, abs=6e-10)
    assert torque_nm == pytest.approx(capacity_nm, abs=0.06)


@pytest.mark.parametrize(("film_ratio", "expected_ms"), [(1.0, 4.9), (1.3, 8.1), (1.6, 13.1), (2.0, 27.0)])
def test_film_time_constant(film_ratio: float, expected_ms: float) -> None:
    law = LAWS[0]
    film_m, step_m = film_ratio * law.roughness_m, 1e-10
    slope_pa_m = (contact_pressure_pa(film_m + step_m, law) - contact_pressure_pa(film_m - step_m, law)) / (2 * step_m)
    time_constant_s = -viscosity_at(90) / (slope_pa_m * film_mobility_m(film_m, law))
    assert time_constant_s == pytest.approx(expected_ms * 1e-3, abs=0.06e-3)


def test_squeeze_factor_is_that_of_an_annular_film() -> None:
    # Quadrature of the Reynolds equation on a ring, mean pressure per unit squeeze rate, against the closed form.
    law_clutch = CALIBRATION.clutches[0].geometry
    outer, inner = law_clutch.outer_radius_m, law_clutch.inner_radius_m
    count = 20_000
    step = (outer - inner) / count
    slope = (outer**2 - inner**2) / math.log(outer / inner)

    def pressure(radius: float) -> float:
        return 3.0 * ((outer**2 - radius**2) - slope * math.log(outer / radius))

    load = sum(pressure(inner + (index + 0.5) * step) * (inner + (index + 0.5) * step) for index in range(count)) * step
    mean = 2.0 * load / (outer**2 - inner**2)
    assert mean == pytest.approx(law_clutch.squeeze_factor_m2, rel=1e-7)
