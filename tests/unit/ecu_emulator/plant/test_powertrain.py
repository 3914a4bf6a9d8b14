"""The nominal cycle, row by row, against what the shift control is meant to do."""

import numpy as np
import pytest

from ecu_emulator.plant import Col, DriveSettings, FrictionFactors, Powertrain
from tests.support.cycles import CYCLE_SHIFTS, FloatArray, powertrain, shifts, slip_rad_s

NOMINAL = DriveSettings()
SHORT_S = 4.0


@pytest.fixture(scope="module")
def rows(driven_cycle: tuple[Powertrain, FloatArray]) -> FloatArray:
    _, rows = driven_cycle
    return rows


def test_a_cycle_has_ten_shifts(rows: FloatArray) -> None:
    assert shifts(rows) == CYCLE_SHIFTS


def test_a_drive_ends_and_stays_ended(driven_cycle: tuple[Powertrain, FloatArray]) -> None:
    assert not powertrain(NOMINAL).finished
    train, rows = driven_cycle
    assert train.finished
    assert train.time_s == len(rows) / 1000.0
    assert train.advance(1.0).shape == (0, len(Col))


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


def test_a_locked_clutch_stays_within_its_capacity(rows: FloatArray) -> None:
    held = (rows[:, Col.SHIFT_PHASE] == 0) & (rows[:, Col.STICK1] == 1)
    assert (np.abs(rows[held, Col.CLUTCH1_TORQUE]) < rows[held, Col.TORQUE1_COMMAND]).all()


def test_the_clutch_of_the_gear_is_locked_while_nothing_shifts(rows: FloatArray) -> None:
    steady = (rows[:, Col.SHIFT_PHASE] == 0) & (rows[:, Col.T_S] > 0.1)
    is_odd = rows[:, Col.CURRENT_GEAR] % 2 == 1
    assert (rows[steady & is_odd, Col.STICK1] == 1).all()
    assert (rows[steady & ~is_odd, Col.STICK2] == 1).all()


def test_preselection_passes_through_neutral(rows: FloatArray) -> None:
    preselected = rows[:, Col.PRESELECTED_GEAR]
    changes = preselected[np.flatnonzero(np.diff(preselected)) + 1].astype(int).tolist()
    # 2nd is ready from the start; after every upshift the gear left stays in until neutral and the next one.
    assert changes[:3] == [1, 0, 3]
    assert changes.count(0) == 8  # 1st to 6th and back need eight changes of the idle shaft


def test_friction_ages_from_cycle_to_cycle() -> None:
    aged = FrictionFactors(mu_c1=0.9, mu_s1=1.1, mu_c2=0.8, mu_s2=1.2)
    rows = powertrain(DriveSettings(cycles=2, friction_factors=(FrictionFactors(), aged))).advance(48.0)
    assert shifts(rows) == [*CYCLE_SHIFTS, (1, 2), (2, 3)]
    columns = [Col.MU_C1, Col.MU_S1, Col.MU_C2, Col.MU_S2]
    assert rows[0, columns] == pytest.approx([0.140, 0.119, 0.140, 0.119])
    assert rows[-1, columns] == pytest.approx([0.126, 0.1309, 0.112, 0.1428])
