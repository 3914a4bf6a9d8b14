"""The launch: a clutch slips until the car is as fast as the engine; the end of its slip is led down softly."""

import math

from canlog.arrays import FloatArray
from canlog.jit import array_kernel, kernel
from ecu_emulator.driving import indices as at
from ecu_emulator.driving import standing
from ecu_emulator.driving.laws import DrivingLaw, end_event, enter_state, idle_rad_s
from ecu_emulator.driving.parameters import LaunchParameters
from ecu_emulator.driving.states import DriveState, EventKind
from ecu_emulator.shift_control import tcu, tcu_data

_LOCK_AHEAD_RAD_S = 15.0  # an engine that closes onto a faster shaft aims above it
_LOCK_BEHIND_RAD_S = 5.0
_TAKEN_OVER_S = 0.3  # within which the end of the slip is led instead of the launch: no jerk
_SWINGS_S = 0.2  # over which swings of the driveline are averaged
_RATE_LAG_S = 0.05


@array_kernel
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


@array_kernel
def steady_shaft_rad_s(memory: FloatArray, sense: FloatArray, clutch: int, law: DrivingLaw) -> float:
    """Return how fast the shaft of the launch turns without the swings of the driveline [rad/s]."""
    ratio = law.drive.overall_ratios[int(memory[tcu_data.CURRENT_GEAR])]
    rolling_rad_s = sense[at.VEHICLE_SPEED] * ratio / law.drive.plant.vehicle.wheel_radius_m
    ahead_rad_s = sense[at.SHAFT_SPEED + clutch] - rolling_rad_s
    memory[at.SHAFT_AHEAD] += tcu_data.PERIOD_S / _SWINGS_S * (ahead_rad_s - memory[at.SHAFT_AHEAD])
    return float(rolling_rad_s + memory[at.SHAFT_AHEAD])


@kernel
def led_slip_rad_s(time_s: float, p: LaunchParameters) -> float:
    """Return the slip so long after the engine has come near the shaft: led down softly, in the end below zero."""
    soft_rad_s = _LOCK_AHEAD_RAD_S * math.exp(-time_s / p.lock_fade_s)
    return max(soft_rad_s - p.lock_rate_rad_s2 * time_s, -_LOCK_BEHIND_RAD_S)


@array_kernel
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
    if is_near:  # a little above the shaft first, then below: the slip shall end
        goal_rad_s = shaft_rad_s + led_slip_rad_s(memory[at.SHARE], p)
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


@array_kernel
def is_locked_for_good(memory: FloatArray, sense: FloatArray, clutch: int, law: DrivingLaw) -> bool:
    """Tell whether a clutch has stopped slipping long enough."""
    control = law.drive.control
    is_locked = abs(sense[tcu_data.SLIP + clutch]) < control.locked_slip_rad_s
    is_locked = is_locked or sense[tcu_data.IS_LOCKED + clutch] != 0.0
    memory[tcu_data.LOCKED_TIME] = memory[tcu_data.LOCKED_TIME] + tcu_data.PERIOD_S if is_locked else 0.0
    return bool(memory[tcu_data.LOCKED_TIME] > law.driving.launch.locked_s)


@array_kernel
def launch(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the clutch of the current gear slip until the car is as fast as the engine."""
    clutch = tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    shaft_rad_s = sense[at.SHAFT_SPEED + clutch]
    move_engine(memory, sense, commands, steady_shaft_rad_s(memory, sense, clutch, law), law)
    slip_rad_s = sense[tcu_data.SLIP + clutch]
    torque_nm = launch_torque_nm(memory, sense, law) if slip_rad_s > -law.drive.control.locked_slip_rad_s else 0.0
    standing.slip_clutch(memory, sense, commands, torque_nm, law)
    standing.hold_on_hill(memory, sense, commands, law)
    is_wanted = standing.has_foot_on_pedal(memory, law) or memory[at.EVENT_KIND] == EventKind.CLOSING.value
    is_wanted = is_wanted and (memory[at.BRAKE] < standing.BRAKING_M_S2 or shaft_rad_s > idle_rad_s(sense, law))
    memory[at.LIFT_TIME] = 0.0 if is_wanted else memory[at.LIFT_TIME] + tcu_data.PERIOD_S
    if memory[tcu_data.IS_FILLED] != 0.0 and is_locked_for_good(memory, sense, clutch, law):
        memory[tcu_data.DWELL] = 0.0
        end_event(memory)
        enter_state(memory, DriveState.IN_GEAR.value)
    elif memory[at.IS_ABORTED] != 0.0:
        end_event(memory)
        enter_state(memory, DriveState.COASTING_OPEN.value)
    elif memory[at.LIFT_TIME] > law.driving.launch.abort_s:
        memory[at.IS_ABORTED] = 1.0
