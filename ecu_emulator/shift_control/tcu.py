"""Shift control and driver at 1 kHz: through all gears and back, docs/model.md section "Shift control".

The control sees speeds, engine torque and how full each piston cavity is; it commands pressures, spark, pedal and
brake and moves the synchronisers. Clutch 1 carries the odd gears, clutch 2 the even ones.
"""

import math

from canlog.arrays import FloatArray
from canlog.jit import part
from clutch_model.pack import gear_clutch
from ecu_emulator.shift_control import tcu_data as at
from ecu_emulator.shift_control.tcu_data import ControlLaw, ControlParameters


@part
def clutch_of(gear: int) -> int:
    """Return the index of the clutch that carries a gear: 0 for clutch 1."""
    return gear_clutch(gear) - 1


@part
def command_torque(commands: FloatArray, clutch: int, torque_nm: float, law: ControlLaw) -> None:
    """Command the pressure at which a clutch should carry ``torque_nm``, P(T)."""
    pressure_pa = law.actuation.touch_pressure_pa[clutch] + torque_nm * law.actuation.pressure_per_torque_pa_nm[clutch]
    commands[at.PRESSURE + clutch] = pressure_pa
    commands[at.TORQUE_COMMAND + clutch] = torque_nm


@part
def command_pressure(commands: FloatArray, clutch: int, pressure_pa: float) -> None:
    """Command a pressure at which a clutch carries nothing."""
    commands[at.PRESSURE + clutch] = pressure_pa
    commands[at.TORQUE_COMMAND + clutch] = 0.0


@part
def open_both(commands: FloatArray) -> None:
    """Command no pressure at either clutch."""
    command_pressure(commands, 0, 0.0)
    command_pressure(commands, 1, 0.0)


@part
def enter_phase(memory: FloatArray, phase: int) -> None:
    memory[at.PHASE] = phase
    memory[at.PHASE_TIME] = 0.0


@part
def hold_torque_nm(memory: FloatArray, law: ControlLaw) -> float:
    """Return the capacity of a clutch that shall not slip [N m]."""
    p = law.control
    return float(p.hold_gain_ratio * abs(memory[at.INPUT_TORQUE]) + p.hold_margin_nm)


@part
def next_gear(memory: FloatArray, cycles: FloatArray) -> int:
    """Return the gear the sequence wants after the current one, 0 if none."""
    gear = int(memory[at.CURRENT_GEAR])
    if memory[at.IS_DRIVING] != 0.0:
        return gear + 1 if cycles[int(memory[at.CYCLE]), at.CYCLE_UP + gear - 1] > 0.0 else 0
    return gear - 1


@part
def drive(memory: FloatArray, commands: FloatArray, cycles: FloatArray, law: ControlLaw) -> None:
    """Move pedal and brake through the cycle; note when the last cycle is over."""
    p = law.control
    is_steady = memory[at.PHASE] == at.HOLD
    if memory[at.IS_DRIVING] != 0.0:
        if is_steady and next_gear(memory, cycles) == 0 and memory[at.DWELL] >= p.top_gear_time_s:
            memory[at.IS_DRIVING] = 0.0
            memory[at.COAST_TIME] = 0.0
    else:
        memory[at.COAST_TIME] += at.PERIOD_S
        if is_steady and memory[at.CURRENT_GEAR] == 1 and memory[at.DWELL] >= p.first_gear_time_s:
            memory[at.CYCLE] += 1.0
            memory[at.IS_DRIVING] = 1.0
            if memory[at.CYCLE] >= cycles.shape[0]:
                memory[at.IS_FINISHED] = 1.0
                return
    cycle = int(memory[at.CYCLE])
    is_driving = memory[at.IS_DRIVING] != 0.0
    commands[at.THROTTLE] = cycles[cycle, at.CYCLE_PEDAL] if is_driving else 0.0
    is_braking = not is_driving and memory[at.COAST_TIME] >= p.brake_delay_s
    commands[at.BRAKE] = cycles[cycle, at.CYCLE_BRAKE] if is_braking else 0.0


@part
def preselect(memory: FloatArray, sense: FloatArray, commands: FloatArray, cycles: FloatArray, law: ControlLaw) -> None:
    """Move the idle shaft to the next gear once its clutch is empty enough."""
    p = law.control
    idle = 1 - clutch_of(int(memory[at.CURRENT_GEAR]))
    wanted = next_gear(memory, cycles)
    has_gear = int(sense[at.SHAFT_GEAR + idle])
    if wanted in (0, has_gear) or (has_gear != 0 and sense[at.IS_ENGAGED + idle] == 0.0):
        return
    if has_gear != 0:
        if memory[at.DWELL] >= p.preselect_delay_s and sense[at.FILL + idle] < p.preselect_fill_ratio:
            commands[at.WANTED_GEAR + idle] = 0.0
            memory[at.NEUTRAL_TIME] = 0.0
        return
    memory[at.NEUTRAL_TIME] += at.PERIOD_S
    if memory[at.NEUTRAL_TIME] >= p.neutral_time_s:
        commands[at.WANTED_GEAR + idle] = wanted


@part
def wants_shift(memory: FloatArray, sense: FloatArray, cycles: FloatArray, law: ControlLaw) -> bool:
    """Tell whether the engine has reached the speed of the next shift and the next gear stands ready."""
    p = law.control
    gear, wanted = int(memory[at.CURRENT_GEAR]), next_gear(memory, cycles)
    if wanted == 0 or memory[at.DWELL] <= p.dwell_s:
        return False
    shaft = clutch_of(wanted)
    if int(sense[at.SHAFT_GEAR + shaft]) != wanted or sense[at.IS_ENGAGED + shaft] == 0.0:
        return False
    row = cycles[int(memory[at.CYCLE])]
    if wanted > gear:
        pedal_ratio = min(max(0.55 + row[at.CYCLE_PEDAL], 0.6), 1.3)
        return bool(sense[at.ENGINE_SPEED] > row[at.CYCLE_UP + gear - 1] * pedal_ratio)
    return bool(sense[at.ENGINE_SPEED] < row[at.CYCLE_DOWN + gear - 2])


@part
def fill_clutch(memory: FloatArray, sense: FloatArray, commands: FloatArray, clutch: int, law: ControlLaw) -> None:
    """Fill a cavity fast and then hold it at its touch point."""
    p = law.control
    if sense[at.FILL + clutch] >= p.prefill_ratio:
        memory[at.IS_FILLED] = 1.0
    touch_pa = law.actuation.touch_pressure_pa[clutch] + p.touch_margin_pa
    command_pressure(commands, clutch, touch_pa if memory[at.IS_FILLED] != 0.0 else p.prefill_pressure_pa)


@part
def prefill_phase(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Phase 1: the on-coming cavity is filled."""
    p = law.control
    coming = clutch_of(int(memory[at.TARGET_GEAR]))
    fill_clutch(memory, sense, commands, coming, law)
    release_nm = p.release_gain_ratio * abs(memory[at.INPUT_TORQUE]) + p.release_margin_nm
    command_torque(commands, 1 - coming, release_nm, law)
    if memory[at.PHASE_TIME] >= p.prefill_time_s:
        enter_phase(memory, at.TORQUE)


@part
def torque_phase(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Phase 2: torque moves from the off-going to the on-coming clutch."""
    p = law.control
    coming = clutch_of(int(memory[at.TARGET_GEAR]))
    share = min(memory[at.PHASE_TIME] / p.torque_phase_s, 1.0)
    load_nm = abs(memory[at.INPUT_TORQUE]) + p.overlap_margin_nm
    command_torque(commands, coming, share * load_nm, law)
    direction = 1.0 if memory[at.TARGET_GEAR] > memory[at.CURRENT_GEAR] else -1.0
    flare_rad_s = direction * sense[at.SLIP + 1 - coming] - p.flare_free_rad_s
    catch_nm = p.flare_gain_nms_rad * min(max(flare_rad_s, 0.0), p.flare_limit_rad_s)
    if share >= p.dump_ratio:
        command_pressure(commands, 1 - coming, 0.0)
    else:
        command_torque(commands, 1 - coming, p.overlap_gain_ratio * (1.0 - share) * load_nm + catch_nm, law)
    if memory[at.PHASE_TIME] >= p.torque_phase_s:
        memory[at.START_SLIP] = sense[at.SLIP + coming]
        memory[at.INTEGRAL] = 0.0
        memory[at.LOCKED_TIME] = 0.0
        enter_phase(memory, at.INERTIA)


@part
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


@part
def inertia_phase(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Phase 3: the on-coming clutch leads the engine to the speed of the new gear."""
    p = law.control
    is_up = memory[at.TARGET_GEAR] > memory[at.CURRENT_GEAR]
    coming = clutch_of(int(memory[at.TARGET_GEAR]))
    length_s = p.upshift_inertia_phase_s if is_up else p.downshift_inertia_phase_s
    time_s, start_rad_s = memory[at.PHASE_TIME], memory[at.START_SLIP]
    wanted_rad_s, wanted_rate = slip_reference(time_s, start_rad_s, length_s, p)
    slip_rad_s = sense[at.SLIP + coming]
    error_rad_s = slip_rad_s - wanted_rad_s
    limit = p.slip_integral_limit_rad
    memory[at.INTEGRAL] = min(max(memory[at.INTEGRAL] + error_rad_s * at.PERIOD_S, -limit), limit)
    torque_nm = memory[at.INPUT_TORQUE] - law.actuation.inertia_kg_m2 * wanted_rate
    torque_nm += p.slip_gain_nms_rad * error_rad_s + p.slip_integral_gain_nm_rad * memory[at.INTEGRAL]
    sign = 1.0 if start_rad_s > 0.0 else -1.0
    command_torque(commands, coming, max(sign * torque_nm, p.min_torque_nm), law)
    command_pressure(commands, 1 - coming, 0.0)
    if is_up:
        q = min(p.spark_stretch_ratio * min(time_s / length_s, 1.0), 1.0)
        commands[at.SPARK] = 1.0 - p.spark_reduction_ratio * math.sin(math.pi * q)
    begin_lock_up(memory, sense, commands, coming, law)


@part
def begin_lock_up(memory: FloatArray, sense: FloatArray, commands: FloatArray, coming: int, law: ControlLaw) -> None:
    """Go on to the lock-up ramp once the on-coming clutch has stopped slipping for good."""
    p = law.control
    is_done = abs(sense[at.SLIP + coming]) < p.locked_slip_rad_s or sense[at.IS_LOCKED + coming] != 0.0
    memory[at.LOCKED_TIME] = memory[at.LOCKED_TIME] + at.PERIOD_S if is_done else 0.0
    if memory[at.LOCKED_TIME] > p.locked_time_s:
        memory[at.RAMP_START] = commands[at.TORQUE_COMMAND + coming]
        commands[at.SPARK] = 1.0
        enter_phase(memory, at.LOCK_UP)


@part
def lock_up_phase(memory: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Phase 4: pressure rises to the hold level, then the gear counts as changed."""
    p = law.control
    coming = clutch_of(int(memory[at.TARGET_GEAR]))
    share = min(memory[at.PHASE_TIME] / p.lockup_time_s, 1.0)
    torque_nm = memory[at.RAMP_START] + share * (hold_torque_nm(memory, law) - memory[at.RAMP_START])
    command_torque(commands, coming, torque_nm, law)
    command_pressure(commands, 1 - coming, 0.0)
    if share >= 1.0:
        memory[at.CURRENT_GEAR] = memory[at.TARGET_GEAR]
        memory[at.DWELL] = 0.0
        enter_phase(memory, at.HOLD)


@part
def tick(memory: FloatArray, sense: FloatArray, law: ControlLaw) -> None:
    """Advance the clocks and the filtered engine torque by 1 ms."""
    p = law.control
    blend = 1.0 - math.exp(-at.PERIOD_S / p.torque_filter_s)
    memory[at.INPUT_TORQUE] += blend * (sense[at.ENGINE_TORQUE] - memory[at.INPUT_TORQUE])
    memory[at.PHASE_TIME] += at.PERIOD_S
    memory[at.DWELL] += at.PERIOD_S


@part
def control(memory: FloatArray, sense: FloatArray, commands: FloatArray, cycles: FloatArray, law: ControlLaw) -> None:
    """Take one step of 1 ms: read ``sense``, update ``memory``, write ``commands``."""
    tick(memory, sense, law)
    drive(memory, commands, cycles, law)
    is_slipping = memory[at.PHASE] != at.HOLD and memory[at.PHASE_TIME] > at.LONGEST_SHIFT_S
    if is_slipping or memory[at.DWELL] > at.LONGEST_GEAR_S:
        memory[at.IS_FINISHED] = at.IS_STUCK
    if memory[at.IS_FINISHED] != 0.0:
        return
    phase = int(memory[at.PHASE])
    if phase == at.HOLD:  # the clutch of the current gear holds, the other one is empty
        preselect(memory, sense, commands, cycles, law)
        active = clutch_of(int(memory[at.CURRENT_GEAR]))
        command_torque(commands, active, hold_torque_nm(memory, law), law)
        command_pressure(commands, 1 - active, 0.0)
        if wants_shift(memory, sense, cycles, law):
            memory[at.TARGET_GEAR] = next_gear(memory, cycles)
            memory[at.IS_FILLED] = 0.0
            enter_phase(memory, at.PREFILL)
    elif phase == at.PREFILL:
        prefill_phase(memory, sense, commands, law)
    elif phase == at.TORQUE:
        torque_phase(memory, sense, commands, law)
    elif phase == at.INERTIA:
        inertia_phase(memory, sense, commands, law)
    else:
        lock_up_phase(memory, commands, law)
