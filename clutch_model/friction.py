"""Kinetic friction coefficient of a wet lining and the torque of the asperities that touch."""

import math
from typing import NamedTuple

from canlog.jit import kernel
from clutch_model.clutch import FrictionCurve


class FrictionLaw(NamedTuple):
    """Stribeck curve, eq. (8), in the form the kernels take."""

    mu_c: float
    mu_s: float
    stribeck_speed_rad_s: float
    stribeck_exponent: float
    lock_band_rad_s: float


def friction_law(curve: FrictionCurve) -> FrictionLaw:
    """Return the kernel form of a friction curve."""
    return FrictionLaw(
        mu_c=float(curve.mu_c),
        mu_s=float(curve.mu_s),
        stribeck_speed_rad_s=float(curve.stribeck_speed_rad_s),
        stribeck_exponent=float(curve.stribeck_exponent),
        lock_band_rad_s=float(curve.lock_band_rad_s),
    )


@kernel
def stribeck_weight(slip_rad_s: float, law: FrictionLaw) -> float:
    """Return the share of ``mu_s`` in the friction coefficient, 1 at lock and 0 at high slip: ``e`` of eq. (18)."""
    excess = (abs(slip_rad_s) - law.lock_band_rad_s) / law.stribeck_speed_rad_s
    if excess <= 0.0:
        return 1.0
    if law.stribeck_exponent != 1.0:
        excess = math.exp(law.stribeck_exponent * math.log(excess))
    return math.exp(-excess)


@kernel
def kinetic_friction(slip_rad_s: float, law: FrictionLaw) -> float:
    """Return the friction coefficient mu_K at a slip speed of either sign; docs/model.md eq. (8)."""
    return law.mu_c + (law.mu_s - law.mu_c) * stribeck_weight(slip_rad_s, law)


@kernel
def contact_torque_nm(direction: float, mu: float, contact_pa: float, contact_factor_m3: float) -> float:
    """Return the torque of the asperity contact [N m], positive for hub-faster slip; docs/model.md eq. (6).

    ``direction`` is the sign of the slip, chosen by the caller inside the lock band.
    """
    return direction * mu * contact_pa * contact_factor_m3
