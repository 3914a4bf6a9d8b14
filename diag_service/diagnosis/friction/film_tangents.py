"""How the film of a clutch answers to what moves or forms it: derivatives followed beside the film through an event."""

import math
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, unchecked_kernel
from clutch_model.calibration import Calibration
from clutch_model.film import (
    FilmLaw,
    applied_pressure_pa,
    equilibrium_film_m,
    film_law,
)
from clutch_model.film_points import FilmPoint, FilmShape, film_point, film_shape, point_motion, point_rate_m_s
from clutch_model.viscosity import viscosity_pa_s
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.film_track import COARSE, PressureDrive, open_and_whole_nm

_VISCOSITY_STEP: Final = 1e-4  # ratio
_PRESSURE_STEP_PA: Final = 10.0
_MOST_REACH: Final = 50.0
_QUIET: Final = 0.02  # of a film: what changes less in a step is followed in long ones


class FilmCause(IntEnum):
    """What a film answers to: the columns of its derivatives."""

    PRESSURE = 0  # [Pa] of the piston
    PISTON_AREA = 1  # ratio
    PRESSURE_LATENCY = 2  # [s]: the pressure was there earlier
    VISCOSITY = 3  # ratio
    CONTACT_STIFFNESS = 4  # ratio
    FILM_MOBILITY = 5  # natural logarithm of a ratio


_PRESSURE, _AREA, _LATENCY, _VISCOSITY, _STIFFNESS, _MOBILITY = (int(one) for one in FilmCause)


class _Oil(NamedTuple):
    """Vogel's law in the form the kernel takes."""

    a_pa_s: float
    b_k: float
    pole_k: float


class _Moved(NamedTuple):
    """What moves a film, in the form the kernel takes."""

    piston_pa: FloatArray
    slip_rad_s: FloatArray
    clutch_k: FloatArray
    open_drag_ratio: float


class _Answers(NamedTuple):
    """What the kernel fills from a row of the grid on, and what it works in."""

    first: int
    lever_m3: FloatArray  # (n,)
    torque_nm: FloatArray  # (n, len(FilmCause))
    contact: FloatArray  # (len(FilmCause),) of one row
    viscous: FloatArray  # (len(FilmCause),) likewise


def film_tangents(
    clutch: int, drive: PressureDrive, clutch_k: FloatArray, calibration: Calibration, rows: slice, lever_m3: FloatArray
) -> FloatArray:
    """Follow the film of clutch 1 or 2 with its derivatives; docs/model.md, "Estimator", section on derivatives.

    Parameters
    ----------
    clutch, drive, calibration
        As for `film_track.integrate_film`.
    clutch_k : (n,) array
        Temperature of the pack [K]; it is not changed by what moves the film, which is next to nothing.
    rows
        Of the grid, for which derivatives are wanted: ``count`` of them.
    lever_m3 : (count,) array
        Torque of the contact over its pressure on these rows.

    Returns
    -------
    (count, len(FilmCause)) array
        By how much contact and sheared film carry more [N m] per unit of every cause.
    """
    oil = calibration.viscosity
    moved = _Moved(
        piston_pa=np.ascontiguousarray(drive.piston_pa[: rows.stop]),
        slip_rad_s=np.ascontiguousarray(drive.slip_rad_s[: rows.stop]),
        clutch_k=np.ascontiguousarray(clutch_k[: rows.stop]),
        open_drag_ratio=drive.open_drag_ratio,
    )
    answers = _Answers(
        first=rows.start,
        lever_m3=np.ascontiguousarray(lever_m3),
        torque_nm=np.empty((rows.stop - rows.start, len(FilmCause))),
        contact=np.empty(len(FilmCause)),
        viscous=np.empty(len(FilmCause)),
    )
    law = film_law(calibration.clutches[clutch - 1])
    _follow(moved, law, film_shape(law), _Oil(oil.a_pa_s, oil.b_k, oil.pole_k), np.zeros(len(FilmCause)), answers)
    return answers.torque_nm


def compile_tangents(calibration: Calibration) -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    still, warm = np.zeros(2), np.full(2, 350.0)
    drive = PressureDrive(piston_pa=still, slip_rad_s=still, oil_k=350.0, clutch_k=350.0)
    film_tangents(1, drive, warm, calibration, slice(0, 2), still)


@array_kernel
def _follow(moved: _Moved, law: FilmLaw, shape: FilmShape, oil: _Oil, by: FloatArray, answers: _Answers) -> None:
    """Fill the answers; ``by`` are the derivatives of the film itself [m], zero at first."""
    film_m = equilibrium_film_m(applied_pressure_pa(moved.piston_pa[0], law), law)
    point = film_point(film_m, law, shape)
    count, k = len(moved.piston_pa), 0
    while k < count:
        viscosity = viscosity_pa_s(moved.clutch_k[k], oil.a_pa_s, oil.b_k, oil.pole_k)
        fluidity, points = 1.0 / viscosity, min(COARSE, count - 1 - k)
        if points > 1 and not _is_quiet(moved, k, points, point, fluidity, law):
            points = 1
        following = k + max(points, 1)
        if following > answers.first:
            _answer(moved, k, point, viscosity, law, by, answers.contact, answers.viscous)
            for row in range(max(k, answers.first) - answers.first, following - answers.first):
                for cause in range(len(by)):
                    by_contact = answers.lever_m3[row] * answers.contact[cause]
                    answers.torque_nm[row, cause] = by_contact + answers.viscous[cause]
        if points > 0:
            later_m = _step(moved, k, points, point, fluidity, law, by)
            if later_m != point.film_m:
                point = film_point(later_m, law, shape)
        k = following


@unchecked_kernel
def _is_quiet(moved: _Moved, k: int, points: int, point: FilmPoint, fluidity: float, law: FilmLaw) -> bool:
    """Return whether a film hardly changes over some points: then one step follows it."""
    driving_pa = 0.5 * (moved.piston_pa[k] + moved.piston_pa[k + points])
    rate = point_rate_m_s(point, driving_pa, fluidity, law)
    return abs(rate) * points * GRID_S < _QUIET * point.film_m


@unchecked_kernel
def _answer(
    moved: _Moved, k: int, point: FilmPoint, viscosity: float, law: FilmLaw, by: FloatArray, contact: FloatArray,
    viscous: FloatArray,
) -> None:  # fmt: skip
    """Set what contact and shear answer at one point."""
    slip, drag_ratio, film_m, step_m = moved.slip_rad_s[k], moved.open_drag_ratio, point.film_m, point.step_m
    _, whole_nm = open_and_whole_nm(slip, film_m, viscosity, point.shear, drag_ratio, law)
    _, thicker_nm = open_and_whole_nm(slip, film_m + step_m, viscosity, point.thicker_shear, drag_ratio, law)
    _, stiffer_nm = open_and_whole_nm(slip, film_m, viscosity * (1.0 + _VISCOSITY_STEP), point.shear, drag_ratio, law)
    by_film_pa_m = (point.thicker_contact_pa - point.contact_pa) / step_m
    by_film_n = (thicker_nm - whole_nm) / step_m
    for j in range(len(by)):
        contact[j] = by_film_pa_m * by[j]
        viscous[j] = by_film_n * by[j]
    contact[_STIFFNESS] += point.contact_pa
    viscous[_VISCOSITY] += (stiffer_nm - whole_nm) / _VISCOSITY_STEP


@unchecked_kernel
def _step(moved: _Moved, k: int, points: int, point: FilmPoint, fluidity: float, law: FilmLaw, by: FloatArray) -> float:
    """Return the film some points later [m], and set its derivatives: the same rule, linearised."""
    film_m = point.film_m
    before_pa, after_pa, step_s = moved.piston_pa[k], moved.piston_pa[k + points], points * GRID_S
    driving_pa = 0.5 * (before_pa + after_pa)
    if film_m >= law.open_gap_m and applied_pressure_pa(driving_pa, law) <= 0.0:
        by[:] = 0.0  # an open pack stays open
        return film_m
    rate, slope_1_s = point_motion(point, driving_pa, fluidity, law)
    reach = min(slope_1_s * step_s, _MOST_REACH)
    kept = math.exp(reach)
    stretch = step_s if abs(reach) < 1e-6 else step_s * (kept - 1.0) / reach
    later_m = film_m + rate * stretch
    if later_m < law.min_film_m or later_m > law.open_gap_m:
        by[:] = 0.0
        return min(max(later_m, law.min_film_m), law.open_gap_m)
    by_pa = 0.0  # where separators, not the piston, move the pack
    if applied_pressure_pa(driving_pa, law) > 0.0:  # the rate jumps there: no difference across it is a derivative
        pushed = point_rate_m_s(point, driving_pa + _PRESSURE_STEP_PA, fluidity, law)
        by_pa = (pushed - rate) / _PRESSURE_STEP_PA
    for j in range(len(by)):
        by[j] *= kept
    by[_PRESSURE] += stretch * by_pa
    by[_AREA] += stretch * by_pa * driving_pa
    by[_LATENCY] += stretch * by_pa * (after_pa - before_pa) / step_s
    if by_pa != 0.0:
        faster_m = step_s * kept * rate  # as if the step lasted longer
        by[_VISCOSITY] -= faster_m
        by[_MOBILITY] += faster_m
        by_applied = by_pa * law.lining_area_m2 / law.piston_area_m2
        by[_STIFFNESS] -= stretch * by_applied * point.contact_pa
    return later_m
