"""From engine and converter to the road: shafts, synchronisers, gears, wheels; docs/model.md "Engine", "Bodies"."""

import math
from typing import Final, NamedTuple

import numpy as np

from canlog.jit import part
from clutch_model.calibration import Converter

_AIR_GAS_CONSTANT_J_KG_K = 287.0
CYCLE_RAD = 4.0 * math.pi  # one four-stroke cycle
_STARTING_RAD_S = 1.0  # over which the losses change sign: they end at a standstill
FLOW_SHARPNESS = 9.0  # of the fit to compressible throttle flow, Cho and Hedrick 1989


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
        p.volumetric_efficiency_ratio * p.displacement_m3 * manifold_pa / (CYCLE_RAD * _AIR_GAS_CONSTANT_J_KG_K * air_k)
    )


@part
def manifold_rate_pa_s(
    manifold_pa: float, throttle_kg_s: float, engine_rad_s: float, air_k: float, p: EngineParameters
) -> float:
    inflow_kg_s = throttle_kg_s * (1.0 - math.exp(FLOW_SHARPNESS * (manifold_pa / p.ambient_pressure_pa - 1.0)))
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
    pumping_nm = (p.ambient_pressure_pa - manifold_pa) * p.displacement_m3 / CYCLE_RAD
    losses_nm = p.friction_nm + p.friction_nms_rad * engine_rad_s + pumping_nm
    return losses_nm * tanh_exact(engine_rad_s / _STARTING_RAD_S)


GRAVITY_M_S2 = 9.81
_ROLLING_SPEED_M_S = 0.1  # over which rolling resistance changes sign
_SATURATED = 20.0  # tanh is 1 to the last bit beyond
_LOSS_SPEED_RAD_S = 5.0  # over which the meshing loss changes sign

# What connects the gearbox end of an input shaft to the differential.
NEUTRAL = 0
SYNCHRONISING = 1
ENGAGED = 2


class VehicleParameters(NamedTuple):
    """Numbers of the body, tyres and brakes; undriven wheels are lumped into the mass."""

    mass_kg: float  # m
    wheel_radius_m: float  # R_w
    wheel_inertia_kg_m2: float  # J_W, both driven wheels
    wheel_damping_nms_rad: float  # B_W
    rolling_resistance_ratio: float  # f_r
    drag_area_m2: float  # CdA
    air_density_kg_m3: float  # rho
    tyre_stiffness_n: float  # C_kappa
    tyre_friction_ratio: float  # mu_t
    driven_load_ratio: float  # share of the weight on the driven axle
    driven_brake_ratio: float  # share of the brake force on the driven axle


@part
def tanh_exact(x: float) -> float:
    """Return tanh(x), without computing it where it is 1 to the last bit."""
    if x > _SATURATED:
        return 1.0
    if x < -_SATURATED:
        return -1.0
    return math.tanh(x)


@part
def tyre_force_n(wheel_rad_s: float, vehicle_m_s: float, p: VehicleParameters) -> float:
    """Return the traction of the driven axle F_x [N]."""
    slip_ratio = (p.wheel_radius_m * wheel_rad_s - vehicle_m_s) / max(abs(vehicle_m_s), 1.0)
    grip_n = p.tyre_friction_ratio * p.driven_load_ratio * p.mass_kg * GRAVITY_M_S2
    return grip_n * tanh_exact(p.tyre_stiffness_n * slip_ratio / grip_n)


@part
def brake_force_n(deceleration_m_s2: float, vehicle_m_s: float, full_brake_m_s: float, p: VehicleParameters) -> float:
    """Return the total brake force F_b [N], faded out below a speed; what holds the car at rest is no force."""
    return p.mass_kg * deceleration_m_s2 * min(max(vehicle_m_s / full_brake_m_s, -1.0), 1.0)


@part
def road_load_n(vehicle_m_s: float, grade_ratio: float, p: VehicleParameters) -> float:
    """Return rolling, grade and air resistance [N]."""
    rolling = p.rolling_resistance_ratio * tanh_exact(vehicle_m_s / _ROLLING_SPEED_M_S)
    drag_n = 0.5 * p.air_density_kg_m3 * p.drag_area_m2 * vehicle_m_s * abs(vehicle_m_s)
    return p.mass_kg * GRAVITY_M_S2 * (rolling + grade_ratio) + drag_n


class FlywheelParameters(NamedTuple):
    """Compliance between engine and clutch hub."""

    stiffness_nm_rad: float  # k_FW
    damping_nms_rad: float  # c_FW


class ShaftParameters(NamedTuple):
    """One compliant input shaft and the inertia at each end."""

    clutch_inertia_kg_m2: float  # J_L
    clutch_damping_nms_rad: float  # B_L
    gear_inertia_kg_m2: float  # J_G
    gear_damping_nms_rad: float  # B_G
    stiffness_nm_rad: float  # k_si
    damping_nms_rad: float  # c_si


class SynchroniserParameters(NamedTuple):
    """Gear meshing and synchronisers."""

    efficiency_ratio: float  # eta_g
    torque_nm: float  # T_syn
    full_torque_slip_rad_s: float  # slip from which the cone gives its full torque
    lock_slip_rad_s: float  # slip below which the sleeve goes through


class OutputParameters(NamedTuple):
    """Differential and output shafts."""

    inertia_kg_m2: float  # J_D
    damping_nms_rad: float  # B_D
    stiffness_nm_rad: float  # k_OS
    shaft_damping_nms_rad: float  # c_OS


@part
def twist_torque_nm(twist_rad: float, rate_rad_s: float, stiffness_nm_rad: float, damping_nms_rad: float) -> float:
    """Return the torque of a sprung and damped shaft [N m]."""
    return stiffness_nm_rad * twist_rad + damping_nms_rad * rate_rad_s


@part
def geared_torque_nm(shaft_nm: float, gear_rad_s: float, efficiency_ratio: float, damping_nms_rad: float) -> float:
    """Return what an engaged gear passes on of its shaft's torque [N m], T_g."""
    loss_nm = (1.0 - efficiency_ratio) * abs(shaft_nm) * tanh_exact(gear_rad_s / _LOSS_SPEED_RAD_S)
    return shaft_nm - loss_nm - damping_nms_rad * gear_rad_s


@part
def synchroniser_torque_nm(slip_rad_s: float, p: SynchroniserParameters) -> float:
    """Return the cone torque T_sy [N m] for a slip ``i*w_D - w_G``."""
    return p.torque_nm * max(-1.0, min(1.0, slip_rad_s / p.full_torque_slip_rad_s))


PLACES: Final = 101  # of the characteristic, evenly from stall to equal speeds
_LAG_S: Final = 0.05  # of the torque behind its map: oil in the torus changes its speed (Hrovat and Tobler 1985)


class ConverterLaw(NamedTuple):
    """A converter as the kernels take it, or none."""

    is_there: int
    capacities_nm_s2: tuple[float, ...]  # torque of the impeller over its speed squared
    torque_ratios: tuple[float, ...]
    lag_s: float


def converter_law(converter: Converter | None) -> ConverterLaw:
    """Return the characteristic on an even grid; straight lines between the points that are told."""
    if converter is None:
        return ConverterLaw(0, (0.0,) * PLACES, (0.0,) * PLACES, _LAG_S)
    grid = np.linspace(0.0, 1.0, PLACES)
    capacities = np.interp(grid, converter.speed_ratios, converter.capacities_nm_s2)
    ratios = np.interp(grid, converter.speed_ratios, converter.torque_ratios)
    return ConverterLaw(1, tuple(capacities.tolist()), tuple(ratios.tolist()), _LAG_S)


@part
def _at(column: tuple[float, ...], speed_ratio: float) -> float:
    place = min(max(speed_ratio, 0.0), 1.0) * (PLACES - 1)
    index = min(int(place), PLACES - 2)
    return float(column[index] + (place - index) * (column[index + 1] - column[index]))


@part
def impeller_torque_nm(impeller_rad_s: float, turbine_rad_s: float, law: ConverterLaw) -> float:
    """Return the torque that the converter takes from the engine in the steady state [N m], eq. (C1).

    A turbine that is faster drives the impeller as a fluid coupling does, whose two wheels are alike.
    """
    if impeller_rad_s >= turbine_rad_s:
        if impeller_rad_s <= 0.0:
            return 0.0
        return _at(law.capacities_nm_s2, turbine_rad_s / impeller_rad_s) * impeller_rad_s * impeller_rad_s
    if turbine_rad_s <= 0.0:
        return 0.0
    return -_at(law.capacities_nm_s2, impeller_rad_s / turbine_rad_s) * turbine_rad_s * turbine_rad_s


@part
def torque_ratio(impeller_rad_s: float, turbine_rad_s: float, law: ConverterLaw) -> float:
    """Return the torque of the turbine over that of the impeller, eq. (C2): 1 on the overrun."""
    if impeller_rad_s <= 0.0 or turbine_rad_s >= impeller_rad_s:
        return 1.0
    return _at(law.torque_ratios, turbine_rad_s / impeller_rad_s)
