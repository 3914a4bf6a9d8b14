"""Mean-value engine: intake manifold and crankshaft torque, docs/model.md section "Engine"."""

import math
from typing import NamedTuple

from canlog.jit import part
from ecu_emulator.plant.driveline import tanh_exact

_AIR_GAS_CONSTANT_J_KG_K = 287.0
_CYCLE_RAD = 4.0 * math.pi  # one four-stroke cycle
_STARTING_RAD_S = 1.0  # over which the losses change sign: they end at a standstill
_SHARPNESS = 9.0  # of the fit to compressible throttle flow, Cho and Hedrick 1989


class EngineParameters(NamedTuple):
    """Numbers of the engine, as the kernels take them."""

    displacement_m3: float  # V_d
    manifold_volume_m3: float  # V_m
    max_air_flow_kg_s: float  # MAX
    friction_nm: float  # T_f0
    friction_nms_rad: float  # T_f1
    volumetric_efficiency_ratio: float  # eta_v
    torque_per_air_j_kg: float  # c_T
    closed_throttle_rad: float  # a_idle
    throttle_lag_s: float  # tau_th
    spark_lag_s: float  # tau_sp
    ripple_ratio: float  # amplitude of the firing torque, three per crank turn
    ambient_pressure_pa: float  # p_a


@part
def throttle_flow_kg_s(throttle: float, p: EngineParameters) -> float:
    """Return the air flow at sonic throat [kg/s] of a throttle opened 0..1."""
    angle_rad = p.closed_throttle_rad + (0.5 * math.pi - p.closed_throttle_rad) * throttle
    return p.max_air_flow_kg_s * (1.0 - math.cos(angle_rad))


@part
def cylinder_air_kg_rad(manifold_pa: float, air_k: float, p: EngineParameters) -> float:
    """Return the air drawn per crank angle [kg/rad], mdot_cyl / w_E."""
    return (
        p.volumetric_efficiency_ratio
        * p.displacement_m3
        * manifold_pa
        / (_CYCLE_RAD * _AIR_GAS_CONSTANT_J_KG_K * air_k)
    )


@part
def manifold_rate_pa_s(
    manifold_pa: float, throttle_kg_s: float, engine_rad_s: float, air_k: float, p: EngineParameters
) -> float:
    inflow_kg_s = throttle_kg_s * (1.0 - math.exp(_SHARPNESS * (manifold_pa / p.ambient_pressure_pa - 1.0)))
    outflow_kg_s = cylinder_air_kg_rad(manifold_pa, air_k, p) * engine_rad_s
    return _AIR_GAS_CONSTANT_J_KG_K * air_k / p.manifold_volume_m3 * (inflow_kg_s - outflow_kg_s)


@part
def mean_indicated_torque_nm(manifold_pa: float, spark: float, air_k: float, p: EngineParameters) -> float:
    """Return the torque of combustion [N m] without its pulses; ``spark`` is its factor, 1 at best timing."""
    return p.torque_per_air_j_kg * cylinder_air_kg_rad(manifold_pa, air_k, p) * spark


@part
def indicated_torque_nm(manifold_pa: float, spark: float, crank_rad: float, air_k: float, p: EngineParameters) -> float:
    """Return the torque of combustion [N m] at a crank angle."""
    torque_nm = mean_indicated_torque_nm(manifold_pa, spark, air_k, p)
    if p.ripple_ratio == 0.0:
        return torque_nm
    return torque_nm * (1.0 + p.ripple_ratio * math.sin(3.0 * crank_rad))


@part
def engine_losses_nm(manifold_pa: float, engine_rad_s: float, p: EngineParameters) -> float:
    """Return friction and pumping torque [N m]; none at a standstill."""
    pumping_nm = (p.ambient_pressure_pa - manifold_pa) * p.displacement_m3 / _CYCLE_RAD
    losses_nm = p.friction_nm + p.friction_nms_rad * engine_rad_s + pumping_nm
    return losses_nm * tanh_exact(engine_rad_s / _STARTING_RAD_S)
