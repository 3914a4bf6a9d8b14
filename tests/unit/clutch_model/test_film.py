import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import (
    contact_pressure_pa,
    equilibrium_film_m,
    film_law,
    film_rate_m_s,
    shear_factor_difference,
    viscous_torque_nm,
)
from tests.support.film_laws import squeeze_rate_m_s

CLUTCH = nominal_calibration().clutches[0]
LAW = film_law(CLUTCH)
VISCOSITY = 6.4e-3


@pytest.mark.parametrize("applied_pa", [1e3, 1e4, 2.5e5, 6e5])
def test_equilibrium_film_carries_the_load(applied_pa: float) -> None:
    film_m = equilibrium_film_m(applied_pa, LAW)
    assert contact_pressure_pa(film_m, LAW) == pytest.approx(applied_pa, rel=1e-9)
    assert squeeze_rate_m_s(film_m, applied_pa, VISCOSITY, LAW) == pytest.approx(0.0, abs=1e-12)


def test_a_closed_pack_opens_no_faster_than_an_open_one() -> None:
    film_m = 3.0 * LAW.roughness_m
    free_m_s = (LAW.open_gap_m - film_m) / LAW.separation_time_s
    thin_oil = 1e-6
    assert film_rate_m_s(film_m, 0.0, thin_oil, True, LAW) == pytest.approx(free_m_s)


def test_separator_springs_slow_the_squeeze() -> None:
    film_m, applied_pa = 40e-6, 1e5
    without = squeeze_rate_m_s(film_m, applied_pa, VISCOSITY, LAW)
    with_springs = film_rate_m_s(film_m, applied_pa, VISCOSITY, True, LAW)
    assert without < with_springs < 0.0
    left_pa = applied_pa - LAW.separation_pressure_pa * (1.0 - film_m / LAW.open_gap_m)
    assert with_springs == pytest.approx(without * left_pa / applied_pa, rel=1e-12)


def test_shear_factor_is_that_of_a_smooth_film_when_wide_open() -> None:
    assert shear_factor_difference(LAW.open_gap_m / LAW.roughness_m) == pytest.approx(1.0, abs=5e-3)
    assert shear_factor_difference(61.0) == 1.0


def test_viscous_torque_is_that_of_sheared_plates() -> None:
    film_m, slip_rad_s = 100e-6, 50.0
    smooth_nm = LAW.viscous_factor_m4 * VISCOSITY * slip_rad_s / film_m
    assert viscous_torque_nm(slip_rad_s, film_m, VISCOSITY, LAW) == pytest.approx(smooth_nm, rel=0.01)
    assert viscous_torque_nm(-slip_rad_s, film_m, VISCOSITY, LAW) == -viscous_torque_nm(
        slip_rad_s, film_m, VISCOSITY, LAW
    )
