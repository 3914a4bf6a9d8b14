import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ecu_emulator.plant.course import DriveSettings, FrictionFactors
from ecu_emulator.plant.state import Col
from tests.support.cycles import (
    CASE_1,
    CASE_2,
    CYCLE_SHIFTS,
    IDEAL,
    FloatArray,
    drive_rows,
    powertrain,
    shifts,
    slip_rad_s,
)

DRIVE = DriveSettings(seed=3, vary_ratio=0.05)
STRETCH_S = 3.0
SEEDS = (1, 2, 3, 4, 5)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 900), max_size=8))
def test_rows_do_not_depend_on_how_the_drive_is_cut(chunks_ms: list[int]) -> None:
    train = powertrain(DRIVE)
    pieces = [train.advance(chunk / 1000.0) for chunk in chunks_ms]
    pieces.append(train.advance(STRETCH_S))
    rows = np.concatenate(pieces)
    whole = drive_rows(DRIVE)
    assert np.array_equal(rows, whole[: len(rows)])


@pytest.mark.parametrize("fluid", [IDEAL, CASE_1, CASE_2], ids=["ideal", "case 1", "case 2"])
@pytest.mark.parametrize("seed", SEEDS)
def test_every_seed_and_fluid_drives_the_whole_cycle(seed: int, fluid: FrictionFactors) -> None:
    rows = drive_rows(DriveSettings(seed=seed, vary_ratio=0.05, friction_factors=(fluid,)))
    assert shifts(rows) == CYCLE_SHIFTS
    assert np.isfinite(rows).all()
    assert np.abs(rows[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]]).max() < 350.0
    assert dissipated_w(rows).min() > -1.0  # what slip is left in a locked clutch fades


def dissipated_w(rows: FloatArray) -> FloatArray:
    power = np.stack([rows[:, Col.CLUTCH1_TORQUE + k] * slip_rad_s(rows, k + 1) for k in range(2)])
    is_slipping = rows[:, [Col.STICK1, Col.STICK2]].T == 0
    result: FloatArray = np.where(is_slipping, power, 0.0)
    return result
