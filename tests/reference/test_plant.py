"""The nominal cycle against an independent implementation, and the error of the integration (docs/model.md)."""

from typing import Final

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import shipped_calibration
from ecu_emulator.plant.course import DriveSettings
from ecu_emulator.plant.driveline import converter_law, impeller_torque_nm, torque_ratio
from ecu_emulator.plant.state import Col
from tests.support.cycles import CYCLE_SHIFTS, drive_rows, powertrain, shifts

COMPARED_S = 10.0
STEPS_S = [2.5e-4, 2.0e-4, 1.0e-4]


# MathWorks, "Modeling an Automatic Transmission Controller": speed ratio, K factor [rpm per root lb ft], torque ratio.
PUBLIC: Final = np.array([
    (0.0, 137.47, 2.232), (0.1, 137.07, 2.075), (0.2, 135.86, 1.975), (0.3, 135.66, 1.846), (0.4, 137.57, 1.720),
    (0.5, 140.37, 1.564), (0.6, 145.27, 1.409), (0.7, 152.87, 1.254), (0.8, 162.98, 1.096), (0.85, 172.78, 1.012),
    (0.9, 197.69, 0.999), (0.92, 215.90, 1.001), (0.94, 244.52, 1.002),
])  # fmt: skip


def characteristic() -> FloatArray:
    """Return rows of speed ratio, torque of the impeller over that at stall, torque ratio; beyond 1 the overrun."""
    law = converter_law(shipped_calibration("lockup").converter)
    places = np.linspace(0.0, 1.15, 116)
    stall_nm = impeller_torque_nm(1.0, 0.0, law)
    return np.array(
        [(one, impeller_torque_nm(1.0, one, law) / stall_nm, torque_ratio(1.0, one, law)) for one in places]
    )


def public_capacity() -> FloatArray:
    """Return the public converter's torque of the impeller over that at stall: it goes with the K factor's square."""
    capacity: FloatArray = (PUBLIC[0, 1] / PUBLIC[:, 1]) ** 2
    return capacity


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
