"""The nominal cycle, row by row, against what the shift control is meant to do."""

import numpy as np
import pytest

from ecu_emulator.plant import Col, DriveSettings, FrictionFactors, Powertrain
from tests.support.cycles import CYCLE_SHIFTS, FloatArray, powertrain, shifts, slip_rad_s

SHORT_S = 4.0


@pytest.fixture(scope="module")
def rows(driven_cycle: tuple[Powertrain, FloatArray]) -> FloatArray:
    _, rows = driven_cycle
    return rows


def test_a_cycle_has_ten_shifts(rows: FloatArray) -> None:
    assert shifts(rows) == CYCLE_SHIFTS


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


def test_a_locked_clutch_does_not_slip(rows: FloatArray) -> None:
    for clutch in (1, 2):
        stuck = rows[:, Col.STICK1 + clutch - 1] == 1
        assert stuck.any()
        assert np.abs(slip_rad_s(rows, clutch)[stuck]).max() <= 0.1 + 1e-6


def test_friction_ages_from_cycle_to_cycle() -> None:
    aged = FrictionFactors(mu_c1=0.9, mu_s1=1.1, mu_c2=0.8, mu_s2=1.2)
    rows = powertrain(DriveSettings(cycles=2, friction_factors=(FrictionFactors(), aged))).advance(48.0)
    assert shifts(rows) == [*CYCLE_SHIFTS, (1, 2), (2, 3)]
    columns = [Col.MU_C1, Col.MU_S1, Col.MU_C2, Col.MU_S2]
    assert rows[0, columns] == pytest.approx([0.140, 0.119, 0.140, 0.119])
    assert rows[-1, columns] == pytest.approx([0.126, 0.1309, 0.112, 0.1428])
