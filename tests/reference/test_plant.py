"""The nominal cycle against an independent implementation, and the error of the integration (docs/model.md)."""

import numpy as np
import pytest

from studies.converter_picture import PUBLIC, characteristic, public_capacity
from ecu_emulator.plant import Col, DriveSettings
from tests.support.cycles import CYCLE_SHIFTS, drive_rows, powertrain, shifts

COMPARED_S = 10.0
STEPS_S = [2.5e-4, 2.0e-4, 1.0e-4]


def test_the_nominal_cycle_takes_as_long_as_the_reference() -> None:
    rows = drive_rows(DriveSettings())
    assert shifts(rows) == CYCLE_SHIFTS
    assert rows[-1, Col.T_S] == pytest.approx(42.9, abs=0.1)


@pytest.mark.parametrize("dt_s", STEPS_S)
def test_halving_the_step_changes_little(dt_s: float) -> None:
    coarse, fine = (powertrain(DriveSettings(dt_s=step)).advance(COMPARED_S) for step in (dt_s, dt_s / 2.0))
    change = np.abs(coarse - fine)
    assert change[:, Col.HUB_SPEED].max() < 0.02
    assert change[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]].max() < 0.3


def test_halving_the_step_changes_little_in_the_workshop() -> None:
    coarse, fine = (
        powertrain(DriveSettings(dt_s=step, open_revs=1, closed_revs=1)).advance(COMPARED_S)
        for step in (2.5e-4, 1.25e-4)
    )
    change = np.abs(coarse - fine)
    assert coarse[-1, Col.CURRENT_GEAR] == 1
    assert change[:, Col.HUB_SPEED].max() < 0.02
    assert change[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]].max() < 0.3


def test_the_torque_converter_is_like_a_public_one() -> None:
    place, capacity, ratio = characteristic().T
    assert np.interp(PUBLIC[:, 0], place, capacity) == pytest.approx(public_capacity(), abs=0.1)
    assert np.interp(PUBLIC[:, 0], place, ratio) == pytest.approx(PUBLIC[:, 2], abs=0.25)
