"""Lumped heat balance of a clutch pack and of the sump, docs/model.md section "Thermal"."""

from canlog.jit import kernel


@kernel
def clutch_heating_rate_k_s(
    friction_power_w: float, clutch_k: float, oil_k: float, heat_capacity_j_k: float, convection_w_k: float
) -> float:
    """Return the temperature rate of one clutch pack [K/s]: ``(|T_F*s| - hA*(T_c - T_oil)) / C_th``."""
    return (friction_power_w - convection_w_k * (clutch_k - oil_k)) / heat_capacity_j_k


@kernel
def sump_heating_rate_k_s(
    heat_from_clutches_w: float, oil_k: float, coolant_k: float, heat_capacity_j_k: float, convection_w_k: float
) -> float:
    """Return the temperature rate of the sump oil [K/s], cooled by the engine's coolant."""
    return (heat_from_clutches_w - convection_w_k * (oil_k - coolant_k)) / heat_capacity_j_k
