"""The laws of a clutch pack: friction of its lining, heat, and the oil film between rough, permeable surfaces.

A law in the plural takes numbers or whole arrays; its singular is the same law, compiled for other kernels to call.

An estimator follows a film from point to point, and each waits for the one before. What its thickness alone decides
takes logarithms, powers and an error function; so `film_shape` asks these laws once for each surface, and between what
they say a short polynomial does. Divisions, which take longest then, are made of what is known early.
"""

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel, unchecked_kernel
from clutch_model.calibration import ClutchCalibration, FrictionCurve, clutch_of_gear, faces
from clutch_model.units import Quantity

# Exponential and logarithm as plain arithmetic: a loop over rows does several at once, with calls of the C library one.
_FRACTION_BITS: Final = np.int64(52)
_EXPONENT_START: Final = np.int64(1023)
_ROUNDER: Final = 1.5 * 2.0**52  # a sum with it has no digits behind the point, and its last bits are the whole number
_MOST: Final = 700.0  # of an exponent: its power has a number
_PER_LOG_2: Final = 1.0 / math.log(2.0)
_LOG_2: Final = float.fromhex("0x1.62e42fefap-1")  # its products with whole numbers are exact
_LOG_2_REST: Final = float.fromhex("0x1.cf79abc9e3b3ap-40")
_ROOT_HALF_BITS: Final = np.float64(math.sqrt(0.5)).view(np.int64)
_E: Final = tuple(1.0 / math.factorial(n) for n in range(14))  # Taylor's series, right to 2e-16 up to half of log(2)
_L: Final = tuple(1.0 / n for n in range(3, 25, 2))  # of the area tangent, right to 1e-17 up to 0.172


@unchecked_kernel
def row_exponential(exponent: float) -> float:
    """Return e to a power, which counts as -700 or 700 beyond; right to 1e-15."""
    bounded = min(max(exponent, -_MOST), _MOST)
    rounded = bounded * _PER_LOG_2 + _ROUNDER
    twos = rounded - _ROUNDER
    x = (bounded - twos * _LOG_2) - twos * _LOG_2_REST
    x2 = x * x
    first = (_E[0] + x * _E[1]) + x2 * (_E[2] + x * _E[3])
    second = (_E[4] + x * _E[5]) + x2 * (_E[6] + x * _E[7])
    third = (_E[8] + x * _E[9]) + x2 * (_E[10] + x * _E[11])
    series = first + x2 * x2 * (second + x2 * x2 * (third + x2 * x2 * (_E[12] + x * _E[13])))
    power_bits = (np.float64(rounded).view(np.int64) + _EXPONENT_START) << _FRACTION_BITS
    return series * np.int64(power_bits).view(np.float64)


@unchecked_kernel
def row_logarithm(value: float) -> float:
    """Return the natural logarithm of a positive number that is not below 1e-307; right to 1e-15."""
    bits = np.float64(value).view(np.int64)
    twos = (bits - _ROOT_HALF_BITS) >> _FRACTION_BITS
    near_one = np.int64(bits - (twos << _FRACTION_BITS)).view(np.float64)
    x = (near_one - 1.0) / (near_one + 1.0)
    x2 = x * x
    x4 = x2 * x2
    first = (_L[0] + x2 * _L[1]) + x4 * (_L[2] + x2 * _L[3])
    second = (_L[4] + x2 * _L[5]) + x4 * (_L[6] + x2 * _L[7])
    third = (_L[8] + x2 * _L[9]) + x4 * _L[10]
    series = first + x4 * x4 * (second + x4 * x4 * third)
    return twos * _LOG_2 + (2.0 * x + (2.0 * x * x2 * series + twos * _LOG_2_REST))


_NEXT_TO_ZERO: Final = 1e-290  # [rad/s]: has a logarithm, and a weight of 1
gear_clutch = kernel(clutch_of_gear)  # for other kernels: the only law of the gearbox that they call


class FrictionLaw(NamedTuple):
    """Stribeck curve, eq. (8), in the form the kernels take."""

    mu_c: float
    mu_s: float
    stribeck_speed_rad_s: float
    stribeck_exponent: float
    lock_band_rad_s: float


def friction_law(curve: FrictionCurve) -> FrictionLaw:
    return FrictionLaw(
        mu_c=float(curve.mu_c),
        mu_s=float(curve.mu_s),
        stribeck_speed_rad_s=float(curve.stribeck_speed_rad_s),
        stribeck_exponent=float(curve.stribeck_exponent),
        lock_band_rad_s=float(curve.lock_band_rad_s),
    )


def stribeck_weights(slip_rad_s: Quantity, law: FrictionLaw) -> Quantity:
    """Return the share of ``mu_s`` in the friction coefficient, 1 at lock and 0 at high slip: ``e`` of eq. (18)."""
    excess = np.maximum(np.abs(slip_rad_s) - law.lock_band_rad_s, 0.0) / law.stribeck_speed_rad_s
    if law.stribeck_exponent != 1.0:
        excess = excess**law.stribeck_exponent
    weight: Quantity = np.exp(-excess)
    return weight


stribeck_weight = kernel(stribeck_weights)


@unchecked_kernel
def row_stribeck_weight(slip_rad_s: float, law: FrictionLaw) -> float:
    """Return `stribeck_weight` for kernels that go along rows; right to 1e-13."""
    excess = max(abs(slip_rad_s) - law.lock_band_rad_s, _NEXT_TO_ZERO) * (1.0 / law.stribeck_speed_rad_s)
    return row_exponential(-row_exponential(law.stribeck_exponent * row_logarithm(excess)))


@kernel
def kinetic_friction(slip_rad_s: float, law: FrictionLaw) -> float:
    """Return the friction coefficient mu_K at a slip speed of either sign; docs/model.md eq. (8)."""
    return law.mu_c + (law.mu_s - law.mu_c) * stribeck_weight(slip_rad_s, law)


def contact_torques_nm(direction: Quantity, mu: float, contact_pa: Quantity, contact_factor_m3: float) -> Quantity:
    """Return the torque of the asperity contact [N m], positive for hub-faster slip; docs/model.md eq. (6).

    ``direction`` is the sign of the slip, chosen by the caller inside the lock band.
    """
    return direction * (contact_factor_m3 * mu * contact_pa)


contact_torque_nm = kernel(contact_torques_nm)


@kernel
def convected_w(warm_k: float, cold_k: float, convection_w_k: float) -> float:
    """Return the heat that goes from the warm to the cold side [W]: ``hA * (T_warm - T_cold)``."""
    return convection_w_k * (warm_k - cold_k)


@kernel
def clutch_heating_rate_k_s(
    friction_power_w: float, clutch_k: float, oil_k: float, heat_capacity_j_k: float, convection_w_k: float
) -> float:
    """Return the temperature rate of one clutch pack [K/s]: ``(|T_F*s| - hA*(T_c - T_oil)) / C_th``."""
    return (friction_power_w - convected_w(clutch_k, oil_k, convection_w_k)) / heat_capacity_j_k


@kernel
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
        roughness_m=float(film.roughness_m),
        contact_stiffness_pa=float(film.contact_stiffness_pa),
        permeability_m2=float(film.permeability_m2),
        lining_thickness_m=float(film.lining_thickness_m),
        slip_coefficient=float(film.slip_coefficient),
        open_gap_m=float(film.open_gap_m),
        separation_time_s=float(film.separation_time_s),
        separation_pressure_pa=float(film.separation_pressure_pa),
        min_film_m=float(film.min_film_m),
        squeeze_factor_m2=float(ring.squeeze_factor_m2 / film.mobility_ratio),
        contact_factor_m3=float(ring.contact_factor_m3),
        viscous_factor_m4=float(ring.viscous_factor_m4),
        piston_area_m2=float(geometry.piston_area_m2),
        lining_area_m2=float(ring.lining_area_m2),
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


# Slopes over the film are taken over this ratio.
_SLOPE_STEP: Final = 1e-4
# Polynomials in a film as thick as the roughness: the laws have their corners at whole roughnesses, where one ends.
_PIECES: Final = 128
_MOST_PIECES: Final = 2**14  # up to an open gap, whatever the surface: 2 MB
_COEFFICIENTS: Final = 5
_CONTACT, _MOBILITY, _SHEAR = range(3)
_KEPT_SURFACES: Final = 8


class FilmShape(NamedTuple):
    """What films of any thickness are by their surface alone, in the form the kernels take."""

    pieces: FloatArray  # (pieces, 3, _COEFFICIENTS): contact per stiffness, mobility times squeeze factor [m^3], shear
    per_piece_1_m: float


class FilmPoint(NamedTuple):
    """What a film of some thickness answers to any pressure and slip, and one that is a step thicker: for its slope."""

    film_m: float
    per_film_1_m: float  # its reciprocal
    contact_pa: float
    mobility_m: float
    shear: float  # `shear_factor_difference`
    thicker_contact_pa: float
    thicker_mobility_m: float
    thicker_shear: float
    step_m: float  # by which that one is thicker


def slower_film(law: FilmLaw, ratio: float) -> FilmLaw:
    """Return the law of films that yield more slowly by a ratio; docs/model.md eq. (7)."""
    return law._replace(squeeze_factor_m2=law.squeeze_factor_m2 * ratio)


def film_shape(law: FilmLaw) -> FilmShape:
    """Return the shape of a clutch's films: the same for all pistons, stiffnesses and mobilities of one surface."""
    return _shape(law.roughness_m, law.permeability_m2, law.lining_thickness_m, law.slip_coefficient, law.open_gap_m)


@lru_cache(maxsize=_KEPT_SURFACES)
def _shape(
    roughness_m: float, permeability_m2: float, lining_thickness_m: float, slip_coefficient: float, open_gap_m: float
) -> FilmShape:
    law = FilmLaw(*np.ones(len(FilmLaw._fields)).tolist())._replace(
        roughness_m=roughness_m,
        permeability_m2=permeability_m2,
        lining_thickness_m=lining_thickness_m,
        slip_coefficient=slip_coefficient,
    )
    piece_m = max(roughness_m / _PIECES, open_gap_m / _MOST_PIECES)
    count = int(open_gap_m / piece_m) + 2
    along = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_COEFFICIENTS) + 0.5) / _COEFFICIENTS)  # Chebyshev's points
    values = np.empty((count, 3, _COEFFICIENTS))
    _ask((np.arange(count)[:, None] + along) * piece_m, law, values)
    pieces = values @ np.linalg.inv(np.vander(along, increasing=True)).T
    return FilmShape(pieces=np.ascontiguousarray(pieces), per_piece_1_m=1.0 / piece_m)


@array_kernel
def _ask(film_m: FloatArray, law: FilmLaw, values: FloatArray) -> None:
    """Fill in what the laws say of some films; (n, m) of them and (n, 3, m) values."""
    for row in range(film_m.shape[0]):
        for column in range(film_m.shape[1]):
            one_m = film_m[row, column]
            values[row, _CONTACT, column] = contact_pressure_pa(one_m, law)
            values[row, _MOBILITY, column] = film_mobility_m(one_m, law)
            values[row, _SHEAR, column] = shear_factor_difference(one_m / law.roughness_m)


@unchecked_kernel
def film_point(film_m: float, law: FilmLaw, shape: FilmShape) -> FilmPoint:
    """Return contact, mobility and shear of a film not above its open gap, and of one a ten thousandth thicker."""
    place, pieces = film_m * shape.per_piece_1_m, shape.pieces
    piece = min(max(int(place), 0), len(pieces) - 1)  # also where a film is no number
    along = place - piece
    further = along + _SLOPE_STEP * place
    stiffness_pa, per_squeeze_1_m2 = law.contact_stiffness_pa, 1.0 / law.squeeze_factor_m2
    return FilmPoint(
        film_m,
        1.0 / film_m,
        stiffness_pa * max(0.0, _value(pieces, piece, _CONTACT, along)),
        per_squeeze_1_m2 * _value(pieces, piece, _MOBILITY, along),
        _value(pieces, piece, _SHEAR, along),
        stiffness_pa * max(0.0, _value(pieces, piece, _CONTACT, further)),
        per_squeeze_1_m2 * _value(pieces, piece, _MOBILITY, further),
        _value(pieces, piece, _SHEAR, further),
        _SLOPE_STEP * film_m,
    )


@unchecked_kernel
def _value(pieces: FloatArray, piece: int, law: int, along: float) -> float:
    """Return what the polynomial of one law says so far along a piece, whose length is 1."""
    c = pieces[piece, law]
    value: float = c[0] + along * (c[1] + along * (c[2] + along * (c[3] + along * c[4])))
    return value


@unchecked_kernel
def point_rate_m_s(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> float:
    """Return `film_rate_m_s` by the piston pressure, closed above the touch point; ``fluidity`` is 1/viscosity."""
    applied_pa = applied_pressure_pa(piston_pa, law)
    return _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)


@unchecked_kernel
def point_motion(point: FilmPoint, piston_pa: float, fluidity: float, law: FilmLaw) -> tuple[float, float]:
    """Return `point_rate_m_s`, and how much faster a thicker film moves, per thickness [1/s]."""
    applied_pa, thicker_m = applied_pressure_pa(piston_pa, law), point.film_m + point.step_m
    rate_m_s = _rate_m_s(point.film_m, point.contact_pa, point.mobility_m * fluidity, applied_pa, law)
    thicker_m_s = _rate_m_s(thicker_m, point.thicker_contact_pa, point.thicker_mobility_m * fluidity, applied_pa, law)
    return rate_m_s, (thicker_m_s - rate_m_s) * (point.per_film_1_m * (1.0 / _SLOPE_STEP))


@unchecked_kernel
def _rate_m_s(film_m: float, contact_pa: float, yielding_m_pa_s: float, applied_pa: float, law: FilmLaw) -> float:
    """Return the rate of a film that yields so much to a pressure [m/(Pa s)]; `film_rate_m_s`."""
    opening_m_s = (law.open_gap_m - film_m) * (1.0 / law.separation_time_s)
    if applied_pa <= 0.0:
        return opening_m_s
    springs_pa = law.separation_pressure_pa * (1.0 - film_m * (1.0 / law.open_gap_m))
    return min((springs_pa + contact_pa - applied_pa) * yielding_m_pa_s, opening_m_s)
