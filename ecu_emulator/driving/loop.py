"""The compiled loop of a drive: each millisecond driver and controllers act, a row is recorded, the plant advances."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from ecu_emulator.driving import indices
from ecu_emulator.driving.control import control, have_whim
from ecu_emulator.driving.driver import drive, seen
from ecu_emulator.driving.engine_control import control_engine
from ecu_emulator.driving.indices import EngineState
from ecu_emulator.driving.laws import DrivingLaw
from ecu_emulator.plant import state as at
from ecu_emulator.plant.driveline import ENGAGED
from ecu_emulator.plant.integration import advance_millisecond, settle
from ecu_emulator.plant.loop import Machine, hold_car, obey, record_bodies, record_clutches, sense_plant
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control import tcu, tcu_data


class Road(NamedTuple):
    """What a drive meets: read only."""

    speeds: FloatArray  # (n,), every `driver.GRID_S` [m/s]
    grades: FloatArray  # (n,)
    whims: FloatArray  # (m, indices.WHIM_COLUMN_COUNT), one row per event
    end: npt.NDArray[np.int64]  # (1,), milliseconds of the whole drive


@array_kernel
def sense_drive(machine: Machine, road: Road, law: DrivingLaw) -> None:
    """Fill what the controllers sense."""
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
    sense[indices.GRADE] = seen(road.grades, machine.clock[0] * tcu_data.PERIOD_S)


@array_kernel
def warm(machine: Machine, law: DrivingLaw) -> None:
    """Let the running engine warm its coolant, and the coolant cool down to the air while it is stopped."""
    p = law.driving.surroundings
    is_running = machine.memory[indices.ENGINE_STATE] <= EngineState.FUEL_CUT.value
    goal_k = p.thermostat_k if is_running else law.drive.plant.air_k
    machine.u[at.COOLANT] += tcu_data.PERIOD_S / p.coolant_time_s * (goal_k - machine.u[at.COOLANT])


@array_kernel
def obey_drive(machine: Machine, law: DrivingLaw) -> None:
    """Turn the commands into inputs of the plant."""
    u, coolant_k = machine.u, machine.u[at.COOLANT]
    obey(machine, law.drive)
    u[at.COOLANT] = coolant_k
    u[at.PEDAL] = machine.memory[indices.PEDAL]
    u[at.GRADE] = machine.sense[indices.GRADE]
    u[at.STARTER] = machine.commands[indices.STARTER]
    p = law.driving.surroundings
    for k in range(2):
        share = u[at.VISCOSITY + k] / p.open_drag_viscosity_pa_s
        u[at.OPEN_DRAG + k] = p.open_drag_nm * math.exp(p.open_drag_exponent * math.log(share))


@array_kernel
def record_drive(machine: Machine, road: Road, row: FloatArray) -> None:
    """Write what driver and controllers show of themselves."""
    memory, modes, u = machine.memory, machine.modes, machine.u
    idle = 1 - tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    row[Col.CURRENT_GEAR] = memory[tcu_data.CURRENT_GEAR]
    row[Col.TARGET_GEAR] = memory[tcu_data.TARGET_GEAR]
    row[Col.PRESELECTED_GEAR] = modes[at.GEAR + idle] if modes[at.LINK + idle] == ENGAGED else 0
    row[Col.SHIFT_PHASE] = memory[tcu_data.PHASE]
    row[Col.ROUTINE] = row[Col.REV] = 0.0
    for k in range(2):
        row[Col.SHAFT1_GEAR + k] = modes[at.GEAR + k] if modes[at.LINK + k] == ENGAGED else 0
    row[Col.DRIVE_STATE] = memory[indices.STATE]
    row[Col.EVENT_KIND] = memory[indices.EVENT_KIND]
    row[Col.EVENT_NUMBER] = memory[indices.EVENT_NUMBER]
    row[Col.IS_ABORTED] = memory[indices.IS_ABORTED]
    row[Col.ENGINE_STATE] = memory[indices.ENGINE_STATE]
    row[Col.COOLANT_TEMPERATURE] = u[at.COOLANT]
    row[Col.GRADE] = u[at.GRADE]
    row[Col.WANTED_SPEED] = seen(road.speeds, machine.clock[0] * tcu_data.PERIOD_S)


@array_kernel
def run(machine: Machine, road: Road, law: DrivingLaw, rows: FloatArray) -> int:
    """Fill ``rows``, one per millisecond, until they are full or the trace ends; return how many were filled."""
    plant = law.drive.plant
    for index in range(rows.shape[0]):
        if machine.clock[0] >= road.end[0]:
            return index
        sense_drive(machine, road, law)
        have_whim(machine.memory, road.whims)
        drive(machine.memory, machine.sense, road.speeds, machine.clock[0] * tcu_data.PERIOD_S, law)
        control(machine.memory, machine.sense, machine.commands, law)
        control_engine(machine.memory, machine.sense, machine.commands, law)
        warm(machine, law)
        obey_drive(machine, law)
        hold_car(machine, plant, law.driving.surroundings.hold_m_s)
        settle(machine.y, machine.u, machine.modes, machine.work.slope1, plant)
        record_bodies(machine, plant, rows[index])
        record_clutches(machine, plant, rows[index])
        record_drive(machine, road, rows[index])
        advance_millisecond(
            machine.y,
            machine.u,
            machine.modes,
            machine.work,
            law.drive.steps_per_millisecond,
            plant,
        )
        machine.clock[0] += 1
    return int(rows.shape[0])
