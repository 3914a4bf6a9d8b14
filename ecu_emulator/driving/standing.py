"""From standstill on and back: creep, launch, roll-out, other gears while both clutches are open."""

import math

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import gear_choice
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DrivelineState, EngineMode, ManoeuvreKind
from ecu_emulator.driving.laws import (
    DrivingLaw,
    begin_event,
    end_event,
    enter_state,
    gear_speed_rad_s,
    idle_rad_s,
    shift_shaft,
)
from ecu_emulator.plant.driveline import GRAVITY_M_S2
from ecu_emulator.shift_control import tcu, tcu_data

_CREEP_SHARE = 0.8  # of the speed at which creeping ends: from there on the car may roll
_RESTING_FOOT_S = 0.15
_FREE_S = 0.5  # a clutch that has just been locked is given this time to slip
_SOON_S = 0.5  # with open clutches the gear is chosen for the speed that braking will have left
_STANDING_M_S = 0.05
BRAKING_M_S2 = 0.1
_FIRST_ONLY_M_S = 1.5  # below it the car starts in 1st gear
_HILL_RATIO = 0.015  # grade from which the brakes hold the car for the driver
_HILL_MARGIN = 1.3
_HILL_PULL = 1.8  # of the weight: so much must the clutch be asked to carry, which it will do a moment later
_TARGET_SHOWN_S = 0.06  # a change with open clutches shows its target at least so long before it is done
_ENGINE_READY_RAD_S = 20.0  # below idle: the engine may be loaded
_LOCK_AHEAD_RAD_S = 15.0  # an engine that closes onto a faster shaft aims above it
_LOCK_BEHIND_RAD_S = 5.0
_TAKEN_OVER_S = 0.3  # within which the end of the slip is led instead of the launch: no jerk
_SWINGS_S = 0.2  # over which swings of the driveline are averaged
_RATE_LAG_S = 0.05


@part
def open_both(memory: FloatArray, commands: FloatArray) -> None:
    tcu.open_both(commands)
    memory[at.LAUNCH_TORQUE] = 0.0
    memory[tcu_data.IS_FILLED] = 0.0


@part
def has_foot_on_pedal(memory: FloatArray, law: DrivingLaw) -> bool:
    return bool(memory[at.PEDAL] > law.driving.pedal.overrun_ratio)


@part
def starting_gear(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> int:
    """Return the gear to close the clutch in: the present one if it still does, else the highest that pulls soon."""
    soon_m_s = sense[at.VEHICLE_SPEED] - _SOON_S * memory[at.BRAKE]
    if soon_m_s < _FIRST_ONLY_M_S:
        return 1
    p, current = law.driving.choice, int(memory[tcu_data.CURRENT_GEAR])
    per_m_s = sense[at.DIFF_SPEED] / max(sense[at.VEHICLE_SPEED], _FIRST_ONLY_M_S)
    low_rad_s = gear_choice.low_rad_s(memory, sense, law)
    now_rad_s = gear_speed_rad_s(sense, current, law)
    if p.down_ratio * low_rad_s < soon_m_s * per_m_s * law.drive.overall_ratios[current] and now_rad_s < p.top_rad_s:
        return current
    return gear_choice.highest_pulling_gear(memory, sense, per_m_s, soon_m_s, law)


@part
def gear_while_open(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> bool:
    """Change gears with both clutches open, the target shown first; True once the right gear is engaged."""
    current, target = int(memory[tcu_data.CURRENT_GEAR]), int(memory[tcu_data.TARGET_GEAR])
    are_open = max(sense[tcu_data.FILL], sense[tcu_data.FILL + 1]) < law.drive.control.preselect_fill_ratio
    if target == current and not are_open and gear_choice.is_gear_lost(memory, sense, law):
        return False
    if target == current and are_open:
        target = starting_gear(memory, sense, law)
        if target != current:
            memory[tcu_data.TARGET_GEAR] = target
            memory[at.LIFT_TIME] = 0.0
            begin_event(memory, ManoeuvreKind.REGEAR.value)
    shaft = tcu.clutch_of(target)
    # The synchroniser of 1st gear needs the inertia of an engaged 2nd gear.
    if target == 1 and not shift_shaft(memory, sense, commands, 1, 2, law):
        return False
    is_engaged = shift_shaft(memory, sense, commands, shaft, target, law)
    if target != current:
        memory[at.LIFT_TIME] += tcu_data.PERIOD_S
        if not is_engaged or memory[at.LIFT_TIME] < _TARGET_SHOWN_S:
            return False
        memory[tcu_data.CURRENT_GEAR] = target
        end_event(memory)
    if is_engaged and target != 1:  # meanwhile the other shaft may come near what will be needed next
        shift_shaft(memory, sense, commands, 1 - shaft, max(target - 1, 1) if target != 2 else 1, law)
    return is_engaged


@part
def hold_on_hill(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the brakes hold the car uphill until the clutch carries it."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    pull_n = memory[at.LAUNCH_TORQUE] * law.drive.overall_ratios[gear] / law.drive.plant.vehicle.wheel_radius_m
    weight_n = law.drive.plant.vehicle.mass_kg * GRAVITY_M_S2 * sense[at.GRADE]
    is_rolling = abs(sense[at.VEHICLE_SPEED]) > _STANDING_M_S
    is_needed = sense[at.GRADE] > _HILL_RATIO and pull_n < _HILL_PULL * weight_n and not is_rolling
    commands[at.HILL_BRAKE] = _HILL_MARGIN * GRAVITY_M_S2 * sense[at.GRADE] if is_needed else 0.0


@part
def begin_launch(memory: FloatArray, sense: FloatArray, kind: int, law: DrivingLaw) -> None:
    """Begin a launch, from rest or rolling, or let the clutch close onto a car that rolls by itself."""
    enter_state(memory, DrivelineState.LAUNCHING.value)
    begin_event(memory, kind)
    memory[at.LAUNCH_SPEED] = max(sense[tcu_data.ENGINE_SPEED], idle_rad_s(sense, law))
    memory[tcu_data.LOCKED_TIME] = -_FREE_S
    memory[at.LIFT_TIME] = 0.0
    memory[at.SHARE] = memory[at.SHAFT_AHEAD] = memory[at.LAUNCH_RATE] = 0.0


@part
def begin_creep_or_launch(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> None:
    """Set the car in motion as the driver's foot wants it."""
    if has_foot_on_pedal(memory, law):
        begin_launch(memory, sense, ManoeuvreKind.LAUNCH.value, law)
        return
    enter_state(memory, DrivelineState.CREEPING.value)
    begin_event(memory, ManoeuvreKind.CREEP.value)


@part
def stand(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Standstill: both clutches open, 1st gear engaged."""
    open_both(memory, commands)
    is_ready = gear_while_open(memory, sense, commands, law)
    hold_on_hill(memory, sense, commands, law)
    is_firing = memory[at.ENGINE_STATE] <= EngineMode.FUEL_CUT.value
    is_firing = is_firing and sense[tcu_data.ENGINE_SPEED] > idle_rad_s(sense, law) - _ENGINE_READY_RAD_S
    if abs(sense[at.VEHICLE_SPEED]) > _FIRST_ONLY_M_S:
        enter_state(memory, DrivelineState.COASTING_OPEN.value)
    elif is_ready and is_firing and memory[at.BRAKE] < BRAKING_M_S2:
        memory[at.LIFT_TIME] += tcu_data.PERIOD_S  # the foot is on its way to the pedal, or it rests
        if memory[at.LIFT_TIME] > _RESTING_FOOT_S or has_foot_on_pedal(memory, law):
            begin_creep_or_launch(memory, sense, law)
    else:
        memory[at.LIFT_TIME] = 0.0


@part
def slip_clutch(memory: FloatArray, sense: FloatArray, commands: FloatArray, torque_nm: float, law: DrivingLaw) -> None:
    """Fill the clutch of the current gear, then let it carry a torque; the other one stays empty."""
    clutch = tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    if memory[tcu_data.IS_FILLED] == 0.0 or torque_nm <= 0.0:
        tcu.fill_clutch(memory, sense, commands, clutch, law.drive)
        memory[at.LAUNCH_TORQUE] = 0.0
    else:
        memory[at.LAUNCH_TORQUE] = torque_nm
        tcu.command_torque(commands, clutch, torque_nm, law.drive)
    tcu.command_pressure(commands, 1 - clutch, 0.0)


@part
def creep(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """No foot on the pedal: clutch 1 carries a little, which fades as the car rolls."""
    p = law.driving.launch
    fading = max(1.0 - sense[at.SHAFT_SPEED] / p.creep_fade_rad_s, 0.0)
    torque_nm = min(p.creep_nm * fading, memory[at.LAUNCH_TORQUE] + p.creep_ramp_nm_s * tcu_data.PERIOD_S)
    slip_clutch(memory, sense, commands, torque_nm if fading > 0.0 else 0.0, law)
    hold_on_hill(memory, sense, commands, law)
    if has_foot_on_pedal(memory, law):
        begin_launch(memory, sense, ManoeuvreKind.LAUNCH.value, law)
    elif memory[at.BRAKE] > BRAKING_M_S2 or fading == 0.0:
        end_event(memory)
        is_rolling = sense[at.VEHICLE_SPEED] > _STANDING_M_S
        enter_state(memory, DrivelineState.COASTING_OPEN.value if is_rolling else DrivelineState.STANDSTILL.value)


@part
def coast_open(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Roll with both clutches open until the car stands, or the driver wants to go on."""
    open_both(memory, commands)
    is_ready = gear_while_open(memory, sense, commands, law)
    gear = int(memory[tcu_data.CURRENT_GEAR])
    shaft_rad_s = gear_speed_rad_s(sense, gear, law)
    is_braking = memory[at.BRAKE] > BRAKING_M_S2
    idle = idle_rad_s(sense, law)
    if not is_ready:
        return
    if has_foot_on_pedal(memory, law):
        begin_launch(memory, sense, ManoeuvreKind.LAUNCH.value, law)
    elif abs(sense[at.VEHICLE_SPEED]) < _STANDING_M_S and is_braking:
        enter_state(memory, DrivelineState.STANDSTILL.value)
    elif gear == 1 and not is_braking and shaft_rad_s < _CREEP_SHARE * law.driving.launch.creep_fade_rad_s:
        begin_creep_or_launch(memory, sense, law)
    elif not is_braking and shaft_rad_s > idle + 2.0 * law.driving.choice.open_above_idle_rad_s:
        begin_launch(memory, sense, ManoeuvreKind.CLOSING.value, law)


@part
def launch_torque_nm(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> float:
    """Return what the slipping clutch shall carry [N m].

    At first the driver's wish, and what holds the engine at its speed. Towards the end of the slip what the engine
    gives beyond its own acceleration: the slip follows its lead, and the clutch is held at no more until it is locked.
    """
    p = law.driving.launch
    excess_rad_s = sense[tcu_data.ENGINE_SPEED] - memory[at.LAUNCH_SPEED]
    wished_nm = max(memory[at.DEMAND], 0.0) + p.clutch_gain_nms_rad * excess_rad_s
    given_nm = memory[tcu_data.INPUT_TORQUE] - law.drive.actuation.inertia_kg_m2 * memory[at.LAUNCH_RATE]
    given_nm = max(given_nm, 0.0) + p.lock_gain_nms_rad * excess_rad_s
    share = min(memory[at.SHARE] / _TAKEN_OVER_S, 1.0)
    wanted_nm = wished_nm + share * (given_nm - wished_nm)
    lag_s = p.clutch_lag_s + share * (p.lock_lag_s - p.clutch_lag_s)
    wanted_nm += p.stubborn_nm_s * max(memory[at.SHARE] - p.stubborn_s, 0.0)  # a clutch that will not stick
    smooth_nm = memory[at.LAUNCH_TORQUE] + tcu_data.PERIOD_S / lag_s * (wanted_nm - memory[at.LAUNCH_TORQUE])
    return float(min(max(smooth_nm, law.drive.control.min_torque_nm), p.top_nm))


@part
def steady_shaft_rad_s(memory: FloatArray, sense: FloatArray, clutch: int, law: DrivingLaw) -> float:
    """Return how fast the shaft of the launch turns without the swings of the driveline [rad/s]."""
    ratio = law.drive.overall_ratios[int(memory[tcu_data.CURRENT_GEAR])]
    rolling_rad_s = sense[at.VEHICLE_SPEED] * ratio / law.drive.plant.vehicle.wheel_radius_m
    ahead_rad_s = sense[at.SHAFT_SPEED + clutch] - rolling_rad_s
    memory[at.SHAFT_AHEAD] += tcu_data.PERIOD_S / _SWINGS_S * (ahead_rad_s - memory[at.SHAFT_AHEAD])
    return float(rolling_rad_s + memory[at.SHAFT_AHEAD])


@part
def move_engine(
    memory: FloatArray, sense: FloatArray, commands: FloatArray, shaft_rad_s: float, law: DrivingLaw
) -> None:
    """Bring the engine to its launch speed over the pedal, or a little above a shaft that turns faster."""
    p = law.driving.launch
    goal_rad_s = idle_rad_s(sense, law) + p.engine_above_idle_rad_s + p.engine_per_pedal_rad_s * memory[at.PEDAL]
    late_s = max(memory[at.STATE_TIME] - p.long_s, 0.0)  # a launch that goes on and on shall not burn the clutch
    goal_rad_s = max(goal_rad_s - p.late_rad_s2 * late_s, idle_rad_s(sense, law) + p.late_above_idle_rad_s)
    was_reached = memory[at.SHARE] > 0.0 and shaft_rad_s > idle_rad_s(sense, law)  # a foot that goes down ends no lock
    is_near = was_reached or goal_rad_s < shaft_rad_s + _LOCK_AHEAD_RAD_S
    is_reached = was_reached or (is_near and sense[tcu_data.ENGINE_SPEED] > shaft_rad_s)
    memory[at.SHARE] = memory[at.SHARE] + tcu_data.PERIOD_S if is_reached else 0.0
    if is_near:  # a little above the shaft first, then softly below: the slip shall end
        soft_rad_s = _LOCK_AHEAD_RAD_S * math.exp(-memory[at.SHARE] / p.lock_fade_s)
        goal_rad_s = shaft_rad_s + max(soft_rad_s - p.lock_rate_rad_s2 * memory[at.SHARE], -_LOCK_BEHIND_RAD_S)
    step = p.engine_rate_rad_s2 * tcu_data.PERIOD_S
    move_rad_s = min(max(goal_rad_s - memory[at.LAUNCH_SPEED], -step), step)
    memory[at.LAUNCH_SPEED] += move_rad_s
    memory[at.LAUNCH_RATE] += (
        tcu_data.PERIOD_S / _RATE_LAG_S * (move_rad_s / tcu_data.PERIOD_S - memory[at.LAUNCH_RATE])
    )
    error_rad_s = memory[at.LAUNCH_SPEED] - sense[tcu_data.ENGINE_SPEED]
    help_nm = min(max(p.engine_gain_nms_rad * error_rad_s, 0.0), p.engine_help_nm)
    commands[at.REQUEST] = at.AT_LEAST
    commands[at.REQUESTED_TORQUE] = max(memory[at.DEMAND], 0.0) + help_nm


@part
def is_locked_for_good(memory: FloatArray, sense: FloatArray, clutch: int, law: DrivingLaw) -> bool:
    """Tell whether a clutch has stopped slipping long enough."""
    control = law.drive.control
    is_locked = abs(sense[tcu_data.SLIP + clutch]) < control.locked_slip_rad_s
    is_locked = is_locked or sense[tcu_data.IS_LOCKED + clutch] != 0.0
    memory[tcu_data.LOCKED_TIME] = memory[tcu_data.LOCKED_TIME] + tcu_data.PERIOD_S if is_locked else 0.0
    return bool(memory[tcu_data.LOCKED_TIME] > law.driving.launch.locked_s)


@part
def launch(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the clutch of the current gear slip until the car is as fast as the engine."""
    clutch = tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    shaft_rad_s = sense[at.SHAFT_SPEED + clutch]
    move_engine(memory, sense, commands, steady_shaft_rad_s(memory, sense, clutch, law), law)
    slip_rad_s = sense[tcu_data.SLIP + clutch]
    torque_nm = launch_torque_nm(memory, sense, law) if slip_rad_s > -law.drive.control.locked_slip_rad_s else 0.0
    slip_clutch(memory, sense, commands, torque_nm, law)
    hold_on_hill(memory, sense, commands, law)
    is_wanted = has_foot_on_pedal(memory, law) or memory[at.EVENT_KIND] == ManoeuvreKind.CLOSING.value
    is_wanted = is_wanted and (memory[at.BRAKE] < BRAKING_M_S2 or shaft_rad_s > idle_rad_s(sense, law))
    memory[at.LIFT_TIME] = 0.0 if is_wanted else memory[at.LIFT_TIME] + tcu_data.PERIOD_S
    if memory[tcu_data.IS_FILLED] != 0.0 and is_locked_for_good(memory, sense, clutch, law):
        memory[tcu_data.DWELL] = 0.0
        end_event(memory)
        enter_state(memory, DrivelineState.IN_GEAR.value)
    elif memory[at.IS_ABORTED] != 0.0:
        end_event(memory)
        enter_state(memory, DrivelineState.COASTING_OPEN.value)
    elif memory[at.LIFT_TIME] > law.driving.launch.abort_s:
        memory[at.IS_ABORTED] = 1.0
