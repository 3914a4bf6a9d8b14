"""Which clutch carries a gear, and units."""

import pytest

from clutch_model.calibration import clutch_of_gear
from ecu_emulator.shift_control.tcu import clutch_of


@pytest.mark.parametrize(("gear", "clutch"), [(1, 1), (2, 2), (3, 1), (4, 2), (5, 1), (6, 2), (7, 1), (8, 2), (0, 2)])
def test_clutch_1_carries_the_odd_gears(gear: int, clutch: int) -> None:
    assert clutch_of_gear(gear) == clutch
    assert clutch_of(gear) == clutch - 1  # the place in pairs, as the compiled control takes it
