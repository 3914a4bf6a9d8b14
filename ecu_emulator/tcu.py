"""Shift control and driver at 1 kHz: the sequential cycle 1-2-3-4-5-6-5-4-3-2-1, docs/model.md section "Shift control".

The control sees speeds, engine torque and how full each piston cavity is; it commands pressures, spark, pedal and
brake and moves the synchronisers. Clutch 1 carries the odd gears, clutch 2 the even ones.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clutch_model.jit import array_kernel, kernel

FloatArray = npt.NDArray[np.float64]

GEAR_COUNT = 6
PERIOD_S = 1.0e-3

# Shift phases, as on the bus.
HOLD = 0
PREFILL = 1
TORQUE = 2
INERTIA = 3
LOCK_UP = 4

# Places in the array of what the control senses: SLIP, FILL, GEAR and IS_ENGAGED hold a pair, clutch 1 first.
ENGINE_SPEED = 0
ENGINE_TORQUE = 1
SLIP = 2
FILL = 4
IS_LOCKED = 6
SHAFT_GEAR = 8  # gear on, or being synchronised to, the shaft; 0 none
IS_ENGAGED = 10
SENSE_COUNT = 12

# Places in the array of what the control commands.
PRESSURE = 0
TORQUE_COMMAND = 2
WANTED_GEAR = 4  # gear each shaft shall have, 0 neutral
THROTTLE = 6
SPARK = 7
BRAKE = 8
COMMAND_COUNT = 9

# Places in the memory of the control.
CURRENT_GEAR = 0
TARGET_GEAR = 1
PHASE = 2
PHASE_TIME = 3
DWELL = 4  # time since the current gear was reached
INPUT_TORQUE = 5  # filtered engine torque
START_SLIP = 6
INTEGRAL = 7
LOCKED_TIME = 8
NEUTRAL_TIME = 9
IS_DRIVING = 10
COAST_TIME = 11
CYCLE = 12
IS_FILLED = 13
RAMP_START = 14
IS_FINISHED = 15
MEMORY_COUNT = 16

# Columns of the table of cycles.
CYCLE_PEDAL = 0
CYCLE_BRAKE = 1
CYCLE_UP = 2  # five speeds, leaving gears 1..5
CYCLE_DOWN = 7  # five speeds, leaving gears 2..6
CYCLE_MU = 12  # factors on mu_c1, mu_s1, mu_c2, mu_s2
CYCLE_COLUMN_COUNT = 16


class ControlParameters(NamedTuple):
    """Numbers of the shift control and the driver."""

    friction_coefficient: float
    torque_filter_s: float
    upshift_speeds_rad_s: tuple[float, ...]  # w_up, leaving gears 1..5
    downshift_speeds_rad_s: tuple[float, ...]  # w_dn, leaving gears 2..6
    dwell_s: float
    hold_gain_ratio: float
    hold_margin_nm: float
    preselect_delay_s: float
    preselect_fill_ratio: float
    neutral_time_s: float
    prefill_time_s: float
    prefill_pressure_pa: float
    prefill_ratio: float
    touch_margin_pa: float
    release_gain_ratio: float
    release_margin_nm: float
    torque_phase_s: float
    overlap_margin_nm: float
    overlap_gain_ratio: float
    dump_ratio: float
    flare_gain_nms_rad: float
    flare_free_rad_s: float
    flare_limit_rad_s: float
    upshift_inertia_phase_s: float
    downshift_inertia_phase_s: float
    overshoot_rate_rad_s2: float
    overshoot_limit_rad_s: float
    slip_gain_nms_rad: float
    slip_integral_gain_nm_rad: float
    slip_integral_limit_rad: float
    min_torque_nm: float
    spark_reduction_ratio: float
    spark_stretch_ratio: float
    locked_slip_rad_s: float
    locked_time_s: float
    lockup_time_s: float
    top_gear_time_s: float
    brake_delay_s: float
    first_gear_time_s: float


class ClutchActuation(NamedTuple):
    """What the control believes about each clutch: pressure for no torque, pressure per torque."""

    touch_pressure_pa: tuple[float, float]
    pressure_per_torque_pa_nm: tuple[float, float]
    inertia_kg_m2: float  # J_E + J_H


@kernel
def clutch_of(gear: int) -> int:
    """Return the index of the clutch that carries a gear: 0 for odd gears, 1 for even ones."""
    return (gear - 1) % 2


@array_kernel
def command_torque(commands: FloatArray, clutch: int, torque_nm: float, actuation: ClutchActuation) -> None:
    """Command the pressure at which a clutch should carry ``torque_nm``, P(T)."""
    pressure_pa = actuation.touch_pressure_pa[clutch] + torque_nm * actuation.pressure_per_torque_pa_nm[clutch]
    commands[PRESSURE + clutch] = pressure_pa
    commands[TORQUE_COMMAND + clutch] = torque_nm


@array_kernel
def command_pressure(commands: FloatArray, clutch: int, pressure_pa: float) -> None:
    """Command a pressure at which a clutch carries nothing."""
    commands[PRESSURE + clutch] = pressure_pa
    commands[TORQUE_COMMAND + clutch] = 0.0


@array_kernel
def enter_phase(memory: FloatArray, phase: int) -> None:
    """Start a phase."""
    memory[PHASE] = phase
    memory[PHASE_TIME] = 0.0


@array_kernel
def hold_torque_nm(memory: FloatArray, p: ControlParameters) -> float:
    """Return the capacity of a clutch that shall not slip [N m]."""
    return float(p.hold_gain_ratio * abs(memory[INPUT_TORQUE]) + p.hold_margin_nm)


@array_kernel
def drive(memory: FloatArray, commands: FloatArray, cycles: FloatArray, p: ControlParameters) -> None:
    """Move pedal and brake through the cycle; note when the last cycle is over."""
    is_steady = memory[PHASE] == HOLD
    if memory[IS_DRIVING] != 0.0:
        if is_steady and memory[CURRENT_GEAR] == GEAR_COUNT and memory[DWELL] >= p.top_gear_time_s:
            memory[IS_DRIVING] = 0.0
            memory[COAST_TIME] = 0.0
    else:
        memory[COAST_TIME] += PERIOD_S
        if is_steady and memory[CURRENT_GEAR] == 1 and memory[DWELL] >= p.first_gear_time_s:
            memory[CYCLE] += 1.0
            memory[IS_DRIVING] = 1.0
            if memory[CYCLE] >= cycles.shape[0]:
                memory[IS_FINISHED] = 1.0
                return
    cycle = int(memory[CYCLE])
    is_driving = memory[IS_DRIVING] != 0.0
    commands[THROTTLE] = cycles[cycle, CYCLE_PEDAL] if is_driving else 0.0
    is_braking = not is_driving and memory[COAST_TIME] >= p.brake_delay_s
    commands[BRAKE] = cycles[cycle, CYCLE_BRAKE] if is_braking else 0.0


@array_kernel
def next_gear(memory: FloatArray) -> int:
    """Return the gear the sequence wants after the current one, 0 if none."""
    gear = int(memory[CURRENT_GEAR])
    if memory[IS_DRIVING] != 0.0:
        return gear + 1 if gear < GEAR_COUNT else 0
    return gear - 1


@array_kernel
def preselect(memory: FloatArray, sense: FloatArray, commands: FloatArray, p: ControlParameters) -> None:
    """Move the idle shaft to the next gear once its clutch is empty enough."""
    idle = 1 - clutch_of(int(memory[CURRENT_GEAR]))
    wanted = next_gear(memory)
    has_gear = int(sense[SHAFT_GEAR + idle])
    if wanted in (0, has_gear) or (has_gear != 0 and sense[IS_ENGAGED + idle] == 0.0):
        return
    if has_gear != 0:
        if memory[DWELL] >= p.preselect_delay_s and sense[FILL + idle] < p.preselect_fill_ratio:
            commands[WANTED_GEAR + idle] = 0.0
            memory[NEUTRAL_TIME] = 0.0
        return
    memory[NEUTRAL_TIME] += PERIOD_S
    if memory[NEUTRAL_TIME] >= p.neutral_time_s:
        commands[WANTED_GEAR + idle] = wanted


@array_kernel
def wants_shift(memory: FloatArray, sense: FloatArray, cycles: FloatArray, p: ControlParameters) -> bool:
    """Tell whether the engine has reached the speed of the next shift and the next gear stands ready."""
    gear, wanted = int(memory[CURRENT_GEAR]), next_gear(memory)
    if wanted == 0 or memory[DWELL] <= p.dwell_s:
        return False
    shaft = clutch_of(wanted)
    if int(sense[SHAFT_GEAR + shaft]) != wanted or sense[IS_ENGAGED + shaft] == 0.0:
        return False
    row = cycles[int(memory[CYCLE])]
    if wanted > gear:
        pedal_ratio = min(max(0.55 + row[CYCLE_PEDAL], 0.6), 1.3)
        return bool(sense[ENGINE_SPEED] > row[CYCLE_UP + gear - 1] * pedal_ratio)
    return bool(sense[ENGINE_SPEED] < row[CYCLE_DOWN + gear - 2])


@array_kernel
def hold_phase(memory: FloatArray, commands: FloatArray, actuation: ClutchActuation, p: ControlParameters) -> None:
    """Phase 0: the clutch of the current gear holds, the other one is empty."""
    active = clutch_of(int(memory[CURRENT_GEAR]))
    command_torque(commands, active, hold_torque_nm(memory, p), actuation)
    command_pressure(commands, 1 - active, 0.0)


@array_kernel
def prefill_phase(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, actuation: ClutchActuation, p: ControlParameters
) -> None:
    """Phase 1: the on-coming cavity is filled fast and then held at its touch point."""
    coming = clutch_of(int(memory[TARGET_GEAR]))
    if sense[FILL + coming] >= p.prefill_ratio:
        memory[IS_FILLED] = 1.0
    touch_pa = actuation.touch_pressure_pa[coming] + p.touch_margin_pa
    command_pressure(commands, coming, touch_pa if memory[IS_FILLED] != 0.0 else p.prefill_pressure_pa)
    release_nm = p.release_gain_ratio * abs(memory[INPUT_TORQUE]) + p.release_margin_nm
    command_torque(commands, 1 - coming, release_nm, actuation)
    if memory[PHASE_TIME] >= p.prefill_time_s:
        enter_phase(memory, TORQUE)


@array_kernel
def torque_phase(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, actuation: ClutchActuation, p: ControlParameters
) -> None:
    """Phase 2: torque moves from the off-going to the on-coming clutch."""
    coming = clutch_of(int(memory[TARGET_GEAR]))
    share = min(memory[PHASE_TIME] / p.torque_phase_s, 1.0)
    load_nm = abs(memory[INPUT_TORQUE]) + p.overlap_margin_nm
    command_torque(commands, coming, share * load_nm, actuation)
    direction = 1.0 if memory[TARGET_GEAR] > memory[CURRENT_GEAR] else -1.0
    flare_rad_s = direction * sense[SLIP + 1 - coming] - p.flare_free_rad_s
    catch_nm = p.flare_gain_nms_rad * min(max(flare_rad_s, 0.0), p.flare_limit_rad_s)
    if share >= p.dump_ratio:
        command_pressure(commands, 1 - coming, 0.0)
    else:
        command_torque(commands, 1 - coming, p.overlap_gain_ratio * (1.0 - share) * load_nm + catch_nm, actuation)
    if memory[PHASE_TIME] >= p.torque_phase_s:
        memory[START_SLIP] = sense[SLIP + coming]
        memory[INTEGRAL] = 0.0
        memory[LOCKED_TIME] = 0.0
        enter_phase(memory, INERTIA)


@kernel
def slip_reference(time_s: float, start_rad_s: float, length_s: float, p: ControlParameters) -> tuple[float, float]:
    """Return the slip the inertia phase follows [rad/s] and its rate [rad/s^2]: to zero smoothly, then beyond."""
    if time_s < length_s:
        q = time_s / length_s
        return start_rad_s * (1.0 - q * q * (3.0 - 2.0 * q)), -start_rad_s * 6.0 * q * (1.0 - q) / length_s
    sign = 1.0 if start_rad_s > 0.0 else -1.0
    overshoot_rad_s = p.overshoot_rate_rad_s2 * (time_s - length_s)
    if overshoot_rad_s < p.overshoot_limit_rad_s:
        return -sign * overshoot_rad_s, -sign * p.overshoot_rate_rad_s2
    return -sign * p.overshoot_limit_rad_s, 0.0


@array_kernel
def inertia_phase(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, actuation: ClutchActuation, p: ControlParameters
) -> None:
    """Phase 3: the on-coming clutch leads the engine to the speed of the new gear."""
    is_up = memory[TARGET_GEAR] > memory[CURRENT_GEAR]
    coming = clutch_of(int(memory[TARGET_GEAR]))
    length_s = p.upshift_inertia_phase_s if is_up else p.downshift_inertia_phase_s
    time_s, start_rad_s = memory[PHASE_TIME], memory[START_SLIP]
    wanted_rad_s, wanted_rate = slip_reference(time_s, start_rad_s, length_s, p)
    slip_rad_s = sense[SLIP + coming]
    error_rad_s = slip_rad_s - wanted_rad_s
    limit = p.slip_integral_limit_rad
    memory[INTEGRAL] = min(max(memory[INTEGRAL] + error_rad_s * PERIOD_S, -limit), limit)
    torque_nm = memory[INPUT_TORQUE] - actuation.inertia_kg_m2 * wanted_rate
    torque_nm += p.slip_gain_nms_rad * error_rad_s + p.slip_integral_gain_nm_rad * memory[INTEGRAL]
    sign = 1.0 if start_rad_s > 0.0 else -1.0
    command_torque(commands, coming, max(sign * torque_nm, p.min_torque_nm), actuation)
    command_pressure(commands, 1 - coming, 0.0)
    if is_up:
        q = min(p.spark_stretch_ratio * min(time_s / length_s, 1.0), 1.0)
        commands[SPARK] = 1.0 - p.spark_reduction_ratio * math.sin(math.pi * q)
    is_done = abs(slip_rad_s) < p.locked_slip_rad_s or sense[IS_LOCKED + coming] != 0.0
    memory[LOCKED_TIME] = memory[LOCKED_TIME] + PERIOD_S if is_done else 0.0
    if memory[LOCKED_TIME] > p.locked_time_s:
        memory[RAMP_START] = commands[TORQUE_COMMAND + coming]
        commands[SPARK] = 1.0
        enter_phase(memory, LOCK_UP)


@array_kernel
def lock_up_phase(memory: FloatArray, commands: FloatArray, actuation: ClutchActuation, p: ControlParameters) -> None:
    """Phase 4: pressure rises to the hold level, then the gear counts as changed."""
    coming = clutch_of(int(memory[TARGET_GEAR]))
    share = min(memory[PHASE_TIME] / p.lockup_time_s, 1.0)
    torque_nm = memory[RAMP_START] + share * (hold_torque_nm(memory, p) - memory[RAMP_START])
    command_torque(commands, coming, torque_nm, actuation)
    command_pressure(commands, 1 - coming, 0.0)
    if share >= 1.0:
        memory[CURRENT_GEAR] = memory[TARGET_GEAR]
        memory[DWELL] = 0.0
        enter_phase(memory, HOLD)


@array_kernel
def control(
    memory: FloatArray,
    sense: FloatArray,
    commands: FloatArray,
    cycles: FloatArray,
    actuation: ClutchActuation,
    p: ControlParameters,
) -> None:
    """Take one step of 1 ms: read ``sense``, update ``memory``, write ``commands``."""
    blend = 1.0 - math.exp(-PERIOD_S / p.torque_filter_s)
    memory[INPUT_TORQUE] += blend * (sense[ENGINE_TORQUE] - memory[INPUT_TORQUE])
    memory[PHASE_TIME] += PERIOD_S
    memory[DWELL] += PERIOD_S
    drive(memory, commands, cycles, p)
    if memory[IS_FINISHED] != 0.0:
        return
    phase = int(memory[PHASE])
    if phase == HOLD:
        preselect(memory, sense, commands, p)
        hold_phase(memory, commands, actuation, p)
        if wants_shift(memory, sense, cycles, p):
            memory[TARGET_GEAR] = next_gear(memory)
            memory[IS_FILLED] = 0.0
            enter_phase(memory, PREFILL)
    elif phase == PREFILL:
        prefill_phase(memory, sense, commands, actuation, p)
    elif phase == TORQUE:
        torque_phase(memory, sense, commands, actuation, p)
    elif phase == INERTIA:
        inertia_phase(memory, sense, commands, actuation, p)
    else:
        lock_up_phase(memory, commands, actuation, p)
