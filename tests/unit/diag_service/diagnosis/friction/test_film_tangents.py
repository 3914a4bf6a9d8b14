"""Derivatives of a film: each is what a small change of its cause makes of the film, and no film of its own."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, nominal_calibration
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.film_tangents import FilmCause, film_tangents
from diag_service.diagnosis.friction.film_track import FilmTrack, PressureDrive, integrate_film
from diag_service.diagnosis.friction.parameters import STATE_COUNT, Considered, displaced
from diag_service.diagnosis.friction.posterior import Posterior

CALIBRATION: Final = nominal_calibration()
GRID: Final = GRID_S * np.arange(900.0)
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
    return integrate_film(2, drive, calibration)


@pytest.mark.parametrize("cause", FilmCause)
def test_a_derivative_is_what_a_small_change_makes(cause: FilmCause) -> None:
    plain = track(PLAIN, CALIBRATION)
    found = film_tangents(2, PLAIN, plain.clutch_k, CALIBRATION, len(GRID))
    size, change = CHANGES[cause]
    changed = track(*change(size))
    for name in ("contact_pa", "viscous_nm"):
        expected = (getattr(changed, name) - getattr(plain, name)) / size
        error = np.linalg.norm(getattr(found, name)[:, cause] - expected)
        assert error < 0.15 * np.linalg.norm(expected), name  # of steps of a millisecond, and of a third of that


def test_an_open_pack_answers_to_its_oil_only() -> None:
    still = replace(PLAIN, piston_pa=np.zeros_like(GRID))
    found = film_tangents(1, still, np.full_like(GRID, 350.0), CALIBRATION, len(GRID))
    assert not found.contact_pa.any()
    others = [cause for cause in FilmCause if cause is not FilmCause.VISCOSITY]
    assert not found.viscous_nm[:, others].any()
    assert (found.viscous_nm[:, FilmCause.VISCOSITY] > 0.0).all()


def test_nothing_is_said_beyond_the_end() -> None:
    found = film_tangents(1, PLAIN, np.full_like(GRID, 350.0), CALIBRATION, 400)
    assert found.contact_pa[:400].any()
    assert not found.contact_pa[400:].any()
    assert not found.viscous_nm[400:].any()
