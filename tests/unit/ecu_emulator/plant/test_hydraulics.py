import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant.hydraulics import cavity_law, cavity_pressure_pa, closed_volume_m3, orifice_flow_m3_s
from ecu_emulator.plant.parameters import nominal_parameters

VALVE = nominal_parameters().hydraulics
CAVITY = cavity_law(nominal_calibration().clutches[0])


def test_an_empty_cavity_has_no_pressure() -> None:
    assert cavity_pressure_pa(0.0, CAVITY, VALVE) == 0.0


def test_pressure_is_continuous_where_the_pack_closes() -> None:
    full_m3 = CAVITY.full_volume_m3
    below, above = (cavity_pressure_pa(full_m3 * factor, CAVITY, VALVE) for factor in (1.0 - 1e-9, 1.0))
    assert above == CAVITY.touch_pressure_pa == pytest.approx(1.345e5, rel=1e-3)
    assert below == pytest.approx(above, rel=1e-6)


def test_a_filling_cavity_shows_its_spring() -> None:
    half_m3 = 0.5 * CAVITY.full_volume_m3
    expected_pa = (CAVITY.preload_n + CAVITY.spring_rate_n_m * 1.0e-3) / CAVITY.area_m2
    assert cavity_pressure_pa(half_m3, CAVITY, VALVE) == pytest.approx(expected_pa)


def test_a_closed_pack_is_stiff() -> None:
    volume_m3 = closed_volume_m3(10.0e5, CAVITY, VALVE)
    assert cavity_pressure_pa(volume_m3, CAVITY, VALVE) == pytest.approx(10.0e5)
    assert volume_m3 < 1.05 * CAVITY.full_volume_m3


def test_the_orifice_follows_the_square_root_far_from_zero() -> None:
    ratio = orifice_flow_m3_s(9.0e6, 0.0, VALVE) / orifice_flow_m3_s(2.25e6, 0.0, VALVE)
    assert ratio == pytest.approx(2.0, rel=0.01)
    assert orifice_flow_m3_s(1.0e5, 3.0e5, VALVE) == -orifice_flow_m3_s(3.0e5, 1.0e5, VALVE)
