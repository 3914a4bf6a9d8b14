"""Flywheel, input shafts, synchronisers, gears and output shafts, docs/model.md section "Bodies"."""

from typing import NamedTuple

from canlog.jit import kernel
from ecu_emulator.plant.vehicle import tanh_exact

_LOSS_SPEED_RAD_S = 5.0  # over which the meshing loss changes sign

# What connects the gearbox end of an input shaft to the differential.
NEUTRAL = 0
SYNCHRONISING = 1
ENGAGED = 2


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


@kernel
def twist_torque_nm(twist_rad: float, rate_rad_s: float, stiffness_nm_rad: float, damping_nms_rad: float) -> float:
    """Return the torque of a sprung and damped shaft [N m]."""
    return stiffness_nm_rad * twist_rad + damping_nms_rad * rate_rad_s


@kernel
def geared_torque_nm(shaft_nm: float, gear_rad_s: float, efficiency_ratio: float, damping_nms_rad: float) -> float:
    """Return what an engaged gear passes on of its shaft's torque [N m], T_g."""
    loss_nm = (1.0 - efficiency_ratio) * abs(shaft_nm) * tanh_exact(gear_rad_s / _LOSS_SPEED_RAD_S)
    return shaft_nm - loss_nm - damping_nms_rad * gear_rad_s


@kernel
def synchroniser_torque_nm(slip_rad_s: float, p: SynchroniserParameters) -> float:
    """Return the cone torque T_sy [N m] for a slip ``i*w_D - w_G``."""
    return p.torque_nm * max(-1.0, min(1.0, slip_rad_s / p.full_torque_slip_rad_s))
