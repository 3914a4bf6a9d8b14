"""The nominal cycle, row by row, against what the shift control is meant to do."""

import numpy as np
import pytest

from ecu_emulator.plant import Col, DriveSettings, Powertrain
from tests.support.cycles import CYCLE_SHIFTS, FloatArray, powertrain

SHORT_S = 4.0


@pytest.fixture(scope="module")
def rows(driven_cycle: tuple[Powertrain, FloatArray]) -> FloatArray:
    _, rows = driven_cycle
    return rows


def test_the_same_seed_gives_the_same_drive_to_the_bit() -> None:
    drive = DriveSettings(seed=7, vary_ratio=0.05)
    first, second = (powertrain(drive).advance(SHORT_S) for _ in range(2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, powertrain(DriveSettings(seed=8, vary_ratio=0.05)).advance(SHORT_S))


def test_the_target_leads_the_current_gear_through_a_shift(rows: FloatArray) -> None:
    is_shifting = rows[:, Col.TARGET_GEAR] != rows[:, Col.CURRENT_GEAR]
    assert np.array_equal(is_shifting, rows[:, Col.SHIFT_PHASE] > 0)
    assert (rows[is_shifting, Col.PRESELECTED_GEAR] == rows[is_shifting, Col.TARGET_GEAR]).all()
    phases = rows[np.flatnonzero(np.diff(rows[:, Col.SHIFT_PHASE])) + 1, Col.SHIFT_PHASE]
    assert phases.tolist() == [1, 2, 3, 4, 0] * len(CYCLE_SHIFTS)
