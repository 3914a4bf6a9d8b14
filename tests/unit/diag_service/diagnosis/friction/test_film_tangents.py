"""Derivatives of a film: each is what a small change of its cause makes of the film, and no film of its own."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, nominal_calibration
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.evidence import STATE_COUNT, Considered, displaced
from diag_service.diagnosis.friction.film import (
    FilmCause,
    FilmTrack,
    PressureDrive,
    film_tangents,
    integrate_films,
    pack_laws,
)
from diag_service.diagnosis.friction.posterior import Posterior

CALIBRATION: Final = nominal_calibration()
GRID: Final = GRID_S * np.arange(900.0)
WHOLE: Final = slice(0, len(GRID))
STEP: Final = 1e-3
PLAIN: Final = PressureDrive(  # filled, loaded, led down again
    piston_pa=np.interp(GRID, [0.0, 0.1, 0.35, 0.6, 0.9], [0.0, 1.6e5, 4.0e5, 3.0e5, 3.4e5]),
    slip_rad_s=np.linspace(120.0, 10.0, len(GRID)),
    oil_k=350.0,
    clutch_k=360.0,
)

Change = Callable[[float], tuple[PressureDrive, Calibration]]


def of_pressure(piston_pa: FloatArray) -> tuple[PressureDrive, Calibration]:
    return replace(PLAIN, piston_pa=piston_pa), CALIBRATION


def of_law(parameter: Considered) -> Change:
    at = Posterior.fresh(CALIBRATION).base.mean
    place = np.arange(len(at)) == STATE_COUNT + parameter
    return lambda size: (PLAIN, displaced(CALIBRATION, at + size * place))


CHANGES: Final[dict[FilmCause, tuple[float, Change]]] = {
    FilmCause.PRESSURE: (100.0, lambda size: of_pressure(PLAIN.piston_pa + size)),
    FilmCause.PISTON_AREA: (STEP, lambda size: of_pressure(PLAIN.piston_pa * (1.0 + size))),
    FilmCause.PRESSURE_LATENCY: (STEP, lambda size: of_pressure(np.interp(GRID + size, GRID, PLAIN.piston_pa))),
    FilmCause.VISCOSITY: (STEP, of_law(Considered.VISCOSITY)),
    FilmCause.CONTACT_STIFFNESS: (STEP, of_law(Considered.CONTACT_STIFFNESS)),
    FilmCause.FILM_MOBILITY: (STEP, of_law(Considered.FILM_MOBILITY)),
}


def track(drive: PressureDrive, calibration: Calibration) -> FilmTrack:
    return integrate_films((drive, drive), pack_laws(calibration))[1]


def tangents(drive: PressureDrive, clutch_k: FloatArray, lever_m3: float, rows: slice = WHOLE) -> FloatArray:
    levers_m3 = np.full(rows.stop - rows.start, lever_m3)
    return film_tangents(pack_laws(CALIBRATION)[1], drive, clutch_k, rows, levers_m3)


@pytest.mark.parametrize("cause", FilmCause)
def test_a_derivative_is_what_a_small_change_makes(cause: FilmCause) -> None:
    plain = track(PLAIN, CALIBRATION)
    by_film_nm = tangents(PLAIN, plain.clutch_k, 0.0)
    found = {"contact_pa": tangents(PLAIN, plain.clutch_k, 1.0) - by_film_nm, "viscous_nm": by_film_nm}
    size, change = CHANGES[cause]
    changed = track(*change(size))
    for name, derivatives in found.items():
        expected = (getattr(changed, name) - getattr(plain, name)) / size
        error = np.linalg.norm(derivatives[:, cause] - expected)
        assert error < 0.15 * np.linalg.norm(expected), name  # of steps of a millisecond, and of a third of that
