"""Oil film between rough, permeable linings: squeeze rate, contact pressure, shear torque."""

import math
from typing import NamedTuple

import numpy as np

from canlog.jit import kernel
from clutch_model.clutch import ClutchCalibration
from clutch_model.units import Quantity

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
    return FilmLaw(
        roughness_m=float(film.roughness_m),
        contact_stiffness_pa=float(film.contact_stiffness_pa),
        permeability_m2=float(film.permeability_m2),
        lining_thickness_m=float(film.lining_thickness_m),
        slip_coefficient=float(film.slip_coefficient),
        open_gap_m=float(film.open_gap_m),
        separation_time_s=float(film.separation_time_s),
        separation_pressure_pa=float(film.separation_pressure_pa),
        min_film_m=float(film.min_film_m),
        squeeze_factor_m2=float(geometry.squeeze_factor_m2 / film.mobility_ratio),
        contact_factor_m3=float(geometry.contact_factor_m3),
        viscous_factor_m4=float(geometry.viscous_factor_m4),
        piston_area_m2=float(geometry.piston_area_m2),
        lining_area_m2=float(geometry.lining_area_m2),
        closed_spring_force_n=float(clutch.piston.closed_spring_force_n),
    )


@kernel
def applied_pressure_pa(piston_pa: float, law: FilmLaw) -> float:
    """Return what the piston presses on the lining [Pa], its return spring deducted, or 0; docs/model.md eq. (H6)."""
    net_n = piston_pa * law.piston_area_m2 - law.closed_spring_force_n
    return max(0.0, net_n / law.lining_area_m2)


def piston_pressures_pa(applied_pa: Quantity, law: FilmLaw) -> Quantity:
    """Return the piston pressure [Pa] of a closed pack that presses on the lining like this: (H6) solved for it.

    For numbers or arrays; the singular is the same law, compiled for other kernels to call.
    """
    return (law.closed_spring_force_n + law.lining_area_m2 * applied_pa) / law.piston_area_m2


piston_pressure_pa = kernel(piston_pressures_pa)


@kernel
def contact_pressure_pa(film_m: float, law: FilmLaw) -> float:
    """Return the mean pressure carried by touching asperities [Pa], P_C of docs/model.md eq. (7)."""
    overlap = CONTACT_END - film_m / law.roughness_m
    if overlap <= 0.0:
        return 0.0
    return law.contact_stiffness_pa * _CONTACT_SCALE * math.exp(CONTACT_EXPONENT * math.log(overlap))


@kernel
def equilibrium_film_m(applied_pa: float, law: FilmLaw) -> float:
    """Return the film [m] at which the asperities carry the whole load: inverse of `contact_pressure_pa`.

    An unloaded pack stands at its open gap.
    """
    if applied_pa <= 0.0:
        return law.open_gap_m
    load_ratio = applied_pa / (law.contact_stiffness_pa * _CONTACT_SCALE)
    overlap = math.exp(math.log(load_ratio) / CONTACT_EXPONENT)
    return max(law.min_film_m, law.roughness_m * (CONTACT_END - overlap))


@kernel
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


@kernel
def squeeze_rate_m_s(film_m: float, applied_pa: float, viscosity: float, law: FilmLaw) -> float:
    """Return the film's rate under a load [m/s], no separator springs; docs/model.md eq. (7)."""
    return _squeezed_m_s(applied_pa - contact_pressure_pa(film_m, law), film_mobility_m(film_m, law), viscosity)


@kernel
def _squeezed_m_s(net_pa: float, mobility_m: float, viscosity: float) -> float:
    return -net_pa * mobility_m / viscosity


@kernel
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


@kernel
def _opening_m_s(film_m: float, law: FilmLaw) -> float:
    """Return how fast an open pack drifts back to its gap [m/s]."""
    return (law.open_gap_m - film_m) / law.separation_time_s


@kernel
def _closed_rate_m_s(
    film_m: float, contact_pa: float, mobility_m: float, applied_pa: float, viscosity: float, law: FilmLaw
) -> float:
    """Return `film_rate_m_s` of a pack whose piston has taken up its stroke, by what its asperities carry."""
    springs_pa = law.separation_pressure_pa * (1.0 - film_m / law.open_gap_m)
    squeezed_m_s = _squeezed_m_s(applied_pa - springs_pa - contact_pa, mobility_m, viscosity)
    return min(squeezed_m_s, _opening_m_s(film_m, law))


@kernel
def measured_film_rate_m_s(film_m: float, piston_pa: float, viscosity: float, law: FilmLaw) -> float:
    """Return the rate of the film [m/s] when only the piston pressure is known: closed above the touch point."""
    applied_pa = applied_pressure_pa(piston_pa, law)
    return film_rate_m_s(film_m, applied_pa, viscosity, applied_pa > 0.0, law)


@kernel
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


@kernel
def viscous_torque_nm(slip_rad_s: float, film_m: float, viscosity: float, law: FilmLaw) -> float:
    """Return the torque of the sheared film [N m], with the sign of the slip; docs/model.md eq. (5)."""
    return sheared_torque_nm(slip_rad_s, film_m, viscosity, shear_factor_difference(film_m / law.roughness_m), law)


@kernel
def sheared_torque_nm(slip_rad_s: float, film_m: float, viscosity: float, shear: float, law: FilmLaw) -> float:
    """Return `viscous_torque_nm` where the ``shear`` factor difference of the film is known already."""
    return law.viscous_factor_m4 * viscosity * slip_rad_s / film_m * shear


def viscosities_pa_s(temperature_k: Quantity, a_pa_s: float, b_k: float, pole_k: float) -> Quantity:
    """Return the dynamic viscosity [Pa s]: Vogel law ``a * exp(b / (T - T0))``, docs/model.md eq. (8a).

    Valid well above the pole T0; the caller keeps ``temperature_k`` there.
    """
    viscosity: Quantity = a_pa_s * np.exp(b_k / (temperature_k - pole_k))
    return viscosity


viscosity_pa_s = kernel(viscosities_pa_s)  # the same law, for other kernels
