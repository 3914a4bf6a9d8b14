"""The laws of a clutch pack: friction of its lining, heat, and the oil film between rough, permeable surfaces.

A law in the plural takes numbers or whole arrays; its singular is the same law for kernels to call.
"""

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Final, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numba.extending import register_jitable

from clutch_model.calibration import ClutchCalibration, FrictionCurve, clutch_of_gear, faces
from clutch_model.units import FloatArray, Quantity

P = ParamSpec("P")
R = TypeVar("R")


def part(law: Callable[P, R]) -> Callable[P, R]:
    """Let kernels call a law, which becomes machine code with them; Python runs it as it stands.

    The options are those of the kernels: a law waits for nobody, divides as numpy does, and makes no array.
    """
    options = {"nogil": True, "error_model": "numpy", "_nrt": False}
    compiled: Callable[P, R] = register_jitable(**options, no_cfunc_wrapper=True, no_cpython_wrapper=True)(law)
    return compiled


gear_clutch = part(clutch_of_gear)  # for other kernels: the only law of the gearbox that they call


class FrictionLaw(NamedTuple):
    """Stribeck curve, eq. (8), in the form the kernels take."""

    mu_c: float
    mu_s: float
    stribeck_speed_rad_s: float
    stribeck_exponent: float
    lock_band_rad_s: float


def friction_law(curve: FrictionCurve) -> FrictionLaw:
    return FrictionLaw(**{name: float(value) for name, value in asdict(curve).items()})


def stribeck_weights(slip_rad_s: Quantity, law: FrictionLaw) -> Quantity:
    """Return the share of ``mu_s`` in the friction coefficient, 1 at lock and 0 at high slip: ``e`` of eq. (18)."""
    excess = np.maximum(np.abs(slip_rad_s) - law.lock_band_rad_s, 0.0) / law.stribeck_speed_rad_s
    if law.stribeck_exponent != 1.0:
        excess = excess**law.stribeck_exponent
    weight: Quantity = np.exp(-excess)
    return weight


stribeck_weight = part(stribeck_weights)


@part
def kinetic_friction(slip_rad_s: float, law: FrictionLaw) -> float:
    """Return the friction coefficient mu_K at a slip speed of either sign; docs/model.md eq. (8)."""
    return law.mu_c + (law.mu_s - law.mu_c) * stribeck_weight(slip_rad_s, law)


def contact_torques_nm(direction: Quantity, mu: float, contact_pa: Quantity, contact_factor_m3: float) -> Quantity:
    """Return the torque of the asperity contact [N m], positive for hub-faster slip; docs/model.md eq. (6).

    ``direction`` is the sign of the slip, chosen by the caller inside the lock band.
    """
    return direction * (contact_factor_m3 * mu * contact_pa)


contact_torque_nm = part(contact_torques_nm)


def contact_levers_m3(
    slip_rad_s: FloatArray, direction: FloatArray, law: FrictionLaw, contact_factor_m3: float
) -> FloatArray:
    """Return the torque of the contact per pressure [m^3], by mu_c and by mu_s, (2, n); docs/model.md eqs. (6), (8)."""
    full_m3, weight = contact_factor_m3 * direction, stribeck_weights(slip_rad_s, law)
    return np.stack([full_m3 * (1.0 - weight), full_m3 * weight])


@part
def convected_w(warm_k: float, cold_k: float, convection_w_k: float) -> float:
    """Return the heat that goes from the warm to the cold side [W]: ``hA * (T_warm - T_cold)``."""
    return convection_w_k * (warm_k - cold_k)


@part
def clutch_heating_rate_k_s(
    friction_power_w: float, clutch_k: float, oil_k: float, heat_capacity_j_k: float, convection_w_k: float
) -> float:
    """Return the temperature rate of one clutch pack [K/s]: ``(|T_F*s| - hA*(T_c - T_oil)) / C_th``."""
    return (friction_power_w - convected_w(clutch_k, oil_k, convection_w_k)) / heat_capacity_j_k


@part
def sump_heating_rate_k_s(
    heat_from_clutches_w: float, oil_k: float, coolant_k: float, heat_capacity_j_k: float, convection_w_k: float
) -> float:
    """Return the temperature rate of the sump oil [K/s], cooled by the engine's coolant."""
    return (heat_from_clutches_w - convected_w(oil_k, coolant_k, convection_w_k)) / heat_capacity_j_k


def clutch_later_k(
    clutch_k: float,
    oil_k: float,
    friction_power_w: float,
    elapsed_s: float,
    heat_capacity_j_k: float,
    convection_w_k: float,
) -> float:
    """Return the temperature of a pack after a while of constant power [K]: `clutch_heating_rate_k_s` solved."""
    end_k = oil_k + friction_power_w / convection_w_k
    return end_k + (clutch_k - end_k) * math.exp(-elapsed_s * convection_w_k / heat_capacity_j_k)


# Greenwood-Tripp F_5/2 for Gaussian heights, Patir-Cheng 1978: 4.4086e-5 * (4 - H)^6.804 for H < 4.
_CONTACT_SCALE = 4.4086e-5
CONTACT_EXPONENT = 6.804
CONTACT_END = 4.0
FLOW_RATE = -0.56  # of Patir-Cheng's pressure flow factor, 1978
# Mean shear stress factor, Patir-Cheng 1979; (z^2 - 1)^3 * log cancels beyond z = 20, where phi_f is 1.
_SHEAR_SPLIT = 3.0
_SHEAR_FAR = 60.0
_SLIP_SHEAR_END = 7.0


class FilmLaw(NamedTuple):
    """Surface, film and geometry numbers of one clutch in the form the kernels take (all floats)."""

    roughness_m: float  # sigma
    contact_stiffness_pa: float  # K_c
    permeability_m2: float  # Phi
    lining_thickness_m: float  # d
    slip_coefficient: float  # a_BJ
    open_gap_m: float  # h0
    separation_time_s: float  # tau_sep
    separation_pressure_pa: float  # p_sep
    min_film_m: float  # h_min
    squeeze_factor_m2: float  # Q over the mobility ratio
    contact_factor_m3: float  # C
    viscous_factor_m4: float  # Vg
    piston_area_m2: float  # A_K
    lining_area_m2: float  # A_lining
    closed_spring_force_n: float  # F_s


def film_law(clutch: ClutchCalibration) -> FilmLaw:
    """Return the kernel form of one clutch's film and geometry."""
    film, geometry = clutch.film, clutch.geometry
    ring = faces(geometry.outer_radius_m, geometry.inner_radius_m, geometry.interface_count)
    return FilmLaw(
        **{name: float(value) for name, value in asdict(film).items() if name != "mobility_ratio"},
        squeeze_factor_m2=float(ring.squeeze_factor_m2 / film.mobility_ratio),
        contact_factor_m3=float(ring.contact_factor_m3),
        viscous_factor_m4=float(ring.viscous_factor_m4),
        piston_area_m2=float(geometry.piston_area_m2),
        lining_area_m2=float(ring.lining_area_m2),
        closed_spring_force_n=float(clutch.piston.closed_spring_force_n),
    )


@part
def applied_pressure_pa(piston_pa: float, law: FilmLaw) -> float:
    """Return what the piston presses on the lining [Pa], its return spring deducted, or 0; docs/model.md eq. (H6)."""
    net_n = piston_pa * law.piston_area_m2 - law.closed_spring_force_n
    return max(0.0, net_n / law.lining_area_m2)


def piston_pressures_pa(applied_pa: Quantity, law: FilmLaw) -> Quantity:
    """Return the piston pressure [Pa] of a closed pack that presses on the lining like this: (H6) solved for it.

    For numbers or arrays.
    """
    return (law.closed_spring_force_n + law.lining_area_m2 * applied_pa) / law.piston_area_m2


piston_pressure_pa = part(piston_pressures_pa)


@part
def contact_pressure_pa(film_m: float, law: FilmLaw) -> float:
    """Return the mean pressure carried by touching asperities [Pa], P_C of docs/model.md eq. (7)."""
    overlap = CONTACT_END - film_m / law.roughness_m
    if overlap <= 0.0:
        return 0.0
    return law.contact_stiffness_pa * _CONTACT_SCALE * math.exp(CONTACT_EXPONENT * math.log(overlap))


@part
def equilibrium_film_m(applied_pa: float, law: FilmLaw) -> float:
    """Return the film [m] at which the asperities carry the whole load: inverse of `contact_pressure_pa`.

    An unloaded pack stands at its open gap.
    """
    if applied_pa <= 0.0:
        return law.open_gap_m
    load_ratio = applied_pa / (law.contact_stiffness_pa * _CONTACT_SCALE)
    overlap = math.exp(math.log(load_ratio) / CONTACT_EXPONENT)
    return max(law.min_film_m, law.roughness_m * (CONTACT_END - overlap))


@part
def film_mobility_m(film_m: float, law: FilmLaw) -> float:
    """Return how readily the film yields [m]: squeeze rate times viscosity over net pressure, eq. (7).

    ``(h^3 * phi * (1 + 3*eta_BJ) + 12*Phi*d) / (Q * g)`` with Patir-Cheng's pressure flow factor phi, the
    Beavers-Joseph slip at the permeable lining and the Gaussian mean-gap derivative g.
    """
    ratio = film_m / law.roughness_m
    gap_slope = 0.5 * (1.0 + math.erf(ratio * math.sqrt(0.5)))
    flow_factor = 1.0 - 0.9 * math.exp(FLOW_RATE * ratio)
    depth = film_m / math.sqrt(law.permeability_m2)
    slip_gain = (depth + 2.0 * law.slip_coefficient) / (depth * (1.0 + law.slip_coefficient * depth))
    through_film = film_m * film_m * film_m * flow_factor * (1.0 + 3.0 * slip_gain)
    through_lining = 12.0 * law.permeability_m2 * law.lining_thickness_m
    return (through_film + through_lining) / (law.squeeze_factor_m2 * gap_slope)


@part
def film_rate_m_s(film_m: float, applied_pa: float, viscosity: float, is_closed: bool, law: FilmLaw) -> float:  # noqa: FBT001 - a kernel takes its arguments by position
    """Return the rate of the film [m/s], opening included; docs/model.md eq. (7) with its opening rule.

    Parameters
    ----------
    film_m : float
        Film thickness h [m], between ``law.min_film_m`` and ``law.open_gap_m``.
    applied_pa : float
        Pressure on the lining p_app [Pa], >= 0.
    viscosity : float
        Dynamic viscosity of the oil in the film [Pa s].
    is_closed : bool
        Whether the piston has taken up its stroke; an open pack drifts back to its gap.
    law : FilmLaw
        Numbers of the clutch.
    """
    if not is_closed:
        return _opening_m_s(film_m, law)
    contact_pa, mobility_m = contact_pressure_pa(film_m, law), film_mobility_m(film_m, law)
    return _closed_rate_m_s(film_m, contact_pa, mobility_m, applied_pa, viscosity, law)


@part
def _opening_m_s(film_m: float, law: FilmLaw) -> float:
    """Return how fast an open pack drifts back to its gap [m/s]."""
    return (law.open_gap_m - film_m) / law.separation_time_s


@part
def _closed_rate_m_s(
    film_m: float, contact_pa: float, mobility_m: float, applied_pa: float, viscosity: float, law: FilmLaw
) -> float:
    """Return `film_rate_m_s` of a pack whose piston has taken up its stroke, by what its asperities carry."""
    springs_pa = law.separation_pressure_pa * (1.0 - film_m / law.open_gap_m)
    squeezed_m_s = -(applied_pa - springs_pa - contact_pa) * mobility_m / viscosity
    return min(squeezed_m_s, _opening_m_s(film_m, law))


@part
def shear_factor_difference(film_ratio: float) -> float:
    """Return ``phi_f - phi_fs``, the shear stress of a rough film over that of a smooth one; eq. (5).

    Patir and Cheng 1979 for isotropic roughness; ``film_ratio`` is H = h / sigma, > 0.
    """
    z = film_ratio / 3.0
    if film_ratio > _SHEAR_FAR:
        return 1.0
    core = (1.0 - z * z) ** 3
    if film_ratio <= _SHEAR_SPLIT:
        polynomial = -55.0 + z * (132.0 + z * (345.0 + z * (-160.0 + z * (-405.0 + z * (60.0 + 147.0 * z)))))
        mean = 35.0 / 32.0 * z * (core * math.log(300.0 * (z + 1.0)) + polynomial / 60.0)
    else:
        polynomial = 66.0 + z * z * (30.0 * z * z - 80.0)
        mean = 35.0 / 32.0 * z * (core * math.log((z + 1.0) / (z - 1.0)) + z / 15.0 * polynomial)
    if film_ratio >= _SLIP_SHEAR_END:
        return mean
    decay = math.exp(2.31 * math.log(film_ratio) - 2.38 * film_ratio + 0.11 * film_ratio * film_ratio)
    return mean - 11.1 * decay


@part
def viscous_torque_nm(slip_rad_s: float, film_m: float, viscosity: float, law: FilmLaw) -> float:
    """Return the torque of the sheared film [N m], with the sign of the slip; docs/model.md eq. (5)."""
    return sheared_torque_nm(slip_rad_s, film_m, viscosity, shear_factor_difference(film_m / law.roughness_m), law)


@part
def sheared_torque_nm(slip_rad_s: float, film_m: float, viscosity: float, shear: float, law: FilmLaw) -> float:
    """Return `viscous_torque_nm` where the ``shear`` factor difference of the film is known already."""
    return law.viscous_factor_m4 * viscosity * slip_rad_s / film_m * shear


def viscosities_pa_s(temperature_k: Quantity, a_pa_s: float, b_k: float, pole_k: float) -> Quantity:
    """Return the dynamic viscosity [Pa s]: Vogel law ``a * exp(b / (T - T0))``, docs/model.md eq. (8a).

    Valid well above the pole T0; the caller keeps ``temperature_k`` there.
    """
    viscosity: Quantity = a_pa_s * np.exp(b_k / (temperature_k - pole_k))
    return viscosity


viscosity_pa_s = part(viscosities_pa_s)  # the same law, for other kernels


_SLOPE_STEP: Final = 1e-4  # ratio of thicknesses over which a slope is taken


class FilmPoint(NamedTuple):
    """What a film of some thickness is, whatever presses or shears it."""

    film_m: float
    contact_pa: float
    mobility_m: float
    shear: float  # `shear_factor_difference`


def slower_film(law: FilmLaw, ratio: float) -> FilmLaw:
    """Return the law of films that yield more slowly by a ratio; docs/model.md eq. (7)."""
    return law._replace(squeeze_factor_m2=law.squeeze_factor_m2 * ratio)


@part
def film_point(film_m: float, law: FilmLaw) -> FilmPoint:
    """Return contact, mobility and shear of a film of this thickness."""
    contact_pa, mobility_m = contact_pressure_pa(film_m, law), film_mobility_m(film_m, law)
    return FilmPoint(film_m, contact_pa, mobility_m, shear_factor_difference(film_m / law.roughness_m))


@part
def thicker_m(point: FilmPoint) -> float:
    """Return the thickness [m] that a slope over the film is taken to."""
    return point.film_m * (1.0 + _SLOPE_STEP)


@part
def point_rate_m_s(point: FilmPoint, piston_pa: float, viscosity: float, law: FilmLaw) -> float:
    """Return `film_rate_m_s` by the piston pressure: a pack is closed above its touch point."""
    applied_pa = applied_pressure_pa(piston_pa, law)
    if applied_pa <= 0.0:
        return _opening_m_s(point.film_m, law)
    return _closed_rate_m_s(point.film_m, point.contact_pa, point.mobility_m, applied_pa, viscosity, law)


@part
def point_motion(point: FilmPoint, piston_pa: float, viscosity: float, law: FilmLaw) -> tuple[float, float]:
    """Return `point_rate_m_s`, and how much faster a thicker film moves, per thickness [1/s]."""
    applied_pa, thicker = applied_pressure_pa(piston_pa, law), thicker_m(point)
    rate_m_s = point_rate_m_s(point, piston_pa, viscosity, law)
    thicker_m_s = film_rate_m_s(thicker, applied_pa, viscosity, applied_pa > 0.0, law)
    return rate_m_s, (thicker_m_s - rate_m_s) / (thicker - point.film_m)
