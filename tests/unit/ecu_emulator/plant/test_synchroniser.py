"""Engaging a gear: the sleeve goes through at low slip, and no momentum is lost."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant import DriveSettings, nominal_parameters
from ecu_emulator.plant import state as at
from ecu_emulator.plant.course import as_record
from ecu_emulator.plant.driveline import ENGAGED, SYNCHRONISING
from ecu_emulator.plant.integration import close_synchronisers
from ecu_emulator.plant.powertrain import drive_law
from tests.support.cycles import FloatArray

LAW = as_record(drive_law(nominal_calibration(), nominal_parameters(), DriveSettings()))
GEARS = (3, 4)  # 3rd engaged on the odd shaft, 4th to be engaged on the even one
NO_ACCOUNT = np.zeros(0)


def arrays(slip_rad_s: float) -> tuple[FloatArray, FloatArray, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    y, u, modes = np.zeros(at.STATE_COUNT), np.zeros(at.INPUT_COUNT), np.zeros(at.MODE_COUNT, np.int64)
    u[at.RATIO : at.RATIO + 2] = [LAW.overall_ratios[gear] for gear in GEARS]
    y[at.W_D] = 40.0
    y[at.W_G : at.W_G + 2] = u[at.RATIO : at.RATIO + 2] * y[at.W_D]
    y[at.W_G + 1] -= slip_rad_s
    modes[at.LINK : at.LINK + 2] = (ENGAGED, SYNCHRONISING)
    return y, u, modes


def output_momentum(y: FloatArray, u: FloatArray) -> float:
    shafts = (LAW.plant.shafts.first, LAW.plant.shafts.second)
    geared = sum(u[at.RATIO + k] * shafts[k].gear_inertia_kg_m2 * y[at.W_G + k] for k in range(2))
    return float(LAW.plant.output.inertia_kg_m2 * y[at.W_D] + geared)


def test_a_gear_engages_without_losing_momentum() -> None:
    y, u, modes = arrays(slip_rad_s=0.3)
    before = output_momentum(y, u)
    close_synchronisers(y, u, modes, NO_ACCOUNT, LAW.plant)
    assert modes[at.LINK + 1] == ENGAGED
    assert output_momentum(y, u) == pytest.approx(before, rel=1e-14)
    assert y[at.W_G : at.W_G + 2] == pytest.approx(u[at.RATIO : at.RATIO + 2] * y[at.W_D], rel=1e-14)
