"""Downshifts under power: the off-going clutch slips and lets the engine rise, then the torque is handed over."""

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.changes import NOBODY, SYNC_BAND_RAD_S, catch_overrun, lock_up
from ecu_emulator.driving.laws import DrivingLaw, gear_speed_rad_s, shift_shaft
from ecu_emulator.shift_control import tcu, tcu_data

_RAISE_MARGIN_NM = 15.0
_RELEASED_RATIO = 0.6  # of the touch pressure
_SETTLE_RATE_RAD_S2 = 25.0


@array_kernel
def press(commands: FloatArray, clutch: int, torque_nm: float, law: DrivingLaw) -> None:
    """Let a clutch carry a torque; if it shall carry none, open it far enough for its film to let go."""
    if torque_nm > 0.0:
        tcu.command_torque(commands, clutch, torque_nm, law.drive.actuation)
    else:
        tcu.command_pressure(commands, clutch, _RELEASED_RATIO * law.drive.actuation.touch_pressure_pa[clutch])


@array_kernel
def engine_reference(memory: FloatArray, sense: FloatArray, gear: int, law: DrivingLaw) -> tuple[float, float]:
    """Return the engine speed [rad/s] and its rate [rad/s^2] on the way to a little above a gear's speed."""
    p = law.driving.change
    rise_rad_s = gear_speed_rad_s(sense, gear, law) + p.overshoot_rad_s - memory[at.START_SPEED]
    length_s = max(p.raise_time_s, 1.5 * rise_rad_s / p.raise_rad_s2)
    q = min(memory[tcu_data.PHASE_TIME] / length_s, 1.0)
    return memory[at.START_SPEED] + rise_rad_s * q * q * (3.0 - 2.0 * q), rise_rad_s * 6.0 * q * (1.0 - q) / length_s


@array_kernel
def carried_nm(memory: FloatArray, sense: FloatArray, commands: FloatArray, gear: int, law: DrivingLaw) -> float:
    """Return the torque the clutches shall take from the engine so that it follows its reference [N m]."""
    wanted_rad_s, rate_rad_s2 = engine_reference(memory, sense, gear, law)
    inertia_nm = law.drive.actuation.inertia_kg_m2 * rate_rad_s2
    commands[at.REQUEST] = at.AT_LEAST
    commands[at.REQUESTED_TORQUE] = inertia_nm + _RAISE_MARGIN_NM
    error_rad_s = sense[at.HUB_SPEED] - wanted_rad_s
    help_nm = max(-law.driving.change.gain_nms_rad * error_rad_s, 0.0)
    commands[at.REQUESTED_TORQUE] += min(help_nm, law.driving.launch.engine_help_nm)
    control, change = law.drive.control, law.driving.change
    limit_rad = control.slip_integral_limit_rad
    summed_rad = memory[tcu_data.INTEGRAL] + error_rad_s * tcu_data.PERIOD_S
    memory[tcu_data.INTEGRAL] = min(max(summed_rad, -limit_rad), limit_rad)
    torque_nm = memory[tcu_data.INPUT_TORQUE] - inertia_nm + change.gain_nms_rad * error_rad_s
    torque_nm += control.slip_integral_gain_nm_rad * memory[tcu_data.INTEGRAL]
    return float(torque_nm)


@array_kernel
def begin_leg(memory: FloatArray, sense: FloatArray, from_clutch: int, to_gear: int) -> None:
    """Begin to hand the torque from one clutch to that of a gear."""
    memory[at.FROM_CLUTCH] = from_clutch
    memory[at.TO_GEAR] = to_gear
    memory[at.SHARE] = 0.0
    memory[at.START_SPEED] = sense[at.HUB_SPEED]
    memory[tcu_data.IS_FILLED] = 0.0


@array_kernel
def fill_next(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> bool:
    """Bring the next clutch to its touch point, its shaft to its gear first; True once it may take torque."""
    to_gear = int(memory[at.TO_GEAR])
    clutch = tcu.clutch_of(to_gear)
    if not shift_shaft(memory, sense, commands, clutch, to_gear, law):
        tcu.command_pressure(commands, clutch, 0.0)
        return False
    tcu.fill_clutch(memory, sense, commands, clutch, law.drive.actuation, law.drive.control)
    return bool(memory[tcu_data.IS_FILLED] != 0.0)


@array_kernel
def raise_engine(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the engine rise over a slipping off-going clutch; at the speed of the next gear torque may be handed over."""
    to_gear, target = int(memory[at.TO_GEAR]), int(memory[tcu_data.TARGET_GEAR])
    torque_nm = carried_nm(memory, sense, commands, target, law)
    press(commands, int(memory[at.FROM_CLUTCH]), torque_nm, law)
    is_ready = fill_next(memory, sense, commands, law)
    is_fast = sense[at.HUB_SPEED] > gear_speed_rad_s(sense, to_gear, law) + SYNC_BAND_RAD_S
    if is_ready and (is_fast or memory[tcu_data.PHASE_TIME] > law.driving.change.longest_s):
        memory[at.SHARE] = 1.0e-6


@array_kernel
def hand_over(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Move the torque from clutch to clutch; behind a bridge the next leg begins, else the new clutch locks."""
    target, to_gear, control = int(memory[tcu_data.TARGET_GEAR]), int(memory[at.TO_GEAR]), law.drive.control
    coming, going = tcu.clutch_of(to_gear), int(memory[at.FROM_CLUTCH])
    torque_nm = max(carried_nm(memory, sense, commands, target, law), control.min_torque_nm)
    memory[at.SHARE] = min(memory[at.SHARE] + tcu_data.PERIOD_S / law.driving.change.handover_s, 1.0)
    tcu.command_torque(commands, coming, memory[at.SHARE] * torque_nm, law.drive.actuation)
    if memory[at.SHARE] < control.dump_ratio:
        tcu.command_torque(commands, going, (1.0 - memory[at.SHARE]) * torque_nm, law.drive.actuation)
        return
    tcu.command_pressure(commands, going, 0.0)
    if memory[at.SHARE] < 1.0:
        return
    if to_gear != target:
        time_s, start_rad_s = memory[tcu_data.PHASE_TIME], memory[at.START_SPEED]
        begin_leg(memory, sense, coming, target)
        memory[at.START_SPEED] = start_rad_s
        tcu.enter_phase(memory, tcu_data.INERTIA)
        memory[tcu_data.PHASE_TIME] = time_s
        return
    memory[tcu_data.LOCKED_TIME] = 0.0
    memory[at.SHARE] = 2.0


@array_kernel
def settle_on(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """All torque is on the new clutch: let the engine fall onto its shaft."""
    target = int(memory[tcu_data.TARGET_GEAR])
    coming = tcu.clutch_of(target)
    memory[at.SHARE] += tcu_data.PERIOD_S
    wanted_rad_s = law.driving.change.overshoot_rad_s - _SETTLE_RATE_RAD_S2 * (memory[at.SHARE] - 2.0)
    wanted_rad_s = max(wanted_rad_s, -law.driving.change.overshoot_rad_s)
    slip_rad_s = sense[tcu_data.SLIP + coming]
    if memory[at.FROM_CLUTCH] == NOBODY or slip_rad_s < -SYNC_BAND_RAD_S:
        catch_overrun(memory, sense, commands, law)
        return
    torque_nm = max(memory[tcu_data.INPUT_TORQUE], 0.0) + law.driving.change.gain_nms_rad * (slip_rad_s - wanted_rad_s)
    tcu.command_torque(commands, coming, max(torque_nm, law.drive.control.min_torque_nm), law.drive.actuation)
    tcu.command_pressure(commands, 1 - coming, 0.0)
    tcu.begin_lock_up(memory, sense, commands, coming, law.drive.control)


@array_kernel
def downshift_under_power(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Power-on downshift, kickdown, or a skip over the other shaft: slip and rise, then hand over, then lock."""
    phase = int(memory[tcu_data.PHASE])
    if phase == tcu_data.LOCK_UP:
        lock_up(memory, sense, commands, law)
        return
    if phase == tcu_data.PREFILL:
        control, going = law.drive.control, tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
        fill_next(memory, sense, commands, law)
        release_nm = control.release_gain_ratio * abs(memory[tcu_data.INPUT_TORQUE]) + control.release_margin_nm
        tcu.command_torque(commands, going, release_nm, law.drive.actuation)
        if memory[tcu_data.PHASE_TIME] >= control.prefill_time_s:
            memory[at.START_SPEED] = sense[at.HUB_SPEED]
            memory[tcu_data.INTEGRAL] = 0.0
            tcu.enter_phase(memory, tcu_data.INERTIA)
        return
    if memory[at.SHARE] == 0.0 and memory[at.FROM_CLUTCH] != NOBODY:
        raise_engine(memory, sense, commands, law)
    elif memory[at.SHARE] <= 1.0 and memory[at.FROM_CLUTCH] != NOBODY:
        memory[tcu_data.PHASE] = tcu_data.TORQUE
        hand_over(memory, sense, commands, law)
    else:
        memory[tcu_data.PHASE] = tcu_data.INERTIA
        settle_on(memory, sense, commands, law)
