"""What friction makes: the torque of the asperities that touch, and the heat of pack and sump, docs/model.md "Thermal".

A law in the plural takes numbers or whole arrays; its singular is the same law, compiled for other kernels to call.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from canlog.jit import kernel, unchecked_kernel
from clutch_model.calibration import FrictionCurve, clutch_of_gear
from clutch_model.row_functions import row_exponential, row_logarithm
from clutch_model.units import Quantity

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
    """Return the kernel form of a friction curve."""
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
