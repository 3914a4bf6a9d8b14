"""An automatic with a torque converter: its changes of gear, and its lock-up clutch, which mostly slips a little."""

import math

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import gear_choice
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DrivelineState, LockUpState, ManoeuvreKind
from ecu_emulator.driving.laws import DrivingLaw, begin_event, end_event, enter_state
from ecu_emulator.shift_control import tcu, tcu_data

_STANDING_M_S = 0.1
_HOLDING_M_S2 = 4.0  # the converter pulls at a standing car
_EMPTY_RATIO = 0.3  # of the cavity: the clutch is open
_ROUNDING = 1.0e-9
_INTEGRAL_LIMIT_NM = 60.0
_LEAST_NM = 3.0  # that keeps a closed clutch closed


@part
def enter_lock_up(memory: FloatArray, state: int) -> None:
    memory[at.LOCKUP_STATE] = state
    memory[at.LOCKUP_TIME] = 0.0
    memory[tcu_data.INTEGRAL] = 0.0
    memory[tcu_data.START_SLIP] = memory[at.LOCKUP_SLIP]


@part
def turbine_rad_s(sense: FloatArray, gear: int, law: DrivingLaw) -> float:
    """Return the speed of the turbine in a gear once no wheel slides any more [rad/s]."""
    return float(law.drive.overall_ratios[gear] * sense[at.VEHICLE_SPEED] / law.drive.plant.vehicle.wheel_radius_m)


@part
def has_outrun(sense: FloatArray, gear: int, law: DrivingLaw) -> bool:
    """Tell whether the car is too fast for a gear: somebody has moved it at once, and its wheels are yet to follow."""
    is_too_fast = turbine_rad_s(sense, gear, law) > law.driving.choice.over_rad_s
    return is_too_fast and not gear_choice.is_highest(gear, law)


@part
def found_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> int:
    """Return the gear for the speed of the car, whatever its wheels do."""
    rad_per_m = 1.0 / law.drive.plant.vehicle.wheel_radius_m
    return gear_choice.highest_pulling_gear(memory, sense, rad_per_m, sense[at.VEHICLE_SPEED], law)


@part
def change(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Open the lock-up clutch, then lead the ratio of the gearbox to that of the target gear."""
    if has_outrun(sense, int(memory[tcu_data.TARGET_GEAR]), law):
        memory[tcu_data.TARGET_GEAR] = found_gear(memory, sense, law)
        memory[at.START_RATIO] = sense[at.GEAR_RATIO]
        memory[at.STATE_TIME] = min(memory[at.STATE_TIME], law.driving.lock_up.release_s)
    p, time_s = law.driving.lock_up, memory[at.STATE_TIME] - law.driving.lock_up.release_s
    if time_s < 0.0:
        return
    memory[tcu_data.PHASE] = tcu_data.INERTIA
    target = int(memory[tcu_data.TARGET_GEAR])
    q = min((time_s + tcu_data.PERIOD_S) / p.change_s, 1.0)
    goal, start = law.drive.overall_ratios[target], memory[at.START_RATIO]
    wanted = goal if q >= 1.0 else start + (goal - start) * q * q * (3.0 - 2.0 * q)
    commands[at.RATIO_RATE] = (wanted - sense[at.GEAR_RATIO]) / tcu_data.PERIOD_S
    if target > memory[tcu_data.CURRENT_GEAR]:
        commands[tcu_data.SPARK] = 1.0 - p.spark_reduction_ratio * math.sin(math.pi * q)
    if q >= 1.0 and abs(goal - sense[at.GEAR_RATIO]) < _ROUNDING:
        memory[tcu_data.CURRENT_GEAR] = memory[tcu_data.TARGET_GEAR]
        memory[tcu_data.DWELL] = 0.0
        end_event(memory)
        enter_state(memory, DrivelineState.IN_GEAR.value)


@part
def choose_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> None:
    """Stand in 1st gear; on the way change as the map wants."""
    is_standing = abs(sense[at.VEHICLE_SPEED]) < _STANDING_M_S and memory[at.BRAKE] > 0.0
    if is_standing and memory[at.STATE] != DrivelineState.STANDSTILL.value:
        enter_state(memory, DrivelineState.STANDSTILL.value)
    if not is_standing and memory[at.STATE] == DrivelineState.STANDSTILL.value:
        enter_state(memory, DrivelineState.IN_GEAR.value)
    if is_standing:
        wanted = 1
    elif gear_choice.is_gear_lost(memory, sense, law) or has_outrun(sense, int(memory[tcu_data.CURRENT_GEAR]), law):
        wanted = found_gear(memory, sense, law)
    else:
        wanted = gear_choice.wanted_gear(memory, sense, law)
    if wanted != memory[tcu_data.CURRENT_GEAR]:
        begin_event(memory, ManoeuvreKind.NONE.value)
        enter_state(memory, DrivelineState.CHANGING.value)
        memory[tcu_data.TARGET_GEAR] = wanted
        memory[at.START_RATIO] = sense[at.GEAR_RATIO]


@part
def may_close(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether gear, warmth, speed and pedal let the lock-up clutch close, or stay closed."""
    p, is_open = law.driving.lock_up, memory[at.LOCKUP_STATE] == LockUpState.OPEN.value
    if memory[at.STATE] != DrivelineState.IN_GEAR.value or memory[tcu_data.CURRENT_GEAR] < p.least_gear:
        return False
    if sense[at.OIL] < p.least_oil_k or memory[at.PEDAL] > p.most_pedal_ratio:
        return False
    is_settled = memory[tcu_data.DWELL] > p.settle_s or not is_open
    return bool(is_settled and sense[at.TURBINE_SPEED] > (p.on_rad_s if is_open else p.off_rad_s))


@part
def follow_slip(
    memory: FloatArray,
    sense: FloatArray,
    commands: FloatArray,
    wanted_rad_s: float,
    rate_rad_s2: float,
    law: DrivingLaw,
) -> None:
    """Command the torque that should lead the slip along its reference: balance of the engine, slowly corrected."""
    p = law.driving.lock_up
    error_rad_s = memory[at.LOCKUP_SLIP] - wanted_rad_s
    summed_nm = memory[tcu_data.INTEGRAL] + p.integral_gain_nm_rad * error_rad_s * tcu_data.PERIOD_S
    memory[tcu_data.INTEGRAL] = min(max(summed_nm, -_INTEGRAL_LIMIT_NM), _INTEGRAL_LIMIT_NM)
    torque_nm = memory[tcu_data.INPUT_TORQUE] - sense[at.IMPELLER_TORQUE]
    torque_nm -= law.drive.actuation.inertia_kg_m2 * rate_rad_s2
    torque_nm += p.gain_nms_rad * error_rad_s + memory[tcu_data.INTEGRAL]
    tcu.command_torque(commands, 0, max(torque_nm, _LEAST_NM), law.drive)


@part
def apply_lock_up(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, wanted_rad_s: float, law: DrivingLaw
) -> None:
    """Fill the clutch, then lead the slip to what is wanted."""
    if memory[tcu_data.IS_FILLED] == 0.0:
        tcu.fill_clutch(memory, sense, commands, 0, law.drive)
        enter_lock_up(memory, LockUpState.APPLYING.value)
        return
    length_s, start_rad_s = law.driving.lock_up.apply_s, memory[tcu_data.START_SLIP]
    q = memory[at.LOCKUP_TIME] / length_s
    if q >= 1.0:
        summed_nm = memory[tcu_data.INTEGRAL]
        enter_lock_up(memory, LockUpState.SLIPPING.value)
        memory[tcu_data.INTEGRAL] = summed_nm
        q = 1.0
    way_rad_s = wanted_rad_s - start_rad_s
    now_rad_s = start_rad_s + way_rad_s * q * q * (3.0 - 2.0 * q)
    follow_slip(memory, sense, commands, now_rad_s, way_rad_s * 6.0 * q * (1.0 - q) / length_s, law)


@part
def control_lock_up(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Open, apply, slip, lock, release."""
    p, input_nm = law.driving.lock_up, memory[tcu_data.INPUT_TORQUE]
    slip_rad_s = sense[tcu_data.ENGINE_SPEED] - sense[at.TURBINE_SPEED]
    memory[at.LOCKUP_SLIP] += tcu_data.PERIOD_S / p.slip_lag_s * (slip_rad_s - memory[at.LOCKUP_SLIP])
    memory[at.LOCKUP_TIME] += tcu_data.PERIOD_S
    state, is_allowed = int(memory[at.LOCKUP_STATE]), may_close(memory, sense, law)
    if not is_allowed and LockUpState.OPEN.value < state < LockUpState.RELEASING.value:
        state = LockUpState.RELEASING.value
        enter_lock_up(memory, state)
    share = min(abs(input_nm) / p.most_slip_nm, 1.0)
    wanted_rad_s = p.least_slip_rad_s + share * (p.most_slip_rad_s - p.least_slip_rad_s)
    lock_rad_s = p.locked_rad_s - (p.hysteresis_rad_s if state == LockUpState.LOCKED.value else 0.0)
    is_coasting = input_nm < (p.coast_nm if state == LockUpState.LOCKED.value else -p.coast_nm)
    is_tight = is_coasting or sense[at.TURBINE_SPEED] > lock_rad_s
    if state == LockUpState.APPLYING.value:
        apply_lock_up(memory, sense, commands, wanted_rad_s, law)
    elif state == LockUpState.SLIPPING.value:
        follow_slip(memory, sense, commands, wanted_rad_s, 0.0, law)
        if is_tight:
            enter_lock_up(memory, LockUpState.LOCKED.value)
    elif state == LockUpState.LOCKED.value:
        tcu.command_torque(commands, 0, p.hold_ratio * abs(input_nm) + p.hold_nm, law.drive)
        if not is_tight:  # it is full: what follows is the way to the slip
            enter_lock_up(memory, LockUpState.APPLYING.value)
    else:
        tcu.command_pressure(commands, 0, 0.0)
        if state == LockUpState.RELEASING.value and sense[tcu_data.FILL] < _EMPTY_RATIO:
            enter_lock_up(memory, LockUpState.OPEN.value)
        elif state == LockUpState.OPEN.value and is_allowed:
            memory[tcu_data.IS_FILLED] = 0.0
            enter_lock_up(memory, LockUpState.APPLYING.value)


@part
def control(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Take one step of 1 ms: read ``sense``, update ``memory``, write ``commands``."""
    tcu.tick(memory, sense, law.drive)
    memory[at.STATE_TIME] += tcu_data.PERIOD_S
    commands[tcu_data.SPARK] = 1.0
    commands[at.REQUEST] = at.NO_REQUEST
    commands[at.RATIO_RATE] = 0.0
    if memory[at.STATE] == DrivelineState.CHANGING.value:
        change(memory, sense, commands, law)
    else:
        choose_gear(memory, sense, law)
    control_lock_up(memory, sense, commands, law)
    is_standing = memory[at.STATE] == DrivelineState.STANDSTILL.value
    commands[tcu_data.BRAKE] = max(memory[at.BRAKE], _HOLDING_M_S2 if is_standing else 0.0)
