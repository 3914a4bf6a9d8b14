"""Everything constant over a drive, what the pedal asks for, and the questions that several controllers ask."""

from typing import NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DriveState, EventKind
from ecu_emulator.driving.parameters import DrivingParameters, PedalParameters
from ecu_emulator.plant.loop import DriveLaw
from ecu_emulator.shift_control import tcu_data

_CLOSED_MANIFOLD_RATIO = 0.25  # of ambient pressure, throttle closed, engine turned by the car
_CYCLE_RAD = 4.0 * np.pi


class DrivingLaw(NamedTuple):
    """A car, and how it is driven."""

    drive: DriveLaw
    driving: DrivingParameters


@part
def idle_rad_s(sense: FloatArray, law: DrivingLaw) -> float:
    """Return the speed the engine shall idle at [rad/s]: the colder the coolant, the faster."""
    p = law.driving.engine
    share = (sense[at.COOLANT] - p.cold_k) / (p.warm_k - p.cold_k)
    return float(p.cold_idle_rad_s + min(max(share, 0.0), 1.0) * (p.warm_idle_rad_s - p.cold_idle_rad_s))


@part
def overrun_nm(engine_rad_s: float, law: DrivingLaw) -> float:
    """Return the torque of the engine that the car turns, fuel cut [N m]: negative."""
    engine = law.drive.plant.engine
    pumping_nm = (1.0 - _CLOSED_MANIFOLD_RATIO) * engine.ambient_pressure_pa * engine.displacement_m3 / _CYCLE_RAD
    return float(-(engine.friction_nm + engine.friction_nms_rad * engine_rad_s + pumping_nm))


@part
def gear_speed_rad_s(sense: FloatArray, gear: int, law: DrivingLaw) -> float:
    """Return the speed of an input shaft that had this gear [rad/s]."""
    return float(sense[at.DIFF_SPEED] * law.drive.overall_ratios[gear])


@part
def enter_state(memory: FloatArray, state: int) -> None:
    memory[at.STATE] = state
    memory[at.STATE_TIME] = 0.0
    memory[tcu_data.PHASE] = tcu_data.HOLD
    memory[tcu_data.PHASE_TIME] = 0.0


@part
def begin_event(memory: FloatArray, kind: int) -> None:
    """Begin an event; one that was going on is over."""
    memory[at.EVENT_KIND] = kind
    memory[at.EVENT_COUNT] += 1.0
    memory[at.EVENT_NUMBER] = memory[at.EVENT_COUNT]
    memory[at.IS_ABORTED] = 0.0


@part
def end_event(memory: FloatArray) -> None:
    memory[at.EVENT_KIND] = EventKind.NONE.value
    memory[at.EVENT_NUMBER] = 0.0
    memory[at.IS_ABORTED] = 0.0


@part
def pulls_on_wheels(memory: FloatArray) -> bool:
    """Tell whether engine and wheels are connected well enough for the engine to brake the car."""
    return bool(memory[at.STATE] == DriveState.IN_GEAR.value or memory[at.STATE] == DriveState.CHANGING.value)


@part
def shift_shaft(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, shaft: int, gear: int, law: DrivingLaw
) -> bool:
    """Move an unloaded shaft to a gear, over neutral; True once the gear is engaged."""
    has_gear = int(sense[tcu_data.SHAFT_GEAR + shaft])
    is_engaged = sense[tcu_data.IS_ENGAGED + shaft] != 0.0
    if has_gear == gear:
        return bool(is_engaged)
    control = law.drive.control
    if has_gear != 0:
        if is_engaged and sense[tcu_data.FILL + shaft] < control.preselect_fill_ratio:
            commands[tcu_data.WANTED_GEAR + shaft] = 0.0
            memory[at.NEUTRAL_SINCE + shaft] = 0.0
        return False
    memory[at.NEUTRAL_SINCE + shaft] += tcu_data.PERIOD_S
    if memory[at.NEUTRAL_SINCE + shaft] >= control.neutral_time_s:
        commands[tcu_data.WANTED_GEAR + shaft] = gear
    return False


@part
def full_force_n(vehicle_m_s: float, p: PedalParameters) -> float:
    """Return the force at the wheels that the full pedal asks for [N]."""
    return min(p.force_n, p.power_w / max(vehicle_m_s, 1.0))


@part
def asked_force_n(pedal: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the force at the wheels [N] that a pedal asks for; released, the engine brakes with ``overrun_n`` < 0."""
    if pedal >= p.overrun_ratio:
        return (pedal - p.overrun_ratio) / (1.0 - p.overrun_ratio) * full_force_n(vehicle_m_s, p)
    return (1.0 - pedal / p.overrun_ratio) * overrun_n


@part
def pedal_for_force(force_n: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the pedal that asks for a force at the wheels: `asked_force_n` solved for it, within 0..1."""
    if force_n >= 0.0:
        share = force_n / full_force_n(vehicle_m_s, p)
        return min(p.overrun_ratio + share * (1.0 - p.overrun_ratio), 1.0)
    if overrun_n >= 0.0:
        return 0.0
    return max(p.overrun_ratio * (1.0 - force_n / overrun_n), 0.0)
