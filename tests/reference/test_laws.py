"""The laws against values from elsewhere (docs/model.md, "Parameters")."""

import math

import pytest

from clutch_model.pack import shear_factor_difference
from tests.reference.golden import CALIBRATION, LAWS, Golden, golden_values, viscosity_at


@pytest.mark.parametrize("golden", list(golden_values()), ids=lambda golden: golden.name)
def test_golden_value(golden: Golden) -> None:
    assert golden.here == pytest.approx(golden.expected, abs=golden.tolerance)


def test_shear_factor_has_the_papers_thresholds() -> None:
    assert shear_factor_difference(1.1206) == pytest.approx(0.6, abs=1e-4)
    assert shear_factor_difference(1.4220) == pytest.approx(0.85, abs=1e-4)
    assert shear_factor_difference(2.841) == pytest.approx(0.8590, abs=5e-5)


@pytest.mark.parametrize(("temperature_degc", "expected_pa_s"), [(40, 25.5e-3), (90, 6.424e-3), (100, 5.31e-3)])
def test_viscosity(temperature_degc: float, expected_pa_s: float) -> None:
    assert viscosity_at(temperature_degc) == pytest.approx(expected_pa_s, rel=2e-3)


def test_geometry_factors() -> None:
    first, second = LAWS
    assert first.squeeze_factor_m2 == pytest.approx(2.56171566e-4, rel=1e-8)
    assert (first.contact_factor_m3, second.contact_factor_m3) == pytest.approx((5.16434e-3, 3.64056e-3), rel=2e-6)
    assert (first.viscous_factor_m4, second.viscous_factor_m4) == pytest.approx((4.15893e-4, 2.21007e-4), rel=2e-6)


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
    assert mean == pytest.approx(law_clutch.faces.squeeze_factor_m2, rel=1e-7)
