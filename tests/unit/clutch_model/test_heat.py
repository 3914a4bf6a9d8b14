import pytest

from clutch_model.pack import clutch_heating_rate_k_s, sump_heating_rate_k_s, viscosity_pa_s


def test_a_clutch_warms_with_its_friction_power() -> None:
    assert clutch_heating_rate_k_s(3000.0, 360.0, 360.0, 1500.0, 450.0) == pytest.approx(2.0)


def test_a_clutch_settles_where_convection_carries_the_power() -> None:
    assert clutch_heating_rate_k_s(4500.0, 370.0, 360.0, 1500.0, 450.0) == pytest.approx(0.0)


def test_the_sump_cools_towards_the_coolant() -> None:
    assert sump_heating_rate_k_s(0.0, 363.0, 353.0, 1.2e4, 120.0) == pytest.approx(-0.1)
    assert sump_heating_rate_k_s(1200.0, 363.0, 353.0, 1.2e4, 120.0) == pytest.approx(0.0)


def test_oil_thins_as_it_warms() -> None:
    cold, warm = (viscosity_pa_s(temperature_k, 1.55e-4, 689.0, 178.15) for temperature_k in (300.0, 360.0))
    assert cold > 5.0 * warm > 0.0
