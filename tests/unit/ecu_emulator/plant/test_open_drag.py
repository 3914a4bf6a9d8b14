"""The drag of a clutch between open and closed: bounded in the cold, the film law where the pack is closed."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import viscous_torque_nm
from ecu_emulator.plant import DriveSettings, nominal_parameters
from ecu_emulator.plant import state as at
from ecu_emulator.plant.clutch import refresh_contact, viscous_nm
from ecu_emulator.plant.course import as_record
from ecu_emulator.plant.powertrain import drive_law

LAW = as_record(drive_law(nominal_calibration(), nominal_parameters(), DriveSettings()).plant.clutches.first)
OPEN_M = LAW.film.open_gap_m
COLD_PA_S = 0.51
PEAK_NM = 8.0


def drag_nm(film_m: float, slip_rad_s: float, *, peak_nm: float = PEAK_NM, viscosity: float = COLD_PA_S) -> float:
    y, u = np.zeros(at.STATE_COUNT), np.zeros(at.INPUT_COUNT)
    y[at.FILM], y[at.W_H] = film_m, slip_rad_s
    u[at.VISCOSITY], u[at.OPEN_DRAG] = viscosity, peak_nm
    refresh_contact(y, 0, LAW)
    return float(viscous_nm(y, u, 0, LAW))


@pytest.mark.parametrize("slip_rad_s", [1.0, 30.0, 85.0, 120.0, 400.0, 600.0])
def test_an_open_pack_never_drags_more_than_its_peak(slip_rad_s: float) -> None:
    assert 0.0 < drag_nm(OPEN_M, slip_rad_s) <= PEAK_NM
    assert drag_nm(OPEN_M, -slip_rad_s) == -drag_nm(OPEN_M, slip_rad_s)
    assert viscous_torque_nm(85.0, OPEN_M, COLD_PA_S, LAW.film) > 100.0  # what the film law would say


def test_without_a_peak_the_film_law_holds_for_open_packs_too() -> None:
    assert drag_nm(OPEN_M, 85.0, peak_nm=0.0) == viscous_torque_nm(85.0, OPEN_M, COLD_PA_S, LAW.film)
    assert drag_nm(OPEN_M, 0.0) == 0.0
