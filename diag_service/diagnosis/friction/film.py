"""The oil film of both packs over an event, and how it answers to all that moves or forms it."""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, NamedTuple, Self

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel, part
from clutch_model.calibration import Calibration, InputSide, SensorBias, SensorNoise, TorqueSource, both_clutches
from clutch_model.errors import CalibrationError
from clutch_model.pack import (
    CONTACT_END,
    FilmLaw,
    FilmPoint,
    FrictionLaw,
    applied_pressure_pa,
    clutch_heating_rate_k_s,
    contact_levers_m3,
    contact_pressure_pa,
    contact_torque_nm,
    equilibrium_film_m,
    film_law,
    film_point,
    friction_law,
    kinetic_friction,
    piston_pressure_pa,
    point_motion,
    point_rate_m_s,
    shear_factor_difference,
    sheared_torque_nm,
    thicker_m,
    viscosity_pa_s,
)
from diag_service.diagnosis.alignment import GRID_S
from diag_service.diagnosis.friction.evidence import STATE_COUNT, Considered, State

COARSE = 2  # points of the grid: steps in which a film may be followed whose derivatives alone are wanted
DRAG_LIMIT_NM = 8.0  # of an open pack: its oil is full of air, so the law of a full film ends there
_TIMING_S = 0.015  # by how much earlier or later than its pressure says a film may close or open
_HOVER_PA = 0.12e5  # so near its touch point a piston may press or not: nobody knows the film of an open pack
_DOUBT_RISE = 10.0  # by openness: how oil drags that fills with air, or gives it off
SIGN_WIDTH_RAD_S = 0.5  # near lock the sign of the slip fades with it, and so does its noise


class _Oil(NamedTuple):
    """Vogel's law in the form the kernel takes."""

    a_pa_s: float
    b_k: float
    pole_k: float


class PackLaw(NamedTuple):
    """What a calibration says of one clutch and its oil, in the form the kernels take."""

    film: FilmLaw
    friction: FrictionLaw
    oil: _Oil
    heat_capacity_j_k: float
    convection_w_k: float
    touch_pressure_pa: float  # of the piston, at which the pack just closes
    squeeze_factor_m2: float  # of its faces; that of ``film`` is divided by the mobility ratio
    mobility_ratio: float  # of the film's rate to what its surface says


PackLaws = tuple[PackLaw, PackLaw]


class VehicleLaws(NamedTuple):
    """What the balance of an event needs to know of a vehicle."""

    packs: PackLaws
    input_side: InputSide
    bias: SensorBias
    noise: SensorNoise
    torque: TorqueSource

    @classmethod
    def of(cls, calibration: Calibration) -> Self:
        """Return the laws of a vehicle as its calibration has them."""
        return cls(
            packs=pack_laws(calibration),
            input_side=calibration.input_side,
            bias=calibration.bias,
            noise=calibration.noise,
            torque=calibration.torque,
        )

    def displaced(self, mean: FloatArray) -> Self:
        """Return the laws at other values of all parameters, shape (PARAMETER_COUNT,).

        States are errors of sensors, considered parameters displacements from these laws. Springs stay, so touch
        pressures move with piston areas. Raises CalibrationError if no vehicle is like that.
        """
        by, side, bias, packs = mean[STATE_COUNT:].tolist(), self.input_side, self.bias, []
        shafts_ratio = 1.0 + by[Considered.SHAFT_INERTIA]
        for m, law in enumerate(self.packs):
            film, curve, oil = law.film, law.friction, law.oil
            area_m2 = film.piston_area_m2 * (1.0 + by[Considered.PISTON_AREA1 + m])
            stiffness_pa = film.contact_stiffness_pa * (1.0 + by[Considered.CONTACT_STIFFNESS])
            mobility_ratio = law.mobility_ratio * math.exp(by[Considered.FILM_MOBILITY])
            speed_rad_s = curve.stribeck_speed_rad_s * (1.0 + by[Considered.STRIBECK_SPEED])
            exponent = curve.stribeck_exponent * math.exp(by[Considered.STRIBECK_EXPONENT])
            a_pa_s = oil.a_pa_s * (1.0 + by[Considered.VISCOSITY])
            positive = area_m2, stiffness_pa, mobility_ratio, speed_rad_s, exponent, a_pa_s
            if not (min(positive) > 0.0 and math.isfinite(sum(positive))):
                raise CalibrationError(f"areas, stiffnesses, speeds and viscosities must be > 0 and finite: {positive}")
            film = film._replace(
                piston_area_m2=area_m2,
                contact_stiffness_pa=stiffness_pa,
                squeeze_factor_m2=law.squeeze_factor_m2 / mobility_ratio,
            )
            curve = curve._replace(stribeck_speed_rad_s=speed_rad_s, stribeck_exponent=exponent)
            packs.append(
                law._replace(
                    film=film,
                    friction=curve,
                    oil=oil._replace(a_pa_s=a_pa_s),
                    touch_pressure_pa=piston_pressure_pa(0.0, film),
                    mobility_ratio=mobility_ratio,
                )
            )
        inertias_kg_m2 = side.input_shaft_inertias_kg_m2
        return self._replace(
            packs=(packs[0], packs[1]),
            input_side=replace(
                side,
                engine_inertia_kg_m2=side.engine_inertia_kg_m2 * (1.0 + by[Considered.ENGINE_INERTIA]),
                input_shaft_inertias_kg_m2=(inertias_kg_m2[0] * shafts_ratio, inertias_kg_m2[1] * shafts_ratio),
            ),
            bias=SensorBias(
                torque_gain=bias.torque_gain + by[Considered.TORQUE_GAIN],
                motoring_gain=bias.motoring_gain + by[Considered.MOTORING_GAIN],
                torque_latency_s=bias.torque_latency_s + by[Considered.TORQUE_LATENCY],
                pressure_latency_s=bias.pressure_latency_s + by[Considered.PRESSURE_LATENCY],
                torque_offset_nm=float(mean[State.TORQUE_OFFSET]),
                touch_offsets_pa=(float(mean[State.TOUCH1]), float(mean[State.TOUCH2])),
                pressure_zeros_pa=(float(mean[State.ZERO1]), float(mean[State.ZERO2])),
            ),
        )


class HeatLaw(NamedTuple):
    """Viscosity and heat balance of one clutch in the form the kernels take."""

    a_pa_s: float
    b_k: float
    pole_k: float
    heat_capacity_j_k: float
    convection_w_k: float
    oil_k: float
    start_k: float  # of the pack


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureDrive:
    """What drives the film of one clutch on the even grid."""

    piston_pa: FloatArray  # (n,)
    slip_rad_s: FloatArray  # (n,)
    oil_k: float
    clutch_k: float  # at the first point
    open_drag_ratio: float = 1.0  # of the drag of an open pack to what is believed


class FilmTrack(NamedTuple):
    """Film of one clutch on the even grid."""

    contact_pa: FloatArray  # (n,) P_C
    viscous_nm: FloatArray  # (n,) T_V, sign of the slip
    open_nm: FloatArray  # (n,) the part of it that goes as the drag of an open pack does
    doubt_nm: FloatArray  # (n,) standard deviation of the rest: how far the film of a closing pack is not known
    clutch_k: FloatArray  # (n,) temperature of the pack
    final_clutch_k: float


class _Pack(NamedTuple):
    """A clutch, what drives its film and what is to be filled, in the form the kernel takes."""

    law: FilmLaw
    friction: FrictionLaw
    heat: HeatLaw
    piston_pa: FloatArray
    slip_rad_s: FloatArray
    open_drag_ratio: float
    rows: FilmTrack


class _State(NamedTuple):
    """What a pack is at one point of the grid."""

    point: FilmPoint
    clutch_k: float
    film_rate_1_s: float  # of the step that led here, over the film


def pack_laws(calibration: Calibration) -> PackLaws:
    """Return the laws of clutch 1 and 2."""
    oil = _Oil(calibration.viscosity.a_pa_s, calibration.viscosity.b_k, calibration.viscosity.pole_k)
    return both_clutches(
        PackLaw(
            film=film_law(clutch),
            friction=friction_law(clutch.friction),
            oil=oil,
            heat_capacity_j_k=float(clutch.thermal.heat_capacity_j_k),
            convection_w_k=float(clutch.thermal.convection_w_k),
            touch_pressure_pa=float(clutch.touch_pressure_pa),
            squeeze_factor_m2=float(clutch.geometry.faces.squeeze_factor_m2),
            mobility_ratio=float(clutch.film.mobility_ratio),
        )
        for clutch in calibration.clutches
    )


def integrate_films(
    drives: tuple[PressureDrive, PressureDrive], laws: PackLaws, stop: int | None = None, step: int = 1
) -> tuple[FilmTrack, FilmTrack]:
    """Integrate film and pack temperature of both clutches; docs/model.md eq. (7) and section "Thermal".

    A clutch starts in equilibrium: open, or pressed and at rest. Its heat uses the calibration's friction, which is
    near enough: 15 % of friction changes the pack by about one kelvin.

    Parameters
    ----------
    drives, laws
        Of clutch 1 and 2; the drives on the same grid.
    stop
        Number of grid points to integrate, by default all; the tracks are zero beyond them.
    step
        Number of grid points from one step to the next; points between have what the one before them has.
    """
    length = len(drives[0].piston_pa)
    count = length if stop is None else min(stop, length)
    rows_of_packs = np.empty((2, len(FilmTrack._fields) - 1, -(-count // step)))
    packs = [
        _Pack(
            law=law.film,
            friction=law.friction,
            heat=HeatLaw(*law.oil, law.heat_capacity_j_k, law.convection_w_k, drive.oil_k, drive.clutch_k),
            piston_pa=np.ascontiguousarray(drive.piston_pa[0:count:step]),
            slip_rad_s=np.ascontiguousarray(drive.slip_rad_s[0:count:step]),
            open_drag_ratio=drive.open_drag_ratio,
            rows=FilmTrack._make((*rows, drive.clutch_k)),
        )
        for law, drive, rows in zip(laws, drives, rows_of_packs, strict=True)
    ]
    final_k = _integrate(packs[0], packs[1], step * GRID_S)
    if step != 1 or count != length:  # onto the even grid
        whole = np.zeros((*rows_of_packs.shape[:-1], length))
        for after in range(step):
            places = whole[..., after:count:step]
            places[...] = rows_of_packs[..., : places.shape[-1]]
        rows_of_packs = whole
    first, second = rows_of_packs
    return FilmTrack._make((*first, final_k[0])), FilmTrack._make((*second, final_k[1]))


@kernel
def _integrate(first: _Pack, second: _Pack, step_s: float) -> tuple[float, float]:
    """Fill the rows of both packs and return their temperatures after the last.

    Each point of a film waits for the one before: of two films in turns, one is calculated while the other waits.
    """
    at_one, at_other = _start(first), _start(second)
    for k in range(len(first.piston_pa)):
        at_one, at_other = _next(first, k, at_one, step_s), _next(second, k, at_other, step_s)
    return at_one.clutch_k, at_other.clutch_k


@part
def _start(pack: _Pack) -> _State:
    film_m = equilibrium_film_m(applied_pressure_pa(pack.piston_pa[0], pack.law), pack.law)
    return _State(film_point(film_m, pack.law), pack.heat.start_k, 0.0)


@part
def _next(pack: _Pack, k: int, at: _State, step_s: float) -> _State:
    """Fill row k and return what the pack is at the next point; behind the last one the piston presses as it did."""
    clutch_k, viscosity = _warmed_k(pack, k, at, step_s)
    following = k + 1 if k + 1 < len(pack.piston_pa) else k
    point, law, driving_pa = at.point, pack.law, 0.5 * (pack.piston_pa[k] + pack.piston_pa[following])
    if point.film_m >= law.open_gap_m and applied_pressure_pa(driving_pa, law) <= 0.0:  # an open pack stays open
        return _State(point, clutch_k, at.film_rate_1_s)
    film_m = _film_step(point, driving_pa, viscosity, law, step_s)
    film_rate_1_s = abs(film_m - point.film_m) / (point.film_m * step_s)
    return _State(film_point(film_m, law), clutch_k, film_rate_1_s)


@part
def _warmed_k(pack: _Pack, k: int, at: _State, step_s: float) -> tuple[float, float]:
    """Fill row k; return the temperature of the pack a step later [K] and the viscosity of its oil at this point."""
    point, law, heat, rows, slip = at.point, pack.law, pack.heat, pack.rows, pack.slip_rad_s[k]
    viscosity = viscosity_pa_s(at.clutch_k, heat.a_pa_s, heat.b_k, heat.pole_k)
    open_nm, closing_nm = film_torques_nm(slip, point.film_m, viscosity, point.shear, pack.open_drag_ratio, law)
    openness = _openness(point.film_m, law)
    is_hovering = openness > 0.0 and abs(pack.piston_pa[k] - piston_pressure_pa(0.0, law)) < _HOVER_PA
    doubt = 1.0 if is_hovering else min(_DOUBT_RISE * openness + _TIMING_S * at.film_rate_1_s, 1.0)
    viscous_nm = open_nm + closing_nm
    rows.contact_pa[k], rows.viscous_nm[k] = point.contact_pa, viscous_nm
    rows.open_nm[k] = open_nm + min(_DOUBT_RISE * openness, 1.0) * closing_nm
    rows.doubt_nm[k], rows.clutch_k[k] = doubt * abs(closing_nm), at.clutch_k
    power_w = 0.0
    if abs(slip) >= 1.0:  # slower is locked, or as good as; the noise of the slip would heat it
        contact_nm = 0.0
        if point.contact_pa > 0.0:
            mu = kinetic_friction(slip, pack.friction)
            contact_nm = contact_torque_nm(1.0, mu, point.contact_pa, law.contact_factor_m3)
        power_w = (contact_nm + abs(viscous_nm)) * abs(slip)
    rate_k_s = clutch_heating_rate_k_s(power_w, at.clutch_k, heat.oil_k, heat.heat_capacity_j_k, heat.convection_w_k)
    return at.clutch_k + step_s * rate_k_s, viscosity


@part
def film_torques_nm(
    slip_rad_s: float, film_m: float, viscosity: float, shear: float, open_drag_ratio: float, law: FilmLaw
) -> tuple[float, float]:
    """Return what an open pack drags [N m], and what the film of a closing one shears; (19a).

    The oil of a thick film takes up air or gives it off: it drags more or less as that of an open pack does.
    """
    full_nm = sheared_torque_nm(slip_rad_s, film_m, viscosity, shear, law)
    openness = _openness(film_m, law)
    if openness == 0.0:
        return 0.0, full_nm
    open_nm = openness * open_drag_ratio * full_nm / math.sqrt(1.0 + (full_nm / DRAG_LIMIT_NM) ** 2)
    return open_nm, (1.0 - openness) * full_nm * open_drag_ratio ** min(_DOUBT_RISE * openness, 1.0)


@part
def _whole_nm(
    slip_rad_s: float, film_m: float, viscosity: float, shear: float, open_drag_ratio: float, law: FilmLaw
) -> float:
    open_nm, closing_nm = film_torques_nm(slip_rad_s, film_m, viscosity, shear, open_drag_ratio, law)
    return open_nm + closing_nm


@part
def _openness(film_m: float, law: FilmLaw) -> float:
    """Return how far a pack is open: 0 as long as asperities touch, 1 at its open gap."""
    touching_m = CONTACT_END * law.roughness_m
    return max(0.0, film_m - touching_m) / (law.open_gap_m - touching_m)


@part
def _film_step(point: FilmPoint, piston_pa: float, viscosity: float, law: FilmLaw, step_s: float) -> float:
    """Return the film one step later by the exponential Rosenbrock-Euler rule, exact for a linear rate."""
    rate_m_s, slope_1_s = point_motion(point, piston_pa, viscosity, law)
    reach = slope_1_s * step_s
    stretch = step_s if abs(reach) < 1e-6 else step_s * math.expm1(min(reach, _MOST_REACH)) / reach
    return min(max(point.film_m + rate_m_s * stretch, law.min_film_m), law.open_gap_m)


_VISCOSITY_STEP: Final = 1e-4  # ratio
_PRESSURE_STEP_PA: Final = 10.0  # of a difference quotient: far above rounding, far below the noise of a sensor
_MOST_REACH: Final = 50.0  # of the exponent of one step: no film grows by e to the 50, and exp stays finite
_QUIET: Final = 0.02  # of a film: what changes less in a step is followed in long ones


class FilmCause(IntEnum):
    """What a film answers to: the columns of its derivatives."""

    PRESSURE = 0  # [Pa] of the piston
    PISTON_AREA = 1  # ratio
    PRESSURE_LATENCY = 2  # [s]: the pressure was there earlier
    VISCOSITY = 3  # ratio
    CONTACT_STIFFNESS = 4  # ratio
    FILM_MOBILITY = 5  # natural logarithm of a ratio


_PRESSURE, _AREA, _LATENCY, _VISCOSITY, _STIFFNESS, _MOBILITY = (int(member) for member in FilmCause)


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
    law: PackLaw, drive: PressureDrive, clutch_k: FloatArray, rows: slice, lever_m3: FloatArray
) -> FloatArray:
    """Follow the film of a clutch with its derivatives; docs/model.md, equation (21a).

    Parameters
    ----------
    law, drive
        Of the clutch, as for `integrate_films`.
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
    _follow(moved, law.film, law.oil, np.zeros(len(FilmCause)), answers)
    return answers.torque_nm


@kernel
def _follow(moved: _Moved, law: FilmLaw, oil: _Oil, by: FloatArray, answers: _Answers) -> None:
    """Fill the answers; ``by`` are the derivatives of the film itself [m], zero at first."""
    film_m = equilibrium_film_m(applied_pressure_pa(moved.piston_pa[0], law), law)
    point = film_point(film_m, law)
    count, k = len(moved.piston_pa), 0
    while k < count:
        viscosity = viscosity_pa_s(moved.clutch_k[k], oil.a_pa_s, oil.b_k, oil.pole_k)
        points = min(COARSE, count - 1 - k)
        if points > 1 and not _is_quiet(moved, k, points, point, viscosity, law):
            points = 1
        following = k + max(points, 1)
        if following > answers.first:
            _answer(moved, k, point, viscosity, law, by, answers.contact, answers.viscous)
            for row in range(max(k, answers.first) - answers.first, following - answers.first):
                for cause in range(len(by)):
                    by_contact = answers.lever_m3[row] * answers.contact[cause]
                    answers.torque_nm[row, cause] = by_contact + answers.viscous[cause]
        if points > 0:
            later_m = _step(moved, k, points, point, viscosity, law, by)
            if later_m != point.film_m:
                point = film_point(later_m, law)
        k = following


@part
def _is_quiet(moved: _Moved, k: int, points: int, point: FilmPoint, viscosity: float, law: FilmLaw) -> bool:
    """Return whether a film hardly changes over some points: then one step follows it."""
    driving_pa = 0.5 * (moved.piston_pa[k] + moved.piston_pa[k + points])
    rate = point_rate_m_s(point, driving_pa, viscosity, law)
    return abs(rate) * points * GRID_S < _QUIET * point.film_m


@part
def _answer(
    moved: _Moved, k: int, point: FilmPoint, viscosity: float, law: FilmLaw, by: FloatArray, contact: FloatArray,
    viscous: FloatArray,
) -> None:  # fmt: skip
    slip, drag_ratio, film_m, thicker = moved.slip_rad_s[k], moved.open_drag_ratio, point.film_m, thicker_m(point)
    step_m, thicker_shear = thicker - film_m, shear_factor_difference(thicker / law.roughness_m)
    whole_nm = _whole_nm(slip, film_m, viscosity, point.shear, drag_ratio, law)
    thicker_nm = _whole_nm(slip, thicker, viscosity, thicker_shear, drag_ratio, law)
    stiffer_nm = _whole_nm(slip, film_m, viscosity * (1.0 + _VISCOSITY_STEP), point.shear, drag_ratio, law)
    by_film_pa_m = (contact_pressure_pa(thicker, law) - point.contact_pa) / step_m
    by_film_n = (thicker_nm - whole_nm) / step_m
    for j in range(len(by)):
        contact[j] = by_film_pa_m * by[j]
        viscous[j] = by_film_n * by[j]
    contact[_STIFFNESS] += point.contact_pa
    viscous[_VISCOSITY] += (stiffer_nm - whole_nm) / _VISCOSITY_STEP


@part
def _step(
    moved: _Moved, k: int, points: int, point: FilmPoint, viscosity: float, law: FilmLaw, by: FloatArray
) -> float:
    """Return the film some points later [m], and set its derivatives: the same rule, linearised."""
    film_m = point.film_m
    before_pa, after_pa, step_s = moved.piston_pa[k], moved.piston_pa[k + points], points * GRID_S
    driving_pa = 0.5 * (before_pa + after_pa)
    if film_m >= law.open_gap_m and applied_pressure_pa(driving_pa, law) <= 0.0:
        by[:] = 0.0  # an open pack stays open
        return film_m
    rate, slope_1_s = point_motion(point, driving_pa, viscosity, law)
    reach = min(slope_1_s * step_s, _MOST_REACH)
    growth = math.exp(reach)
    stretch = step_s if abs(reach) < 1e-6 else step_s * math.expm1(reach) / reach
    later_m = film_m + rate * stretch
    if later_m < law.min_film_m or later_m > law.open_gap_m:
        by[:] = 0.0
        return min(max(later_m, law.min_film_m), law.open_gap_m)
    by_pa = 0.0  # where separators, not the piston, move the pack
    if applied_pressure_pa(driving_pa, law) > 0.0:  # the rate jumps there: no difference across it is a derivative
        pushed = point_rate_m_s(point, driving_pa + _PRESSURE_STEP_PA, viscosity, law)
        by_pa = (pushed - rate) / _PRESSURE_STEP_PA
    for j in range(len(by)):
        by[j] *= growth
    by[_PRESSURE] += stretch * by_pa
    by[_AREA] += stretch * by_pa * driving_pa
    by[_LATENCY] += stretch * by_pa * (after_pa - before_pa) / step_s
    if by_pa != 0.0:
        faster_m = step_s * growth * rate  # as if the step lasted longer
        by[_VISCOSITY] -= faster_m
        by[_MOBILITY] += faster_m
        by_applied = by_pa * law.lining_area_m2 / law.piston_area_m2
        by[_STIFFNESS] -= stretch * by_applied * point.contact_pa
    return later_m


def directions(slip_rad_s: FloatArray) -> FloatArray:
    """Return the sign of each slip, fading near zero."""
    return np.clip(slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)


def heat_w(drive: PressureDrive, track: FilmTrack, mu: FloatArray, law: PackLaw) -> float:
    """Return the sum of the heat made at each point [W], for ``(mu_c, mu_s)``."""
    direction = np.clip(drive.slip_rad_s / SIGN_WIDTH_RAD_S, -1.0, 1.0)
    lever_m3 = mu @ contact_levers_m3(drive.slip_rad_s, direction, law.friction, law.film.contact_factor_m3)
    return float(np.abs((track.viscous_nm + lever_m3 * track.contact_pa) * drive.slip_rad_s).sum())
