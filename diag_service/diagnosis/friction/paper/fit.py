"""The gates of the paper and the two numbers that it draws from what passes them; docs/model.md eq. (18)."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from canlog.arrays import BoolArray
from clutch_model.calibration import FrictionCurve
from diag_service.diagnosis.friction.paper.friction_data import FrictionData


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
