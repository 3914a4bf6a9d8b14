"""Lumped heat balance of a clutch pack and of the sump, docs/model.md section "Thermal"."""

import math

from canlog.jit import kernel


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
