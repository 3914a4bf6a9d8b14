"""Which clutch carries a gear, and units."""

from collections.abc import Callable

import numpy as np
import pytest

from clutch_model import units
from clutch_model.calibration import clutch_of_gear
from ecu_emulator.shift_control.tcu import clutch_of


@pytest.mark.parametrize(("gear", "clutch"), [(1, 1), (2, 2), (3, 1), (4, 2), (5, 1), (6, 2), (7, 1), (8, 2), (0, 2)])
def test_clutch_1_carries_the_odd_gears(gear: int, clutch: int) -> None:
    assert clutch_of_gear(gear) == clutch
    assert clutch_of(gear) == clutch - 1  # the place in pairs, as the compiled control takes it


@pytest.mark.parametrize(
    ("convert", "value", "expected"),
    [
        (units.rad_s_from_rpm, 60.0, 2.0 * np.pi),
        (units.rpm_from_rad_s, np.pi, 30.0),
        (units.pa_from_bar, 1.35, 135_000.0),
        (units.bar_from_pa, 101_325.0, 1.01325),
        (units.k_from_degc, -40.0, 233.15),
        (units.degc_from_k, 363.15, 90.0),
        (units.m_s_from_km_h, 36.0, 10.0),
        (units.km_h_from_m_s, 1.0, 3.6),
    ],
)
def test_known_values(convert: Callable[[float], float], value: float, expected: float) -> None:
    assert convert(value) == pytest.approx(expected, rel=1e-12)
