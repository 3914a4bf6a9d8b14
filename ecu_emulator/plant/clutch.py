"""One wet clutch: solenoid and orifice, its lining, cavity and film over a step, friction torque, locking torque."""

import math
from typing import NamedTuple

from canlog.arrays import FloatArray
from canlog.jit import kernel, part
from clutch_model.calibration import ClutchCalibration
from clutch_model.pack import (
    FilmLaw,
    FrictionLaw,
    contact_pressure_pa,
    contact_torque_nm,
    film_rate_m_s,
    kinetic_friction,
    shear_factor_difference,
    sheared_torque_nm,
)
from ecu_emulator.plant import state as at

_FADE_RATIO = 0.02  # the first share of the volume over which an empty cavity loses its pressure


class HydraulicsParameters(NamedTuple):
    """Numbers of the valve body, the same for both clutches."""

    line_pressure_pa: float  # P_line
    solenoid_lag_s: float  # tau_sol
    pack_compliance_m3_pa: float  # C_pack
    orifice_m3_s_sqrt_pa: float  # k_or
    laminar_pressure_pa: float  # dP_lam
    supply_ratio: float = 1.0  # of the line pressure that the pump reaches; the control does not know of less


class CavityLaw(NamedTuple):
    """Numbers of one piston and its cavity."""

    area_m2: float  # A_K
    preload_n: float  # F_pre
    spring_rate_n_m: float  # K_K
    full_volume_m3: float  # V_full
    touch_pressure_pa: float  # F_s / A_K


def cavity_law(clutch: ClutchCalibration) -> CavityLaw:
    """Return the kernel form of one piston."""
    area_m2 = float(clutch.geometry.piston_area_m2)
    return CavityLaw(
        area_m2=area_m2,
        preload_n=float(clutch.piston.spring_preload_n),
        spring_rate_n_m=float(clutch.piston.spring_rate_n_m),
        full_volume_m3=area_m2 * clutch.piston.fill_stroke_m,
        touch_pressure_pa=float(clutch.touch_pressure_pa),
    )


@part
def cavity_pressure_pa(volume_m3: float, cavity: CavityLaw, valve: HydraulicsParameters) -> float:
    """Return the piston pressure P_K [Pa] of a cavity that holds ``volume_m3`` of oil."""
    excess_m3 = volume_m3 - cavity.full_volume_m3
    if excess_m3 >= 0.0:
        return cavity.touch_pressure_pa + excess_m3 / valve.pack_compliance_m3_pa
    spring_n = cavity.preload_n + cavity.spring_rate_n_m * volume_m3 / cavity.area_m2
    fade = min(1.0, volume_m3 / (_FADE_RATIO * cavity.full_volume_m3))
    return fade * spring_n / cavity.area_m2


_EMPTY_M3 = 1.0e-13  # a cavity below this is empty: keeps denormal numbers out of the loop
_NO_PRESSURE_PA = 1.0e-3
_OPEN_TOLERANCE_M = 1.0e-12
_JUST_BELOW = 1.0 - 1.0e-12
PEAK_SLIP_RAD_S = 120.0  # of the greatest drag of an open pack
_CLOSING_FILM_RATIO = 4.0  # film over roughness at which the film law holds alone
_OPEN_FILM_RATIO = 0.9  # film over open gap from which the pack drags as an open one
_WAYS_M = (13.0, 37.0, 101.0)  # of erratic friction: no two events are alike, and one event is alike throughout


class LiningParameters(NamedTuple):
    """Numbers of both clutches' linings, as the kernels take them; the shipped ones have no effect."""

    fade_per_k: float  # k_muT: share of the friction lost per kelvin
    fade_reference_k: float  # temperature at which the calibration's friction is true
    film_mobility_ratio: float  # on the squeeze rate of the film
    open_drag_ratio: float  # on the drag of open packs
    open_drag_limit_nm: float  # above 0 an open pack drags by the film law, but no more than this
    erratic_ratio: float = 0.0  # standard deviation of friction along the way, of what comes and goes on the lining


@part
def friction_ratio(clutch_k: float, p: LiningParameters, way_m: float = 0.0) -> float:
    """Return the factor on mu_C and mu_S at a pack temperature, eq. (X1), where the car has come this far."""
    way = math.sin(way_m / _WAYS_M[0]) + math.sin(way_m / _WAYS_M[1]) + math.sin(way_m / _WAYS_M[2])
    return (1.0 - p.fade_per_k * (clutch_k - p.fade_reference_k)) * (1.0 + p.erratic_ratio * math.sqrt(2.0 / 3.0) * way)


class ClutchLaw(NamedTuple):
    """Everything constant about one clutch."""

    film: FilmLaw
    friction: FrictionLaw  # its coefficients are those at the start; ageing moves the ones in use
    cavity: CavityLaw
    valve: HydraulicsParameters
    heat_capacity_j_k: float
    convection_w_k: float
    lining: LiningParameters


@part
def openness(film_m: float, law: ClutchLaw) -> float:
    """Return how far a pack drags like an open one: 0 where the film law holds, 1 where it is open.

    The oil of an open pack takes up air: it drags less than the film law says, and never more than a peak.
    """
    closing_m = _CLOSING_FILM_RATIO * law.film.roughness_m
    if film_m <= closing_m:
        return 0.0
    return min(math.log(film_m / closing_m) / math.log(_OPEN_FILM_RATIO * law.film.open_gap_m / closing_m), 1.0)


@part
def film_derivative_m_s(film_m: float, volume_m3: float, viscosity: float, law: ClutchLaw) -> float:
    """Return the film's rate [m/s] for the oil volume behind the piston; docs/model.md eq. (7).

    With the pressure of (H4) put into (H6) the force of the spring cancels.
    """
    excess_m3 = volume_m3 - law.cavity.full_volume_m3
    applied_pa = max(0.0, excess_m3 / law.valve.pack_compliance_m3_pa * law.cavity.area_m2 / law.film.lining_area_m2)
    return film_rate_m_s(film_m, applied_pa, viscosity, excess_m3 >= 0.0, law.film)


@kernel
def refresh_contact(y: FloatArray, clutch: int, law: ClutchLaw) -> None:
    """Recompute what depends on the film alone."""
    film_m = y[at.FILM + clutch]
    y[at.P_C + clutch] = contact_pressure_pa(film_m, law.film)
    y[at.SHEAR + clutch] = shear_factor_difference(film_m / law.film.roughness_m)
    y[at.OPENNESS + clutch] = openness(film_m, law)


@part
def volume_rate_m3_s(valve_pa: float, volume_m3: float, law: ClutchLaw) -> float:
    """Return the flow through the orifice into the cavity [m^3/s], laminar near zero pressure difference."""
    drop_pa = valve_pa - cavity_pressure_pa(volume_m3, law.cavity, law.valve)
    return law.valve.orifice_m3_s_sqrt_pa * drop_pa / math.sqrt(abs(drop_pa) + law.valve.laminar_pressure_pa)


@part
def fluid_step(
    start: tuple[float, float, float], command_pa: float, viscosity: float, dt_s: float, law: ClutchLaw
) -> tuple[float, float, float]:
    """Return valve pressure [Pa], oil volume [m^3] and film [m] after one step.

    The lag is exact, the volume classic Runge-Kutta; for the slower film the midpoint rule is exact enough.
    """
    valve_pa, volume_m3, film_m = start
    half_decay = math.exp(-0.5 * dt_s / law.valve.solenoid_lag_s)
    mid_pa = command_pa + (valve_pa - command_pa) * half_decay
    end_pa = command_pa + (mid_pa - command_pa) * half_decay

    flow1 = volume_rate_m3_s(valve_pa, volume_m3, law)
    flow2 = volume_rate_m3_s(mid_pa, volume_m3 + 0.5 * dt_s * flow1, law)
    mid_m3 = volume_m3 + 0.5 * dt_s * flow2
    flow3 = volume_rate_m3_s(mid_pa, mid_m3, law)
    flow4 = volume_rate_m3_s(end_pa, volume_m3 + dt_s * flow3, law)
    rate1 = film_derivative_m_s(film_m, volume_m3, viscosity, law)
    rate2 = film_derivative_m_s(film_m + 0.5 * dt_s * rate1, mid_m3, viscosity, law)

    volume_m3 += dt_s / 6.0 * (flow1 + 2.0 * flow2 + 2.0 * flow3 + flow4)
    film_m += dt_s * rate2
    return end_pa, volume_m3, film_m


@part
def advance_clutch(y: FloatArray, u: FloatArray, clutch: int, dt_s: float, law: ClutchLaw) -> None:
    """Advance solenoid, cavity and film of one clutch in place, in two steps where the cavity fills or empties."""
    supply_pa = law.valve.supply_ratio * law.valve.line_pressure_pa
    command_pa, viscosity = min(u[at.P_COMMAND + clutch], supply_pa), u[at.VISCOSITY + clutch]
    start = (y[at.P_V + clutch], y[at.VOLUME + clutch], y[at.FILM + clutch])
    if command_pa == 0.0 and start[0] == 0.0 and start[1] == 0.0 and start[2] == law.film.open_gap_m:
        return
    full_m3 = law.cavity.full_volume_m3
    end = fluid_step(start, command_pa, viscosity, dt_s, law)
    if (start[1] < full_m3) != (end[1] < full_m3):
        first_s = dt_s * (full_m3 - start[1]) / (end[1] - start[1])
        valve_pa, _, film_m = fluid_step(start, command_pa, viscosity, first_s, law)
        edge_m3 = full_m3 if end[1] >= full_m3 else full_m3 * _JUST_BELOW
        end = fluid_step((valve_pa, edge_m3, film_m), command_pa, viscosity, dt_s - first_s, law)
    y[at.P_V + clutch] = end[0] if end[0] > _NO_PRESSURE_PA else 0.0
    y[at.VOLUME + clutch] = end[1] if end[1] > _EMPTY_M3 else 0.0
    is_open = end[2] > law.film.open_gap_m - _OPEN_TOLERANCE_M
    y[at.FILM + clutch] = law.film.open_gap_m if is_open else max(end[2], law.film.min_film_m)
    refresh_contact(y, clutch, law)


@part
def capacity_nm(y: FloatArray, u: FloatArray, clutch: int, law: ClutchLaw) -> float:
    """Return the largest torque the locked clutch holds [N m]; docs/model.md eq. (K3)."""
    return float(contact_torque_nm(1.0, u[at.MU_S + clutch], y[at.P_C + clutch], law.film.contact_factor_m3))


@part
def viscous_nm(y: FloatArray, u: FloatArray, clutch: int, law: ClutchLaw) -> float:
    """Return the torque of the sheared film [N m]; docs/model.md eqs. (5), (D2)."""
    slip_rad_s = y[at.W_H] - y[at.W_L + clutch]
    film_m, viscosity, shear = y[at.FILM + clutch], u[at.VISCOSITY + clutch], y[at.SHEAR + clutch]
    film_nm = float(sheared_torque_nm(slip_rad_s, film_m, viscosity, shear, law.film))
    if u[at.OPEN_DRAG + clutch] == 0.0 or y[at.OPENNESS + clutch] == 0.0 or slip_rad_s == 0.0:
        return film_nm
    limit_nm = law.lining.open_drag_limit_nm
    if limit_nm > 0.0:
        open_nm = min(max(film_nm, -limit_nm), limit_nm)
    else:
        share = slip_rad_s / PEAK_SLIP_RAD_S
        open_nm = law.lining.open_drag_ratio * 2.0 * u[at.OPEN_DRAG + clutch] * share / (1.0 + share * share)
    if y[at.OPENNESS + clutch] == 1.0:
        return float(open_nm)
    return float(film_nm * (open_nm / film_nm) ** y[at.OPENNESS + clutch])


@part
def contact_nm(y: FloatArray, u: FloatArray, clutch: int, law: ClutchLaw) -> float:
    """Return the torque of the slipping contact [N m]; docs/model.md eqs. (6), (8)."""
    contact_pa = y[at.P_C + clutch]
    if contact_pa == 0.0:
        return 0.0
    slip_rad_s = y[at.W_H] - y[at.W_L + clutch]
    friction = law.friction
    direction = u[at.DIRECTION + clutch]
    if slip_rad_s > friction.lock_band_rad_s:
        direction = 1.0
    elif slip_rad_s < -friction.lock_band_rad_s:
        direction = -1.0
    current = FrictionLaw(
        u[at.MU_C + clutch],
        u[at.MU_S + clutch],
        friction.stribeck_speed_rad_s,
        friction.stribeck_exponent,
        friction.lock_band_rad_s,
    )
    mu = kinetic_friction(slip_rad_s, current)
    return float(contact_torque_nm(direction, mu, contact_pa, law.film.contact_factor_m3))
