"""From clutch torque back to piston pressure: docs/model.md eq. (28).

Torque and friction give the contact pressure, that gives the film, its rate the squeeze pressure, and all together the
piston pressure that must have been there. None of it is a noisy reading, so what a sensor reads differs from it by that
sensor's white noise and by nothing that smoothing could bias.
"""

import math

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
from clutch_model.pack import (
    CONTACT_END,
    FilmLaw,
    FrictionLaw,
    clutch_heating_rate_k_s,
    contact_pressure_pa,
    contact_torque_nm,
    film_mobility_m,
    kinetic_friction,
    piston_pressure_pa,
    viscous_torque_nm,
)

_MAX_ITERATIONS = 60
_NUDGE_RATIO = 1e-6
_TOLERANCE_RATIO = 1e-13


@kernel
def clutch_torque_nm(film_m: float, slip_rad_s: float, viscosity: float, friction: FrictionLaw, law: FilmLaw) -> float:
    """Return the size of the torque of a slipping clutch [N m], contact and film together; eqs. (4) to (6)."""
    speed = abs(slip_rad_s)
    mu = kinetic_friction(speed, friction)
    contact_nm = contact_torque_nm(1.0, mu, contact_pressure_pa(film_m, law), law.contact_factor_m3)
    return contact_nm + viscous_torque_nm(speed, film_m, viscosity, law)


@kernel
def film_of_torque_m(
    torque_nm: float, slip_rad_s: float, viscosity: float, friction: FrictionLaw, law: FilmLaw, guess_m: float
) -> float:
    """Return the film at which the clutch passes this torque [m]; NaN where none in contact does.

    Newton's method kept between bounds: the torque falls as the film grows.
    """
    low, high = law.min_film_m, CONTACT_END * law.roughness_m
    if clutch_torque_nm(low, slip_rad_s, viscosity, friction, law) < torque_nm:
        return math.nan
    if clutch_torque_nm(high, slip_rad_s, viscosity, friction, law) > torque_nm:
        return math.nan
    film_m = guess_m if low < guess_m < high else 0.5 * (low + high)
    for _ in range(_MAX_ITERATIONS):
        excess = clutch_torque_nm(film_m, slip_rad_s, viscosity, friction, law) - torque_nm
        if excess > 0.0:
            low = film_m
        else:
            high = film_m
        nudge_m = _NUDGE_RATIO * film_m
        slope = (
            clutch_torque_nm(film_m + nudge_m, slip_rad_s, viscosity, friction, law) - torque_nm - excess
        ) / nudge_m
        following = film_m - excess / slope if slope < 0.0 else low
        if not low < following < high:
            following = 0.5 * (low + high)
        step_m = abs(following - film_m)
        film_m = following
        if step_m < _TOLERANCE_RATIO * film_m:
            break
    return film_m


@kernel
def film_track_m(
    torque_nm: FloatArray,
    slip_rad_s: FloatArray,
    viscosity: FloatArray,
    friction: FrictionLaw,
    law: FilmLaw,
    film_m: FloatArray,
) -> None:
    """Fill ``film_m`` (n,) with the film of every sample; the arguments of `film_of_torque_m` as (n,) arrays."""
    guess_m = 0.0
    for k in range(len(torque_nm)):
        film_m[k] = film_of_torque_m(torque_nm[k], slip_rad_s[k], viscosity[k], friction, law, guess_m)
        guess_m = film_m[k]


@kernel
def contact_track_pa(film_m: FloatArray, law: FilmLaw, contact_pa: FloatArray) -> None:
    """Fill ``contact_pa`` (n,) with the contact pressure P_C of every film (n,)."""
    for k in range(len(film_m)):
        contact_pa[k] = contact_pressure_pa(film_m[k], law)


@kernel
def piston_track_pa(
    film_m: FloatArray, film_rate_m_s: FloatArray, viscosity: FloatArray, law: FilmLaw, piston_pa: FloatArray
) -> None:
    """Fill ``piston_pa`` (n,) with the piston pressure that moves the film like this: eq. (7) solved for it."""
    for k in range(len(film_m)):
        springs_pa = law.separation_pressure_pa * (1.0 - film_m[k] / law.open_gap_m)
        squeeze_pa = -film_rate_m_s[k] * viscosity[k] / film_mobility_m(film_m[k], law)
        applied_pa = contact_pressure_pa(film_m[k], law) + springs_pa + squeeze_pa
        piston_pa[k] = piston_pressure_pa(applied_pa, law)


def heated_k(
    power_w: FloatArray, oil_k: FloatArray, period_s: float, heat_capacity_j_k: float, convection_w_k: float
) -> FloatArray:
    """Return the temperature of a clutch pack [K], shape (n,), that starts at the oil's; docs/model.md eq. (T1)."""
    clutch_k = np.empty_like(power_w)
    _heat(power_w, oil_k, period_s, heat_capacity_j_k, convection_w_k, clutch_k)
    return clutch_k


@kernel
def _heat(
    power_w: FloatArray,
    oil_k: FloatArray,
    period_s: float,
    heat_capacity_j_k: float,
    convection_w_k: float,
    clutch_k: FloatArray,
) -> None:
    now_k = oil_k[0]
    for k in range(len(power_w)):
        clutch_k[k] = now_k
        mean_w = 0.5 * (power_w[k] + power_w[min(k + 1, len(power_w) - 1)])
        now_k += period_s * clutch_heating_rate_k_s(mean_w, now_k, oil_k[k], heat_capacity_j_k, convection_w_k)
