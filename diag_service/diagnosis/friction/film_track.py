"""The oil film of a clutch followed forward through an event from measured pressure and slip."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel
from clutch_model.calibration import Calibration
from clutch_model.film import (
    FilmLaw,
    applied_pressure_pa,
    equilibrium_film_m,
    film_law,
    piston_pressure_pa,
    shear_factor_difference,
    sheared_torque_nm,
)
from clutch_model.film_points import FilmPoint, film_point, point_rate_m_s, point_slope_1_s
from clutch_model.friction import FrictionLaw, contact_torque_nm, friction_law, kinetic_friction
from clutch_model.thermal import clutch_heating_rate_k_s
from clutch_model.viscosity import viscosity_pa_s
from diag_service.diagnosis.alignment import GRID_S

COARSE = 3  # points of the grid: steps in which a film may be followed whose derivatives alone are wanted
_ANY_K = 350.0
DRAG_LIMIT_NM = 8.0  # of an open pack: its oil is full of air, so the law of a full film ends there
_CONTACT_END = 4.0  # film over roughness from which no asperities touch: a pack begins to be open
_TIMING_S = 0.015  # by how much earlier or later than its pressure says a film may close or open
_HOVER_PA = 0.12e5  # so near its touch point a piston may press or not: nobody knows the film of an open pack
_DOUBT_RISE = 10.0  # by openness: how oil drags that fills with air, or gives it off


class HeatLaw(NamedTuple):
    """Viscosity and heat balance of one clutch in the form the kernels take."""

    a_pa_s: float
    b_k: float
    pole_k: float
    heat_capacity_j_k: float
    convection_w_k: float
    oil_k: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureDrive:
    """What drives the film of one clutch on the even grid."""

    piston_pa: FloatArray  # (n,)
    slip_rad_s: FloatArray  # (n,)
    oil_k: float
    clutch_k: float  # at the first point
    open_drag_ratio: float = 1.0  # of the drag of an open pack to what is believed


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmTrack:
    """Film of one clutch on the even grid."""

    contact_pa: FloatArray  # (n,) P_C
    viscous_nm: FloatArray  # (n,) T_V, sign of the slip
    open_nm: FloatArray  # (n,) the part of it that an open pack drags
    doubt_nm: FloatArray  # (n,) standard deviation of the rest of it: how far the film of a closing pack is not known
    clutch_k: FloatArray  # (n,) temperature of the pack
    final_clutch_k: float


class _Driven(NamedTuple):
    """A `PressureDrive` in the form the kernel takes."""

    piston_pa: FloatArray
    slip_rad_s: FloatArray
    start_k: float
    open_drag_ratio: float
    step_s: float


class _Rows(NamedTuple):
    """What the kernel fills of a `FilmTrack`."""

    contact_pa: FloatArray
    viscous_nm: FloatArray
    open_nm: FloatArray
    doubt_nm: FloatArray
    clutch_k: FloatArray


def integrate_film(
    clutch: int, drive: PressureDrive, calibration: Calibration, stop: int | None = None, step: int = 1
) -> FilmTrack:
    """Integrate film and pack temperature of clutch 1 or 2; docs/model.md eq. (7) and section "Thermal".

    The clutch starts in equilibrium: open, or pressed and at rest. Its heat uses the calibration's friction, which is
    near enough: 15 % of friction changes the pack by about one kelvin. ``stop`` is the number of grid points to
    integrate, by default all; the track is zero beyond them. ``step`` is the number of grid points from one step to the
    next; points between have what the one before them has.
    """
    nominal = calibration.clutches[clutch - 1]
    law = film_law(nominal)
    oil = calibration.viscosity
    heat = HeatLaw(
        a_pa_s=oil.a_pa_s,
        b_k=oil.b_k,
        pole_k=oil.pole_k,
        heat_capacity_j_k=float(nominal.thermal.heat_capacity_j_k),
        convection_w_k=float(nominal.thermal.convection_w_k),
        oil_k=drive.oil_k,
    )
    driven = _Driven(
        piston_pa=np.ascontiguousarray(drive.piston_pa[:stop:step]),
        slip_rad_s=np.ascontiguousarray(drive.slip_rad_s[:stop:step]),
        start_k=drive.clutch_k,
        open_drag_ratio=drive.open_drag_ratio,
        step_s=step * GRID_S,
    )
    found = np.empty((len(_Rows._fields), len(driven.piston_pa)))
    final_k = _integrate(driven, law, friction_law(nominal.friction), heat, _Rows(*found))
    length = len(drive.piston_pa)
    count = length if stop is None else min(stop, length)
    contact_pa, viscous_nm, open_nm, doubt_nm, clutch_k = _filled(found, step, count, length)
    return FilmTrack(
        contact_pa=contact_pa,
        viscous_nm=viscous_nm,
        open_nm=open_nm,
        doubt_nm=doubt_nm,
        clutch_k=clutch_k,
        final_clutch_k=final_k,
    )


def _filled(found: FloatArray, step: int, count: int, length: int) -> FloatArray:
    """Return rows on a coarse grid, shape (rows, n), on the even grid, zero beyond ``count`` points."""
    if step == 1 and count == length:
        return found
    whole = np.zeros((len(found), length))
    whole[:, :count] = np.repeat(found, step, axis=1)[:, :count]
    return whole


def compile_film(calibration: Calibration) -> None:
    """Have everything compiled before the first shift comes: it must not wait for it."""
    still = PressureDrive(piston_pa=np.zeros(2), slip_rad_s=np.zeros(2), oil_k=_ANY_K, clutch_k=_ANY_K)
    integrate_film(1, still, calibration)


@array_kernel
def _integrate(driven: _Driven, law: FilmLaw, friction: FrictionLaw, heat: HeatLaw, rows: _Rows) -> float:
    piston_pa, slip_rad_s = driven.piston_pa, driven.slip_rad_s
    per_roughness_1_m, per_step_1_s = 1.0 / law.roughness_m, 1.0 / driven.step_s
    film_m = equilibrium_film_m(applied_pressure_pa(piston_pa[0], law), law)
    point, shear = film_point(film_m, law), shear_factor_difference(film_m * per_roughness_1_m)
    clutch_k, film_rate_1_s = driven.start_k, 0.0
    for k in range(len(piston_pa)):
        rows.clutch_k[k] = clutch_k
        viscosity = viscosity_pa_s(clutch_k, heat.a_pa_s, heat.b_k, heat.pole_k)
        slip = slip_rad_s[k]
        open_nm, viscous_nm = open_and_whole_nm(slip, film_m, viscosity, shear, driven.open_drag_ratio, law)
        rows.contact_pa[k], rows.viscous_nm[k], rows.open_nm[k] = point.contact_pa, viscous_nm, open_nm
        rows.doubt_nm[k] = _doubt(_openness(film_m, law), film_rate_1_s, piston_pa[k], law) * abs(viscous_nm - open_nm)
        power_w = 0.0
        if abs(slip) >= 1.0:  # slower is locked, or as good as; the noise of the slip would heat it
            contact_nm = 0.0
            if point.contact_pa > 0.0:
                mu = kinetic_friction(slip, friction)
                contact_nm = contact_torque_nm(1.0, mu, point.contact_pa, law.contact_factor_m3)
            power_w = (contact_nm + abs(viscous_nm)) * abs(slip)
        clutch_k += driven.step_s * clutch_heating_rate_k_s(
            power_w, clutch_k, heat.oil_k, heat.heat_capacity_j_k, heat.convection_w_k
        )
        if k + 1 < len(piston_pa):
            driving_pa = 0.5 * (piston_pa[k] + piston_pa[k + 1])
            if film_m < law.open_gap_m or applied_pressure_pa(driving_pa, law) > 0.0:  # else an open pack stays open
                film_m = _film_step(point, driving_pa, 1.0 / viscosity, law, driven.step_s)
                film_rate_1_s = abs(film_m - point.film_m) * (point.per_film_1_m * per_step_1_s)
                point, shear = film_point(film_m, law), shear_factor_difference(film_m * per_roughness_1_m)
    return clutch_k


@kernel
def open_and_whole_nm(
    slip_rad_s: float, film_m: float, viscosity: float, shear: float, open_drag_ratio: float, law: FilmLaw
) -> tuple[float, float]:
    """Return what an open pack drags [N m], and that with what the film of a closing one shears; "Cold oil"."""
    full_nm = sheared_torque_nm(slip_rad_s, film_m, viscosity, shear, law)
    openness = _openness(film_m, law)
    if openness == 0.0:
        return 0.0, full_nm
    open_nm = openness * open_drag_ratio * full_nm / math.sqrt(1.0 + (full_nm / DRAG_LIMIT_NM) ** 2)
    return open_nm, (1.0 - openness) * full_nm + open_nm


@kernel
def _doubt(openness: float, film_rate_1_s: float, piston_pa: float, law: FilmLaw) -> float:
    """Return the standard deviation of what a film shears, as a ratio to that torque; docs/model.md "Cold oil"."""
    if openness > 0.0 and abs(piston_pa - piston_pressure_pa(0.0, law)) < _HOVER_PA:
        return 1.0
    return min(_DOUBT_RISE * openness + _TIMING_S * film_rate_1_s, 1.0)


@kernel
def _openness(film_m: float, law: FilmLaw) -> float:
    """Return how far a pack is open: 0 as long as asperities touch, 1 at its open gap."""
    touching_m = _CONTACT_END * law.roughness_m
    return max(0.0, film_m - touching_m) * (1.0 / (law.open_gap_m - touching_m))


@kernel
def _film_step(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw, step_s: float) -> float:
    """Return the film one step later by the exponential Rosenbrock-Euler rule, exact for a linear rate."""
    reach = point_slope_1_s(point, piston_pa, fluidity, law) * step_s
    stretch = step_s if abs(reach) < 1e-6 else (math.exp(min(reach, 50.0)) - 1.0) * (step_s / reach)
    later_m = point.film_m + point_rate_m_s(point, piston_pa, fluidity, law) * stretch
    return min(max(later_m, law.min_film_m), law.open_gap_m)
