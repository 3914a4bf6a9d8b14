"""From clutch torque to coefficients of friction (docs/model.md eq. 17), their gates, and the two numbers (eq. 18)."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.jit import kernel
from clutch_model.calibration import ClutchCalibration, FrictionCurve, Viscosity
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


class Gate(StrEnum):
    """The conditions a sample must meet, each in the order in which the paper names them."""

    SHIFTING = "a shift is under way"
    STICK = "0 < |slip| - w_rel <= stick tolerance"
    MECHANICAL = "mechanical contact"
    NEAR_PRIOR = "near the previous mu_S"
    PARTIAL = "partial lubrication"
    SLIPPING = "slip above its minimum"
    STROKING = "pressure rises fast"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """The numbers of the gates; None switches one off."""

    stick_tolerance_rad_s: float = 0.5
    mechanical_shear_max: float = 0.6  # also where partial lubrication begins
    partial_shear_max: float = 0.85
    slip_min_rad_s: float = 1.0
    is_shift_required: bool = True  # the torque is found "during a gear shift", which ends when the clutch sticks
    is_slip_signed: bool = True  # printed without bars: only clutches whose hub is faster
    prior_tolerance_ratio: float | None = None
    pressure_rate_min_pa_s: float | None = None


NOISELESS_GATES = Gates()
NOISY_GATES = Gates(prior_tolerance_ratio=0.20, pressure_rate_min_pa_s=2.0e5)  # the paper's X is lost: chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperEstimate:
    """Friction of one clutch as the paper estimates it; it states no uncertainty. None: no sample passed."""

    mu_c: float | None
    mu_s: float | None
    static_counts: Mapping[Gate, int]  # samples left after each gate of mu_S
    coulomb_counts: Mapping[Gate, int]  # samples left after each gate of mu_C

    @property
    def static_count(self) -> int:
        """Samples that speak of mu_S."""
        return min(self.static_counts.values())

    @property
    def coulomb_count(self) -> int:
        """Samples that speak of mu_C."""
        return min(self.coulomb_counts.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class Passed:
    """Which samples pass all gates, and how many are left after each."""

    rows: BoolArray
    counts: Mapping[Gate, int]


def static_gate(data: FrictionData, gates: Gates, lock_band_rad_s: float, prior_mu_s: float) -> Passed:
    """Return the samples that speak of mu_S: slow slip in mechanical contact."""
    excess_rad_s = np.abs(data.slip_rad_s) - lock_band_rad_s
    conditions = {
        Gate.SHIFTING: _in_shift(data, gates),
        Gate.STICK: (excess_rad_s > 0.0) & (excess_rad_s <= gates.stick_tolerance_rad_s),
        Gate.MECHANICAL: data.shear_difference < gates.mechanical_shear_max,
    }
    if gates.prior_tolerance_ratio is not None:
        conditions[Gate.NEAR_PRIOR] = np.abs(data.mu - prior_mu_s) <= gates.prior_tolerance_ratio * prior_mu_s
    return _through(conditions)


def coulomb_gate(data: FrictionData, gates: Gates) -> Passed:
    """Return the samples that speak of mu_C: partial lubrication, slipping, with noise also stroking."""
    slip_rad_s = data.slip_rad_s if gates.is_slip_signed else np.abs(data.slip_rad_s)
    conditions = {
        Gate.SHIFTING: _in_shift(data, gates),
        Gate.PARTIAL: (data.shear_difference > gates.mechanical_shear_max)
        & (data.shear_difference < gates.partial_shear_max),
        Gate.SLIPPING: slip_rad_s > gates.slip_min_rad_s,
    }
    if gates.pressure_rate_min_pa_s is not None:
        conditions[Gate.STROKING] = data.pressure_rate_pa_s > gates.pressure_rate_min_pa_s
    return _through(conditions)


def fit(data: FrictionData, gates: Gates, curve: FrictionCurve, prior_mu_s: float | None = None) -> PaperEstimate:
    """Return mu_S, the mean of its samples, and mu_C by least squares with that mu_S, eq. (18).

    ``prior_mu_s`` is the previous estimate; the paper does not say what it starts from, here the curve's own. Where no
    sample speaks of mu_S, mu_C is found with the previous one.
    """
    prior = curve.mu_s if prior_mu_s is None else prior_mu_s
    static = static_gate(data, gates, curve.lock_band_rad_s, prior)
    coulomb = coulomb_gate(data, gates)
    mu_s = float(np.mean(data.mu[static.rows])) if static.rows.any() else None
    share = data.static_share[coulomb.rows]
    weight = float(np.sum((1.0 - share) ** 2))
    latest_mu_s = prior if mu_s is None else mu_s
    mu_c = (
        float(np.sum((1.0 - share) * (data.mu[coulomb.rows] - latest_mu_s * share))) / weight if weight > 0.0 else None
    )
    return PaperEstimate(mu_c=mu_c, mu_s=mu_s, static_counts=static.counts, coulomb_counts=coulomb.counts)


def _in_shift(data: FrictionData, gates: Gates) -> BoolArray:
    return data.is_shifting if gates.is_shift_required else np.ones(len(data), np.bool_)


def _through(conditions: Mapping[Gate, BoolArray]) -> Passed:
    counts: dict[Gate, int] = {}
    rows: BoolArray | None = None
    for gate, condition in conditions.items():
        rows = condition if rows is None else rows & condition
        counts[gate] = int(np.count_nonzero(rows))
    return Passed(rows=np.empty(0, np.bool_) if rows is None else rows, counts=MappingProxyType(counts))
