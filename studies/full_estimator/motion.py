"""The motion of hub, differential, half shafts and car as the exact torques drive it; docs/model.md eqs. (26) and (27).

With both shafts in gear each clutch's gearbox side turns with the differential but for the twist of its shaft. So the
clutch torques, ``T_F = T_si + B_L*w_L + J_L*w_L'``, leave the hub's equation, and nothing unknown drives it.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from studies.full_estimator.shaft_twist import Twist, shaft_twist
from studies.full_estimator.signals import BoolArray, FullSignals
from studies.full_estimator.vehicle import Vehicle
from canlog.arrays import FloatArray
from clutch_model.calibration import InputSide
from diag_service.diagnosis.friction.paper.driveline import Driveline


class State(IntEnum):
    """Places in the state vector."""

    HUB_SPEED = 0
    DIFF_SPEED = 1
    OUTPUT_TWIST = 2
    WHEEL_SPEED = 3
    VEHICLE_SPEED = 4
    ROAD_LOAD = 5  # everything that slows the car: air, road, grade, brake


class MotionLaw(NamedTuple):
    """Constants of the motion in the form the kernels take."""

    hub_inertia_kg_m2: float
    hub_damping_nms_rad: float
    output_damping_nms_rad: float
    output_stiffness_nm_rad: float
    output_shaft_damping_nms_rad: float
    wheel_inertia_kg_m2: float
    wheel_damping_nms_rad: float
    wheel_radius_m: float
    mass_kg: float
    tyre_stiffness_n: float
    tyre_grip_n: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Forcing:
    """What drives the motion at every sample."""

    ratio: FloatArray  # (2, n) overall ratio of the gear on each shaft, 0 while none is engaged
    twist: tuple[Twist, Twist]
    hub_nm: FloatArray  # (n,) on the hub, what the gearbox sides take up of it by twisting deducted
    hub_share_kg_m2: FloatArray  # (n,) inertia that ties the hub's equation to the differential: sum of J_L*i
    hub_drag_nms_rad: FloatArray  # (n,) sum of B_L*i
    diff_nm: FloatArray  # (n,) on the differential
    diff_inertia_kg_m2: FloatArray  # (n,)
    diff_drag_nms_rad: FloatArray  # (n,)
    is_coupled: BoolArray  # (n,) both shafts are in gear: nothing is unknown but the road load


def motion_law(side: InputSide, driveline: Driveline, vehicle: Vehicle) -> MotionLaw:
    """Return the kernel form of the constants."""
    return MotionLaw(
        hub_inertia_kg_m2=float(side.hub_inertia_kg_m2),
        hub_damping_nms_rad=float(side.hub_damping_nms_rad),
        output_damping_nms_rad=vehicle.output_damping_nms_rad,
        output_stiffness_nm_rad=driveline.output.stiffness_nm_rad,
        output_shaft_damping_nms_rad=driveline.output.damping_nms_rad,
        wheel_inertia_kg_m2=vehicle.wheel_inertia_kg_m2,
        wheel_damping_nms_rad=vehicle.wheel_damping_nms_rad,
        wheel_radius_m=driveline.wheel.radius_m,
        mass_kg=vehicle.mass_kg,
        tyre_stiffness_n=vehicle.tyre_stiffness_n,
        tyre_grip_n=vehicle.tyre_grip_n,
    )


def forcing(signals: FullSignals, driveline: Driveline, vehicle: Vehicle) -> Forcing:
    """Return what the exact torques make of the motion."""
    ratios = np.concatenate(((0.0,), driveline.overall_ratios))[signals.gears]
    first, second = (
        shaft_twist(torque_nm, signals.period_s, shaft)
        for torque_nm, shaft in zip(signals.shaft_nm, driveline.shafts, strict=True)
    )
    hub_nm = signals.flywheel_nm.copy()
    diff_nm, share, drag = (np.zeros_like(hub_nm) for _ in range(3))
    diff_inertia = np.full_like(hub_nm, driveline.output.inertia_kg_m2)
    diff_drag = np.full_like(hub_nm, vehicle.output_damping_nms_rad)
    for m, (twist, shaft) in enumerate(zip((first, second), driveline.shafts, strict=True)):
        ratio, shaft_nm = ratios[m], signals.shaft_nm[m]
        is_engaged = ratio > 0.0
        bent_nm = shaft.clutch_inertia_kg_m2 * twist.acceleration_rad_s2
        hub_nm -= is_engaged * (shaft_nm + bent_nm + shaft.clutch_damping_nms_rad * twist.rate_rad_s)
        share += shaft.clutch_inertia_kg_m2 * ratio
        drag += shaft.clutch_damping_nms_rad * ratio
        diff_nm += ratio * (shaft_nm - (1.0 - vehicle.efficiency_ratio) * np.abs(shaft_nm))
        diff_inertia += shaft.gear_inertia_kg_m2 * ratio**2
        diff_drag += shaft.gear_damping_nms_rad * ratio**2
    return Forcing(
        ratio=ratios,
        twist=(first, second),
        hub_nm=hub_nm,
        hub_share_kg_m2=share,
        hub_drag_nms_rad=drag,
        diff_nm=diff_nm,
        diff_inertia_kg_m2=diff_inertia,
        diff_drag_nms_rad=diff_drag,
        is_coupled=(signals.gears[0] > 0) & (signals.gears[1] > 0),
    )


def diff_acceleration_rad_s2(states: FloatArray, forced: Forcing, law: MotionLaw) -> FloatArray:
    """Return the acceleration of the differential, shape (n,), for states (n, 6)."""
    twist_rate = states[:, State.DIFF_SPEED] - states[:, State.WHEEL_SPEED]
    output_nm = law.output_stiffness_nm_rad * states[:, State.OUTPUT_TWIST]
    output_nm = output_nm + law.output_shaft_damping_nms_rad * twist_rate
    net_nm = forced.diff_nm - forced.diff_drag_nms_rad * states[:, State.DIFF_SPEED] - output_nm
    acceleration: FloatArray = net_nm / forced.diff_inertia_kg_m2
    return acceleration
