"""Driven wheels, tyre and body, docs/model.md section "Bodies"."""

import math
from typing import NamedTuple

from canlog.jit import kernel

GRAVITY_M_S2 = 9.81
_ROLLING_SPEED_M_S = 0.1  # over which rolling resistance changes sign
_SATURATED = 20.0  # tanh is 1 to the last bit beyond


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


@kernel
def tanh_exact(x: float) -> float:
    """Return tanh(x), without computing it where it is 1 to the last bit."""
    if x > _SATURATED:
        return 1.0
    if x < -_SATURATED:
        return -1.0
    return math.tanh(x)


@kernel
def tyre_force_n(wheel_rad_s: float, vehicle_m_s: float, p: VehicleParameters) -> float:
    """Return the traction of the driven axle F_x [N]."""
    slip_ratio = (p.wheel_radius_m * wheel_rad_s - vehicle_m_s) / max(abs(vehicle_m_s), 1.0)
    grip_n = p.tyre_friction_ratio * p.driven_load_ratio * p.mass_kg * GRAVITY_M_S2
    return grip_n * tanh_exact(p.tyre_stiffness_n * slip_ratio / grip_n)


@kernel
def brake_force_n(deceleration_m_s2: float, vehicle_m_s: float, full_brake_m_s: float, p: VehicleParameters) -> float:
    """Return the total brake force F_b [N], faded out below a speed; what holds the car at rest is no force."""
    return p.mass_kg * deceleration_m_s2 * min(max(vehicle_m_s / full_brake_m_s, -1.0), 1.0)


@kernel
def road_load_n(vehicle_m_s: float, grade_ratio: float, p: VehicleParameters) -> float:
    """Return rolling, grade and air resistance [N]."""
    rolling = p.rolling_resistance_ratio * tanh_exact(vehicle_m_s / _ROLLING_SPEED_M_S)
    drag_n = 0.5 * p.air_density_kg_m3 * p.drag_area_m2 * vehicle_m_s * abs(vehicle_m_s)
    return p.mass_kg * GRAVITY_M_S2 * (rolling + grade_ratio) + drag_n
