"""Nominal shift cycles of the plant, driven once per settings and shared by the tests."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant.course import DriveSettings, FrictionFactors
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col

FloatArray = npt.NDArray[np.float64]

IDEAL = FrictionFactors()
CASE_1 = FrictionFactors(mu_c1=0.95, mu_s1=1.05, mu_c2=0.95, mu_s2=1.05)
CASE_2 = FrictionFactors(mu_c1=0.85, mu_s1=1.15, mu_c2=0.85, mu_s2=1.15)
CYCLE_SHIFTS = [(1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 5), (5, 4), (4, 3), (3, 2), (2, 1)]
LONGEST_CYCLE_S = 80.0


def powertrain(drive: DriveSettings, *, is_audited: bool = False) -> Powertrain:
    train = Powertrain(nominal_calibration(), nominal_parameters(), drive)
    if is_audited:
        train.audit()
    return train


@lru_cache(maxsize=8)
def drive_rows(drive: DriveSettings) -> FloatArray:
    """Return all rows of a drive on nominal parameters; read only."""
    rows = powertrain(drive).advance(drive.cycles * LONGEST_CYCLE_S)
    rows.flags.writeable = False
    return rows


def shifts(rows: FloatArray) -> list[tuple[int, int]]:
    """Return the completed shifts as (from, to)."""
    gears = rows[:, Col.CURRENT_GEAR].astype(int)
    changes = np.flatnonzero(np.diff(gears))
    return [(int(gears[index]), int(gears[index + 1])) for index in changes]


def slip_rad_s(rows: FloatArray, clutch: int) -> FloatArray:
    """Return the slip of clutch 1 or 2."""
    slip: FloatArray = rows[:, Col.HUB_SPEED] - rows[:, Col.INPUT1_SPEED + clutch - 1]
    return slip
