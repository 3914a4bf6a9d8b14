"""Derivatives of a film: each is what a small change of its cause makes of the film, and no film of its own."""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, nominal_calibration
from clutch_model.pack import film_law, piston_pressure_pa
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


def test_an_open_pack_answers_to_its_oil_only() -> None:
    still, warm_k = replace(PLAIN, piston_pa=np.zeros_like(GRID)), np.full_like(GRID, 350.0)
    found = tangents(still, warm_k, 1.0)
    assert np.array_equal(found, tangents(still, warm_k, 0.0))
    others = [cause for cause in FilmCause if cause is not FilmCause.VISCOSITY]
    assert not found[:, others].any()
    assert (found[:, FilmCause.VISCOSITY] > 0.0).all()


def test_some_rows_are_those_of_the_whole() -> None:
    warm_k = np.full_like(GRID, 350.0)
    whole = tangents(PLAIN, warm_k, 0.01, slice(0, 400))
    for first in (100, 101, 102, 350):
        assert np.array_equal(tangents(PLAIN, warm_k, 0.01, slice(first, 400)), whole[first:])


def test_a_pack_that_is_let_go_answers_alike_wherever_a_step_meets_its_touch_point() -> None:
    """The rate jumps there: a difference across it had said a thousand times as much and more."""
    falling_pa = np.interp(GRID, [0.0, 0.1, 0.15, 1.8], [4.0e5, 4.0e5, 0.0, 0.0])
    touch_pa = piston_pressure_pa(0.0, film_law(CALIBRATION.clutches[1]))
    middle_pa = 0.5 * (falling_pa[:-1] + falling_pa[1:])
    last = int(np.flatnonzero(middle_pa > touch_pa)[-1])
    warm_k = np.full_like(GRID, 350.0)
    answers = []
    for over_pa in (-200.0, -5.0, 5.0, 200.0):
        moved = replace(PLAIN, piston_pa=falling_pa + touch_pa + over_pa - middle_pa[last])
        answers.append(np.abs(tangents(moved, warm_k, 0.01)[last + 5 :]).max(axis=0))
    assert (np.max(answers, axis=0) < 2.0 * np.min(answers, axis=0)).all()
