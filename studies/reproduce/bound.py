"""The Cramer-Rao bound on the paper's noisy sensor set: what no unbiased estimator passes on these very samples.

Slip and clutch torque are taken for known: the exact torques of the paper and the instants of locking fix them far
better than the speed sensors. What is left is the pressure. The torque gives the contact pressure ``P_C = T_C/(C*mu)``,
that gives the film, and eq. (7) run backwards gives the piston pressure that must have been there,

    P_K = (F_s + A_lining*(P_C(h) + p_sep*(1 - h/h0) - h'*nu/M(h)))/A_K
    M(h) = (h^3*phi*(1 + 3*eta_BJ) + 12*Phi*d)/(Q*g)

The reading of the pressure sensor differs from it by white noise, so each sample adds ``g*g'/sigma_P^2`` to the
information, g the derivative of P_K by (mu_C, mu_S).
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from clutch_model.calibration import ClutchCalibration, Viscosity
from clutch_model.pack import (
    FilmLaw,
    FrictionLaw,
    contact_pressure_pa,
    contact_torque_nm,
    film_law,
    film_mobility_m,
    friction_law,
    kinetic_friction,
    piston_pressures_pa,
    stribeck_weight,
    viscosities_pa_s,
    viscous_torque_nm,
)
from ecu_emulator.plant.state import Col
from studies.reproduce.differences import central_difference
from studies.reproduce.drives import PERIOD_S, PRESSURE_NOISE_RATIO, PaperDrive, rms
from studies.reproduce.study import CLUTCHES, PARAMETERS, Key, true_value

BoolArray = npt.NDArray[np.bool_]

SLIP_MIN_RAD_S = 0.6
CONTACT_MIN_PA = 100.0  # below, a sample says nothing
STRETCH_MIN = 20  # samples in a row
FOLLOWED_PA = 500.0  # eq. (7) backwards must give the true pressure this closely; where a clutch is let go it does not
NUDGE_M = 1.0e-10


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundStretch:
    """Samples in a row in which one clutch slips in contact; all (n,)."""

    film_m: FloatArray
    slip_rad_s: FloatArray
    viscosity: FloatArray
    pressure_pa: FloatArray


def bounds_percent(drive: PaperDrive) -> dict[Key, float]:
    """Return the least standard deviation of every parameter, percent of the true value."""
    bounds: dict[Key, float] = {}
    for clutch in CLUTCHES:
        truth = drive.truth.clutches[clutch - 1]
        information = np.zeros((2, 2))
        for stretch in stretches(drive, clutch):
            slope = pressure_slopes(stretch, truth)[:, is_followed(stretch, film_law(truth))]
            information += slope @ slope.T
        noise_pa = PRESSURE_NOISE_RATIO * rms(drive.signals.pressure_pa[clutch - 1])
        stds = noise_pa * np.sqrt(np.diag(np.linalg.inv(information)))
        for parameter, std in zip(PARAMETERS, stds, strict=True):
            bounds[drive.case, clutch, parameter] = 100.0 * float(std) / true_value(drive, clutch, parameter)
    return bounds


def stretches(drive: PaperDrive, clutch: int) -> list[BoundStretch]:
    """Return the stretches of a drive that inform about a clutch."""
    truth, rows = drive.truth.clutches[clutch - 1], drive.rows
    law = film_law(truth)
    film_m, slip_rad_s = rows[:, Col.FILM1 + clutch - 1], drive.slip_rad_s(clutch)
    contact_pa = np.array([contact_pressure_pa(one, law) for one in film_m])
    informs = ~drive.is_locked(clutch) & (np.abs(slip_rad_s) > SLIP_MIN_RAD_S) & (contact_pa > CONTACT_MIN_PA)
    edges = np.flatnonzero(np.diff(np.concatenate(((False,), informs, (False,))).astype(np.int8)))
    viscosity = _viscosities(rows[:, Col.CLUTCH1_TEMPERATURE + clutch - 1], drive.truth.viscosity)
    return [
        BoundStretch(
            film_m=film_m[first:stop],
            slip_rad_s=slip_rad_s[first:stop],
            viscosity=viscosity[first:stop],
            pressure_pa=rows[first:stop, Col.PRESSURE1 + clutch - 1],
        )
        for first, stop in edges.reshape(-1, 2)
        if stop - first >= STRETCH_MIN
    ]


def piston_pressure_pa(
    film_m: FloatArray, film_rate_m_s: FloatArray, viscosity: FloatArray, law: FilmLaw
) -> FloatArray:
    """Return the piston pressure that moves the film like this [Pa], shape (n,): eq. (7) solved for it."""
    springs_pa = law.separation_pressure_pa * (1.0 - film_m / law.open_gap_m)
    squeeze_pa = -film_rate_m_s * viscosity / np.array([film_mobility_m(one, law) for one in film_m])
    contact_pa = np.array([contact_pressure_pa(one, law) for one in film_m])
    return piston_pressures_pa(contact_pa + springs_pa + squeeze_pa, law)


def is_followed(stretch: BoundStretch, law: FilmLaw) -> BoolArray:
    """Tell where eq. (7) alone moves the film, shape (n,): everywhere but in the first instants of an opening."""
    rate_m_s = central_difference(stretch.film_m, PERIOD_S).rate
    seen_pa = piston_pressure_pa(stretch.film_m, rate_m_s, stretch.viscosity, law)
    followed: BoolArray = np.abs(seen_pa - stretch.pressure_pa) < FOLLOWED_PA
    return followed


def pressure_slopes(stretch: BoundStretch, truth: ClutchCalibration) -> FloatArray:
    """Return the derivatives of the piston pressure by mu_C and mu_S at a given torque [Pa], shape (2, n)."""
    law, friction = film_law(truth), friction_law(truth.friction)
    rate_m_s = central_difference(stretch.film_m, PERIOD_S).rate
    slopes = np.empty((2, len(stretch.film_m)))
    for row, by_mu in enumerate(_film_slopes_m(stretch, law, friction)):
        shift_m = by_mu * 1e-6  # of the film, for a millionth of friction
        shift_rate_m_s = central_difference(shift_m, PERIOD_S).rate
        up, down = (
            piston_pressure_pa(
                stretch.film_m + sign * shift_m, rate_m_s + sign * shift_rate_m_s, stretch.viscosity, law
            )
            for sign in (1.0, -1.0)
        )
        slopes[row] = (up - down) / 2e-6
    return slopes


def _film_slopes_m(stretch: BoundStretch, law: FilmLaw, friction: FrictionLaw) -> FloatArray:
    """Return the derivatives of the film by mu_C and mu_S at a given torque [m], shape (2, n)."""
    slopes = np.empty((2, len(stretch.film_m)))
    for k, (film_m, slip, viscosity) in enumerate(
        zip(stretch.film_m, stretch.slip_rad_s, stretch.viscosity, strict=True)
    ):
        share = stribeck_weight(slip, friction)
        mu = kinetic_friction(slip, friction)
        by_film_nm_m = (
            _torque_nm(film_m + NUDGE_M, slip, viscosity, mu, law)
            - _torque_nm(film_m - NUDGE_M, slip, viscosity, mu, law)
        ) / (2.0 * NUDGE_M)
        per_mu_nm = contact_torque_nm(np.sign(slip), 1.0, contact_pressure_pa(film_m, law), law.contact_factor_m3)
        slopes[:, k] = -per_mu_nm / by_film_nm_m * np.array((1.0 - share, share))
    return slopes


def _torque_nm(film_m: float, slip_rad_s: float, viscosity: float, mu: float, law: FilmLaw) -> float:
    sign = math.copysign(1.0, slip_rad_s)
    contact_nm = contact_torque_nm(sign, mu, contact_pressure_pa(film_m, law), law.contact_factor_m3)
    return contact_nm + viscous_torque_nm(slip_rad_s, film_m, viscosity, law)


def _viscosities(temperature_k: FloatArray, oil: Viscosity) -> FloatArray:
    return viscosities_pa_s(temperature_k, oil.a_pa_s, oil.b_k, oil.pole_k)
