"""From clutch torque to coefficient of friction, sample by sample; docs/model.md eq. (17)."""

from dataclasses import dataclass, fields

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.jit import kernel
from clutch_model.calibration import ClutchCalibration, Viscosity
from clutch_model.pack import (
    FilmLaw,
    FrictionLaw,
    applied_pressure_pa,
    contact_pressure_pa,
    contact_torques_nm,
    equilibrium_film_m,
    film_law,
    friction_law,
    shear_factor_difference,
    stribeck_weight,
    viscosity_pa_s,
    viscous_torque_nm,
)

TABLE_END_PA = 16.0e5  # above the line pressure
TABLE_STEP_PA = 500.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmTable:
    """The paper's lookup table of film thickness over clutch pressure; linear between the points, constant beyond."""

    pressure_pa: FloatArray  # (k,), rising
    film_m: FloatArray  # (k,)

    def film_at(self, pressure_pa: FloatArray) -> FloatArray:
        """Return the film thickness [m] at each pressure, same shape."""
        film_m: FloatArray = np.interp(pressure_pa, self.pressure_pa, self.film_m)
        return film_m


def static_table(law: FilmLaw) -> FilmTable:
    """Return the table of equilibria: inverse of P_C, the open gap below the touch point."""
    pressure_pa = np.arange(0.0, TABLE_END_PA, TABLE_STEP_PA)
    film_m = np.array([equilibrium_film_m(applied_pressure_pa(float(one), law), law) for one in pressure_pa])
    return FilmTable(pressure_pa=pressure_pa, film_m=film_m)


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


def pooled(parts: list[FrictionData]) -> FrictionData:
    """Return the samples of several shifts or drives as one."""
    columns = {one.name: np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(FrictionData)}
    return FrictionData(**columns)


def viscous_torques_nm(
    slip_rad_s: FloatArray, film_m: FloatArray, oil_k: FloatArray, clutch: ClutchCalibration, oil: Viscosity
) -> FloatArray:
    """Return the viscous torque [N m], shape (n,), for the film of the table and the oil's temperature, eq. (17)."""
    viscous_nm = np.empty_like(film_m)
    _fill_viscous(slip_rad_s, film_m, oil_k, (oil.a_pa_s, oil.b_k, oil.pole_k), film_law(clutch), viscous_nm)
    return viscous_nm


def friction_data(
    contact_nm: FloatArray,
    slip_rad_s: FloatArray,
    film_m: FloatArray,
    pressure_rate_pa_s: FloatArray,
    is_shifting: BoolArray,
    clutch: ClutchCalibration,
) -> FrictionData:
    """Return the friction coefficient ``(T_F - T_V)*sgn(s)/(C*P_C(h))`` per sample; ``contact_nm`` is ``T_F - T_V``."""
    law = film_law(clutch)
    contact_pa, shear, share = (np.empty_like(film_m) for _ in range(3))
    _fill_surface(slip_rad_s, film_m, law, friction_law(clutch.friction), contact_pa, shear, share)
    capacity_nm = contact_torques_nm(np.ones_like(contact_pa), 1.0, contact_pa, law.contact_factor_m3)
    mu = np.divide(contact_nm * np.sign(slip_rad_s), capacity_nm, out=np.zeros_like(film_m), where=capacity_nm > 0.0)
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
