"""The compiled loop: each millisecond the control acts, a row is recorded, the plant advances."""

from typing import NamedTuple

from canlog.arrays import FloatArray
from canlog.jit import kernel, part
from clutch_model.pack import viscosity_pa_s
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import BRAKES, stored_energy_j
from ecu_emulator.plant.clutch import cavity_pressure_pa, friction_ratio
from ecu_emulator.plant.driveline import (
    ENGAGED,
    GRAVITY_M_S2,
    NEUTRAL,
    SYNCHRONISING,
    engine_losses_nm,
    mean_indicated_torque_nm,
)
from ecu_emulator.plant.integration import Machine, advance_millisecond, resolve_clutch_modes
from ecu_emulator.plant.rates import PlantLaw
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control import tcu, tcu_data, workshop
from ecu_emulator.shift_control.tcu_data import ClutchActuation, ControlParameters, WorkshopParameters

COLUMN_COUNT = len(Col)
WORKSHOP_HOLD_M_S = 0.03  # below which the brakes hold the car, as on the road
_HOLDING_M_S2 = 0.05  # brakes that are pressed less hold nothing
_HELD_MARGIN = 1.05


class DriveLaw(NamedTuple):
    """Everything constant over a drive."""

    plant: PlantLaw
    actuation: ClutchActuation
    control: ControlParameters
    workshop: WorkshopParameters
    overall_ratios: tuple[float, ...]  # i(g) of gears 0, 1, ...; 0 in neutral and where there is no gear
    steps_per_millisecond: int


@part
def modelled_torque_nm(machine: Machine, law: PlantLaw) -> float:
    """Return the crankshaft torque as an engine controller models it [N m]: without the pulses of the firings."""
    y, engine = machine.y, law.engine
    indicated_nm = mean_indicated_torque_nm(y[at.P_M], y[at.SPARK], law.air_k, engine)
    return float(indicated_nm - engine_losses_nm(y[at.P_M], y[at.W_E], engine))


@part
def sense_plant(machine: Machine, law: PlantLaw) -> None:
    y, modes, sense = machine.y, machine.modes, machine.sense
    sense[tcu_data.ENGINE_SPEED] = y[at.W_E]
    sense[tcu_data.ENGINE_TORQUE] = modelled_torque_nm(machine, law)
    for k in range(2):
        clutch = law.clutches[k]
        sense[tcu_data.SLIP + k] = y[at.W_H] - y[at.W_L + k]
        sense[tcu_data.FILL + k] = y[at.VOLUME + k] / clutch.cavity.full_volume_m3
        sense[tcu_data.IS_LOCKED + k] = modes[at.STICK + k]
        sense[tcu_data.SHAFT_GEAR + k] = modes[at.GEAR + k]
        sense[tcu_data.IS_ENGAGED + k] = modes[at.LINK + k] == ENGAGED


@part
def apply_commands(machine: Machine, law: DriveLaw) -> None:
    """Turn the commands into inputs of the plant and moves of the synchronisers."""
    y, u, modes, commands = machine.y, machine.u, machine.modes, machine.commands
    row = machine.cycles[int(machine.memory[tcu_data.CYCLE])]
    u[at.PEDAL] = commands[tcu_data.THROTTLE]
    u[at.THROTTLE_COMMAND] = commands[tcu_data.THROTTLE]
    u[at.SPARK_COMMAND] = commands[tcu_data.SPARK]
    u[at.BRAKE] = commands[tcu_data.BRAKE]
    u[at.COOLANT] = law.plant.coolant_k
    for k in range(2):
        clutch = law.plant.clutches[k]
        line_pa = clutch.valve.line_pressure_pa
        u[at.P_COMMAND + k] = min(max(commands[tcu_data.PRESSURE + k], 0.0), line_pa)
        u[at.T_COMMAND + k] = commands[tcu_data.TORQUE_COMMAND + k]
        faded = friction_ratio(y[at.T_C + k], clutch.lining, y[at.DISTANCE])
        u[at.MU_C + k] = clutch.friction.mu_c * row[tcu_data.CYCLE_MU + 2 * k] * faded
        u[at.MU_S + k] = clutch.friction.mu_s * row[tcu_data.CYCLE_MU + 2 * k + 1] * faded
        fluid = law.plant.fluid
        u[at.VISCOSITY + k] = viscosity_pa_s(y[at.T_C + k], fluid.a_pa_s, fluid.b_k, fluid.pole_k)
        wanted = int(commands[tcu_data.WANTED_GEAR + k])
        if wanted != modes[at.GEAR + k]:
            modes[at.GEAR + k] = wanted
            modes[at.LINK + k] = SYNCHRONISING if wanted != 0 else NEUTRAL
            u[at.RATIO + k] = law.overall_ratios[wanted]


@part
def record_plant(machine: Machine, law: PlantLaw, row: FloatArray) -> None:
    """Bring the clutch modes into agreement with the torques, and write what the plant shows of itself."""
    y, u, out = machine.y, machine.u, machine.work.slope1
    resolve_clutch_modes(y, u, machine.modes, out, law)
    row[Col.T_S] = machine.clock[0] * 1.0e-3
    row[Col.ENGINE_SPEED] = y[at.W_E]
    row[Col.HUB_SPEED] = y[at.W_H]
    row[Col.DIFF_SPEED] = y[at.W_D]
    row[Col.WHEEL_SPEED] = y[at.W_W]
    row[Col.VEHICLE_SPEED] = y[at.V]
    row[Col.CRANK_ANGLE] = y[at.CRANK]
    row[Col.ENGINE_TORQUE] = modelled_torque_nm(machine, law)
    row[Col.FLYWHEEL_TORQUE] = out[at.T_FW]
    row[Col.SUMP_TEMPERATURE] = y[at.T_OIL]
    row[Col.PEDAL] = u[at.PEDAL]
    row[Col.THROTTLE] = y[at.THROTTLE]
    row[Col.BRAKE] = u[at.BRAKE]
    row[Col.DISTANCE] = y[at.DISTANCE]
    row[Col.MANIFOLD_PRESSURE] = y[at.P_M]
    for k in range(2):  # clutch 2 stands right of clutch 1
        clutch = law.clutches[k]
        row[Col.INPUT1_SPEED + k] = y[at.W_L + k]
        row[Col.CLUTCH1_TORQUE + k] = out[at.T_F + k]
        row[Col.VISCOUS1_TORQUE + k] = out[at.T_V + k]
        row[Col.SHAFT1_TORQUE + k] = out[at.T_SI + k]
        row[Col.PRESSURE1 + k] = cavity_pressure_pa(y[at.VOLUME + k], clutch.cavity, clutch.valve)
        row[Col.PRESSURE1_COMMAND + k] = u[at.P_COMMAND + k]
        row[Col.TORQUE1_COMMAND + k] = u[at.T_COMMAND + k]
        row[Col.FILM1 + k] = y[at.FILM + k]
        row[Col.CLUTCH1_TEMPERATURE + k] = y[at.T_C + k]
        row[Col.STICK1 + k] = machine.modes[at.STICK + k]
        row[Col.MU_C1 + 2 * k] = u[at.MU_C + k]
        row[Col.MU_S1 + 2 * k] = u[at.MU_S + k]


@part
def record_control(machine: Machine, row: FloatArray) -> None:
    """Write what the shift control shows of itself, and the gears of the shafts."""
    memory, modes = machine.memory, machine.modes
    for k in range(2):
        row[Col.SHAFT1_GEAR + k] = modes[at.GEAR + k] if modes[at.LINK + k] == ENGAGED else 0
    idle = 1 - tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    row[Col.CURRENT_GEAR] = memory[tcu_data.CURRENT_GEAR]
    row[Col.TARGET_GEAR] = memory[tcu_data.TARGET_GEAR]
    row[Col.PRESELECTED_GEAR] = modes[at.GEAR + idle] if modes[at.LINK + idle] == ENGAGED else 0
    row[Col.SHIFT_PHASE] = memory[tcu_data.PHASE]
    row[Col.ROUTINE] = memory[tcu_data.ROUTINE]
    row[Col.REV] = memory[tcu_data.REV]


@part
def hold_car(machine: Machine, law: PlantLaw, hold_m_s: float) -> None:
    """Let the brakes hold the car and its wheels at rest, or let go when they can no longer."""
    y, modes, vehicle = machine.y, machine.modes, law.vehicle
    brake_m_s2 = machine.u[at.BRAKE]
    weight_n = vehicle.mass_kg * GRAVITY_M_S2 * machine.u[at.GRADE]
    pull_n = machine.work.slope1[at.T_OS] / vehicle.wheel_radius_m - weight_n
    can_hold = brake_m_s2 > _HOLDING_M_S2 and abs(pull_n) * _HELD_MARGIN < vehicle.mass_kg * brake_m_s2
    if modes[at.HELD] != 0:
        modes[at.HELD] = 1 if can_hold else 0
        return
    rim_m_s = vehicle.wheel_radius_m * y[at.W_W]
    if can_hold and max(abs(y[at.V]), abs(rim_m_s)) < hold_m_s:
        before_j = stored_energy_j(y, law)
        y[at.V] = y[at.W_W] = 0.0
        modes[at.HELD] = 1
        if machine.work.account.size != 0:
            machine.work.account[BRAKES] += before_j - stored_energy_j(y, law)


@kernel
def run(machine: Machine, law: DriveLaw, rows: FloatArray) -> int:
    """Fill ``rows``, one per millisecond, until they are full or the drive is over; return how many were filled."""
    memory, sense, commands = machine.memory, machine.sense, machine.commands
    for index in range(rows.shape[0]):
        sense_plant(machine, law.plant)
        if memory[tcu_data.ROUTINE] >= tcu_data.STEPS_ENGAGING:
            workshop.perform_steps(memory, sense, commands, law)
        elif memory[tcu_data.ROUTINE] != tcu_data.NO_ROUTINE:
            workshop.perform(memory, sense, commands, law)
        else:
            tcu.control(memory, sense, commands, machine.cycles, law)
        if memory[tcu_data.IS_FINISHED] != 0.0:
            return index
        apply_commands(machine, law)
        if memory[tcu_data.ROUTINE] >= tcu_data.STEPS_ENGAGING:
            hold_car(machine, law.plant, WORKSHOP_HOLD_M_S)
        else:
            machine.modes[at.HELD] = 0
        for column in range(Col.DRIVE_STATE, COLUMN_COUNT):  # the cycles have neither events nor a converter
            rows[index, column] = 0.0
        rows[index, Col.COOLANT_TEMPERATURE] = law.plant.coolant_k
        record_plant(machine, law.plant, rows[index])
        record_control(machine, rows[index])
        advance_millisecond(machine, law.steps_per_millisecond, law.plant)
    return int(rows.shape[0])
