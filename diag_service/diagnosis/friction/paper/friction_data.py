"""From clutch torque to coefficient of friction, sample by sample; docs/model.md eq. (17)."""

from dataclasses import dataclass

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import kernel
from clutch_model.calibration import Viscosity
from clutch_model.clutch import ClutchCalibration
from clutch_model.film import FilmLaw, contact_pressure_pa, film_law, shear_factor_difference, viscous_torque_nm
from clutch_model.friction import FrictionLaw, contact_torques_nm, friction_law, stribeck_weight
from clutch_model.viscosity import viscosity_pa_s
from diag_service.diagnosis.friction.paper.paper_signals import BoolArray


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionData:
    """One point of the mu-v diagram per sample, and what the gates look at; all (n,)."""

    mu: FloatArray  # mu_i; 0 where the asperities carry nothing
    slip_rad_s: FloatArray
    shear_difference: FloatArray  # phi_f - phi_fs: which phase of lubrication
    pressure_rate_pa_s: FloatArray
    static_share: FloatArray  # e of eq. (18)
    is_shifting: BoolArray  # a shift is under way and its clutch has not stuck yet

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.mu)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchTorques:
    """Total and viscous torque of one clutch [N m], both (n,)."""

    friction_nm: FloatArray
    viscous_nm: FloatArray


def pooled(parts: list[FrictionData]) -> FrictionData:
    """Return the samples of several shifts or drives as one."""
    return FrictionData(
        mu=np.concatenate([part.mu for part in parts]),
        slip_rad_s=np.concatenate([part.slip_rad_s for part in parts]),
        shear_difference=np.concatenate([part.shear_difference for part in parts]),
        pressure_rate_pa_s=np.concatenate([part.pressure_rate_pa_s for part in parts]),
        static_share=np.concatenate([part.static_share for part in parts]),
        is_shifting=np.concatenate([part.is_shifting for part in parts]),
    )


def viscous_torques_nm(
    slip_rad_s: FloatArray, film_m: FloatArray, oil_k: FloatArray, clutch: ClutchCalibration, oil: Viscosity
) -> FloatArray:
    """Return the viscous torque [N m], shape (n,), for the film of the table and the oil's temperature, eq. (17)."""
    viscous_nm = np.empty_like(film_m)
    _fill_viscous(slip_rad_s, film_m, oil_k, (oil.a_pa_s, oil.b_k, oil.pole_k), film_law(clutch), viscous_nm)
    return viscous_nm


def friction_data(
    torques: ClutchTorques,
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    pressure_rate_pa_s: FloatArray,
    is_shifting: BoolArray,
    clutch: ClutchCalibration,
) -> FrictionData:
    """Return the friction coefficient ``(T_F - T_V)*sgn(s)/(C*P_C(h))`` of every sample."""
    law = film_law(clutch)
    contact_pa, shear, share = (np.empty_like(film_m) for _ in range(3))
    _fill_surface(slip_rad_s, film_m, law, friction_law(clutch.friction), contact_pa, shear, share)
    capacity_nm = contact_torques_nm(np.ones_like(contact_pa), 1.0, contact_pa, law.contact_factor_m3)
    contact_nm = (torques.friction_nm - torques.viscous_nm) * np.sign(slip_rad_s)
    mu = np.divide(contact_nm, capacity_nm, out=np.zeros_like(film_m), where=capacity_nm > 0.0)
    return FrictionData(
        mu=mu,
        slip_rad_s=slip_rad_s,
        shear_difference=shear,
        pressure_rate_pa_s=pressure_rate_pa_s,
        static_share=share,
        is_shifting=is_shifting,
    )


@kernel
def _fill_viscous(
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    oil_k: FloatArray,
    oil: tuple[float, float, float],
    law: FilmLaw,
    viscous_nm: FloatArray,
) -> None:
    for row in range(len(film_m)):
        viscosity = viscosity_pa_s(oil_k[row], oil[0], oil[1], oil[2])
        viscous_nm[row] = viscous_torque_nm(slip_rad_s[row], film_m[row], viscosity, law)


@kernel
def _fill_surface(
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    law: FilmLaw,
    friction: FrictionLaw,
    contact_pa: FloatArray,
    shear: FloatArray,
    share: FloatArray,
) -> None:
    for row in range(len(film_m)):
        contact_pa[row] = contact_pressure_pa(film_m[row], law)
        shear[row] = shear_factor_difference(film_m[row] / law.roughness_m)
        share[row] = stribeck_weight(slip_rad_s[row], friction)
