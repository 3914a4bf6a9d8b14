"""The compiled loop of a drive: each millisecond driver and controllers act, a row is recorded, the plant advances.

The driver looks ahead along the trace and moves the feet, no faster than feet move.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from canlog.jit import kernel, part
from ecu_emulator.driving import automatic, indices
from ecu_emulator.driving.control import control, have_whim
from ecu_emulator.driving.engine_control import control_engine
from ecu_emulator.driving.indices import DrivelineState, EngineMode
from ecu_emulator.driving.laws import DrivingLaw, overrun_nm, pedal_for_force, pulls_on_wheels
from ecu_emulator.plant import state as at
from ecu_emulator.plant.driveline import road_load_n
from ecu_emulator.plant.integration import Machine, advance_millisecond
from ecu_emulator.plant.loop import apply_commands, hold_car, record_control, record_plant, sense_plant
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control import tcu_data


class Road(NamedTuple):
    """What a drive meets: read only."""

    speeds: FloatArray  # (n,), every `GRID_S` [m/s]
    grades: FloatArray  # (n,)
    whims: FloatArray  # (m, indices.WHIM_COLUMN_COUNT), one row per event
    end: npt.NDArray[np.int64]  # (1,), milliseconds of the whole drive


@part
def sense_drive(machine: Machine, road: Road, law: DrivingLaw) -> None:
    sense_plant(machine, law.drive.plant)
    y, sense = machine.y, machine.sense
    sense[indices.VEHICLE_SPEED] = y[at.V]
    sense[indices.DIFF_SPEED] = y[at.W_D]
    sense[indices.SHAFT_SPEED] = y[at.W_L]
    sense[indices.SHAFT_SPEED + 1] = y[at.W_L + 1]
    sense[indices.HUB_SPEED] = y[at.W_H]
    sense[indices.MANIFOLD] = y[at.P_M]
    sense[indices.OIL] = y[at.T_OIL]
    sense[indices.COOLANT] = machine.u[at.COOLANT]
    sense[indices.TURBINE_SPEED] = y[at.W_G]
    sense[indices.TURBINE_TORQUE] = machine.work.slope1[at.T_TURBINE]
    sense[indices.IMPELLER_TORQUE] = machine.work.slope1[at.T_IMPELLER]
    sense[indices.GEAR_RATIO] = y[at.GEAR_RATIO]
    sense[indices.GRADE] = trace_value(road.grades, machine.clock[0] * tcu_data.PERIOD_S)


@part
def apply_drive_commands(machine: Machine, law: DrivingLaw) -> None:
    """Turn the commands into inputs of the plant; a running engine warms its coolant, the air cools it."""
    p, u, coolant_k = law.driving.surroundings, machine.u, machine.u[at.COOLANT]
    is_running = machine.memory[indices.ENGINE_STATE] <= EngineMode.FUEL_CUT.value
    goal_k = p.thermostat_k if is_running else law.drive.plant.air_k
    apply_commands(machine, law.drive)
    u[at.COOLANT] = coolant_k + tcu_data.PERIOD_S / p.coolant_time_s * (goal_k - coolant_k)
    u[at.PEDAL] = machine.memory[indices.PEDAL]
    u[at.GRADE] = machine.sense[indices.GRADE]
    u[at.STARTER] = machine.commands[indices.STARTER]
    u[at.RATIO_RATE] = machine.commands[indices.RATIO_RATE]
    for k in range(2):
        share = u[at.VISCOSITY + k] / p.open_drag_viscosity_pa_s
        u[at.OPEN_DRAG + k] = p.open_drag_nm * math.exp(p.open_drag_exponent * math.log(share))


@part
def record_drive(machine: Machine, road: Road, row: FloatArray) -> None:
    """Write what driver and controllers show of themselves."""
    memory, u = machine.memory, machine.u
    record_control(machine, row)
    row[Col.ROUTINE] = row[Col.REV] = 0.0
    row[Col.DRIVE_STATE] = memory[indices.STATE]
    row[Col.EVENT_KIND] = memory[indices.EVENT_KIND]
    row[Col.EVENT_NUMBER] = memory[indices.EVENT_NUMBER]
    row[Col.IS_ABORTED] = memory[indices.IS_ABORTED]
    row[Col.ENGINE_STATE] = memory[indices.ENGINE_STATE]
    row[Col.COOLANT_TEMPERATURE] = u[at.COOLANT]
    row[Col.GRADE] = u[at.GRADE]
    row[Col.TURBINE_SPEED] = machine.y[at.W_G]
    row[Col.IMPELLER_TORQUE] = machine.work.slope1[at.T_IMPELLER]
    row[Col.TURBINE_TORQUE] = machine.work.slope1[at.T_TURBINE]
    row[Col.LOCKUP_STATE] = memory[indices.LOCKUP_STATE]
    row[Col.WANTED_SPEED] = trace_value(road.speeds, machine.clock[0] * tcu_data.PERIOD_S)


@part
def advance_controlled(machine: Machine, road: Road, law: DrivingLaw, row: FloatArray) -> None:
    """Let the controllers act on what they sense, record a row, and advance the plant by a millisecond."""
    plant = law.drive.plant
    if plant.converter.is_there == 0:
        control(machine.memory, machine.sense, machine.commands, law)
    else:
        automatic.control(machine.memory, machine.sense, machine.commands, law)
    control_engine(machine.memory, machine.sense, machine.commands, law)
    apply_drive_commands(machine, law)
    hold_car(machine, plant, law.driving.surroundings.hold_m_s)
    record_plant(machine, plant, row)
    record_drive(machine, road, row)
    advance_millisecond(machine, law.drive.steps_per_millisecond, plant)


@kernel
def run(machine: Machine, road: Road, law: DrivingLaw, rows: FloatArray) -> int:
    """Fill ``rows``, one per millisecond, until they are full or the trace ends; return how many were filled."""
    for index in range(rows.shape[0]):
        if machine.clock[0] >= road.end[0]:
            return index
        sense_drive(machine, road, law)
        have_whim(machine.memory, road.whims)
        drive(machine.memory, machine.sense, road.speeds, machine.clock[0] * tcu_data.PERIOD_S, law)
        advance_controlled(machine, road, law, rows[index])
    return int(rows.shape[0])


@kernel
def follow(
    machine: Machine, road: Road, law: DrivingLaw, rows: FloatArray, speeds_m_s: FloatArray, feet: tuple[float, float]
) -> None:
    """Fill ``rows``, one per millisecond, while somebody else moves the car and its driver's feet.

    Parameters
    ----------
    speeds_m_s : (n,) array
        Of the car at each row, as rollers would turn its wheels: what pulls or brakes it besides is none of the car's.
    feet : tuple of two
        Pedal [ratio] and brake [m/s^2].
    """
    memory, pedal = machine.memory, feet[0]
    for index in range(rows.shape[0]):
        machine.y[at.V] = speeds_m_s[index]
        sense_drive(machine, road, law)
        step = pedal - memory[indices.PEDAL]
        memory[indices.PEDAL_RATE] += (step - tcu_data.PERIOD_S * memory[indices.PEDAL_RATE]) / _RATE_LAG_S
        memory[indices.PEDAL], memory[indices.BRAKE] = pedal, feet[1]
        advance_controlled(machine, road, law, rows[index])
        rows[index, Col.WANTED_SPEED] = speeds_m_s[index]


GRID_S = 0.1  # of the trace as the driver sees it
_ROLLING_M_S = 0.15  # a trace below this stands still
_STANDING_M_S = 0.3
_RATE_LAG_S = 0.05
_STOPPING_M_S2 = 0.8  # the last metre before a stop
_TURNING_RATIO = 1.05  # mass of the car with all that turns, over its mass


@part
def trace_value(column: FloatArray, time_s: float) -> float:
    """Return what a column of the trace says at a time; its last value beyond its end."""
    place = time_s / GRID_S
    index = int(place)
    if index >= column.size - 1:
        return float(column[column.size - 1])
    return float(column[index] + (place - index) * (column[index + 1] - column[index]))


@part
def wanted_force_n(memory: FloatArray, sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> float:
    """Return the force that would bring the car onto the trace [N]: what lies ahead, corrected by the error."""
    p, vehicle = law.driving.driver, law.drive.plant.vehicle
    ahead_m_s2 = (trace_value(speeds, time_s + p.far_s) - trace_value(speeds, time_s + p.near_s)) / (p.far_s - p.near_s)
    speed_m_s = sense[indices.VEHICLE_SPEED]
    error_m_s = trace_value(speeds, time_s + p.aim_s) - speed_m_s - p.aim_s * ahead_m_s2 * 0.5
    summed_m = memory[indices.SPEED_INTEGRAL] + error_m_s * tcu_data.PERIOD_S
    memory[indices.SPEED_INTEGRAL] = min(max(summed_m, -p.integral_limit_m), p.integral_limit_m)
    wanted_m_s2 = ahead_m_s2 + p.speed_gain_per_s * error_m_s + p.integral_gain_per_s2 * memory[indices.SPEED_INTEGRAL]
    return float(_TURNING_RATIO * vehicle.mass_kg * wanted_m_s2 + road_load_n(speed_m_s, sense[indices.GRADE], vehicle))


@part
def move_feet(memory: FloatArray, pedal: float, brake_m_s2: float, law: DrivingLaw) -> None:
    """Move pedal and brake towards what is wanted; the same foot serves both."""
    p, period_s = law.driving.driver, tcu_data.PERIOD_S
    if brake_m_s2 > 0.0 and memory[indices.PEDAL] > 0.0:
        brake_m_s2 = 0.0
    if pedal > 0.0 and memory[indices.BRAKE] > 0.0:
        pedal = 0.0
    step = min(max(pedal - memory[indices.PEDAL], -p.pedal_release_per_s * period_s), p.pedal_press_per_s * period_s)
    memory[indices.PEDAL] += step
    memory[indices.PEDAL_RATE] += period_s / _RATE_LAG_S * (step / period_s - memory[indices.PEDAL_RATE])
    step = brake_m_s2 - memory[indices.BRAKE]
    memory[indices.BRAKE] += min(max(step, -p.brake_release_m_s3 * period_s), p.brake_press_m_s3 * period_s)


@part
def is_waiting(sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> bool:
    """Tell whether car and trace stand still, and the trace goes on doing so for a moment."""
    ahead_m_s = max(trace_value(speeds, time_s), trace_value(speeds, time_s + law.driving.driver.departure_s))
    return bool(ahead_m_s < _ROLLING_M_S and abs(sense[indices.VEHICLE_SPEED]) < _STANDING_M_S)


@part
def drive(memory: FloatArray, sense: FloatArray, speeds: FloatArray, time_s: float, law: DrivingLaw) -> None:
    """Take one step of 1 ms: pedal and brake."""
    p, vehicle = law.driving.driver, law.drive.plant.vehicle
    if is_waiting(sense, speeds, time_s, law):
        memory[indices.SPEED_INTEGRAL] = 0.0
        move_feet(memory, 0.0, p.standing_brake_m_s2, law)
        return
    force_n = wanted_force_n(memory, sense, speeds, time_s, law)
    ratio = law.drive.overall_ratios[int(memory[tcu_data.CURRENT_GEAR])]
    overrun_n = overrun_nm(sense[tcu_data.ENGINE_SPEED], law) * ratio / vehicle.wheel_radius_m
    if not pulls_on_wheels(memory):
        overrun_n = 0.0
    margin_n = p.foot_change_n if memory[indices.BRAKE] == 0.0 else 0.0
    is_stopping = (
        trace_value(speeds, time_s + p.aim_s) < _ROLLING_M_S
        and trace_value(speeds, time_s + p.departure_s) < _ROLLING_M_S
    )
    if force_n < overrun_n - margin_n or is_stopping:
        brake_m_s2 = (overrun_n - force_n) / vehicle.mass_kg
        move_feet(memory, 0.0, max(brake_m_s2, _STOPPING_M_S2 if is_stopping else 0.0), law)
        return
    pedal = pedal_for_force(force_n, sense[indices.VEHICLE_SPEED], overrun_n, law.driving.pedal)
    if memory[indices.WHIM_TIME] > 0.0:
        pedal = min(max(pedal + memory[indices.WHIM_PEDAL], 0.0), 1.0)
    if memory[indices.STATE] == DrivelineState.STANDSTILL.value and memory[indices.BRAKE] > 0.0:
        pedal = 0.0
    move_feet(memory, pedal, 0.0, law)
