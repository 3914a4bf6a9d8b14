"""From standstill on and back: creep, roll-out, other gears while both clutches are open; launches are next door."""

from canlog.arrays import FloatArray
from canlog.jit import array_kernel
from ecu_emulator.driving import gear_choice
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.laws import (
    DrivingLaw,
    begin_event,
    end_event,
    enter_state,
    gear_speed_rad_s,
    idle_rad_s,
    shift_shaft,
)
from ecu_emulator.driving.states import DriveState, EngineState, EventKind
from ecu_emulator.plant.vehicle import GRAVITY_M_S2
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


@array_kernel
def open_both(memory: FloatArray, commands: FloatArray) -> None:
    """Empty both clutches."""
    tcu.command_pressure(commands, 0, 0.0)
    tcu.command_pressure(commands, 1, 0.0)
    memory[at.LAUNCH_TORQUE] = 0.0
    memory[tcu_data.IS_FILLED] = 0.0


@array_kernel
def has_foot_on_pedal(memory: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether the driver asks for force."""
    return bool(memory[at.PEDAL] > law.driving.pedal.overrun_ratio)


@array_kernel
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
    gear = tcu_data.GEAR_COUNT
    while gear > 1 and soon_m_s * per_m_s * law.drive.overall_ratios[gear] < p.up_ratio * low_rad_s:
        gear -= 1
    return gear


@array_kernel
def gear_while_open(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> bool:
    """Change gears with both clutches open, the target shown first; True once the right gear is engaged."""
    current, target = int(memory[tcu_data.CURRENT_GEAR]), int(memory[tcu_data.TARGET_GEAR])
    are_open = max(sense[tcu_data.FILL], sense[tcu_data.FILL + 1]) < law.drive.control.preselect_fill_ratio
    if target == current and are_open:
        target = starting_gear(memory, sense, law)
        if target != current:
            memory[tcu_data.TARGET_GEAR] = target
            memory[at.LIFT_TIME] = 0.0
            begin_event(memory, EventKind.REGEAR.value)
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


@array_kernel
def hold_on_hill(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the brakes hold the car uphill until the clutch carries it."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    pull_n = memory[at.LAUNCH_TORQUE] * law.drive.overall_ratios[gear] / law.drive.plant.vehicle.wheel_radius_m
    weight_n = law.drive.plant.vehicle.mass_kg * GRAVITY_M_S2 * sense[at.GRADE]
    is_rolling = abs(sense[at.VEHICLE_SPEED]) > _STANDING_M_S
    is_needed = sense[at.GRADE] > _HILL_RATIO and pull_n < _HILL_PULL * weight_n and not is_rolling
    commands[at.HILL_BRAKE] = _HILL_MARGIN * GRAVITY_M_S2 * sense[at.GRADE] if is_needed else 0.0


@array_kernel
def begin_launch(memory: FloatArray, sense: FloatArray, kind: int, law: DrivingLaw) -> None:
    """Begin a launch, from rest or rolling, or let the clutch close onto a car that rolls by itself."""
    enter_state(memory, DriveState.LAUNCHING.value)
    begin_event(memory, kind)
    memory[at.LAUNCH_SPEED] = max(sense[tcu_data.ENGINE_SPEED], idle_rad_s(sense, law))
    memory[tcu_data.LOCKED_TIME] = -_FREE_S
    memory[at.LIFT_TIME] = 0.0
    memory[at.SHARE] = memory[at.SHAFT_AHEAD] = memory[at.LAUNCH_RATE] = 0.0


@array_kernel
def begin_creep_or_launch(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> None:
    """Set the car in motion as the driver's foot wants it."""
    if has_foot_on_pedal(memory, law):
        begin_launch(memory, sense, EventKind.LAUNCH.value, law)
        return
    enter_state(memory, DriveState.CREEPING.value)
    begin_event(memory, EventKind.CREEP.value)


@array_kernel
def stand(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Standstill: both clutches open, 1st gear engaged."""
    open_both(memory, commands)
    is_ready = gear_while_open(memory, sense, commands, law)
    hold_on_hill(memory, sense, commands, law)
    is_firing = memory[at.ENGINE_STATE] <= EngineState.FUEL_CUT.value
    is_firing = is_firing and sense[tcu_data.ENGINE_SPEED] > idle_rad_s(sense, law) - _ENGINE_READY_RAD_S
    if abs(sense[at.VEHICLE_SPEED]) > _FIRST_ONLY_M_S:
        enter_state(memory, DriveState.COASTING_OPEN.value)
    elif is_ready and is_firing and memory[at.BRAKE] < BRAKING_M_S2:
        memory[at.LIFT_TIME] += tcu_data.PERIOD_S  # the foot is on its way to the pedal, or it rests
        if memory[at.LIFT_TIME] > _RESTING_FOOT_S or has_foot_on_pedal(memory, law):
            begin_creep_or_launch(memory, sense, law)
    else:
        memory[at.LIFT_TIME] = 0.0


@array_kernel
def slip_clutch(memory: FloatArray, sense: FloatArray, commands: FloatArray, torque_nm: float, law: DrivingLaw) -> None:
    """Fill the clutch of the current gear, then let it carry a torque; the other one stays empty."""
    clutch = tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    if memory[tcu_data.IS_FILLED] == 0.0 or torque_nm <= 0.0:
        tcu.fill_clutch(memory, sense, commands, clutch, law.drive.actuation, law.drive.control)
        memory[at.LAUNCH_TORQUE] = 0.0
    else:
        memory[at.LAUNCH_TORQUE] = torque_nm
        tcu.command_torque(commands, clutch, torque_nm, law.drive.actuation)
    tcu.command_pressure(commands, 1 - clutch, 0.0)


@array_kernel
def creep(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """No foot on the pedal: clutch 1 carries a little, which fades as the car rolls."""
    p = law.driving.launch
    fading = max(1.0 - sense[at.SHAFT_SPEED] / p.creep_fade_rad_s, 0.0)
    torque_nm = min(p.creep_nm * fading, memory[at.LAUNCH_TORQUE] + p.creep_ramp_nm_s * tcu_data.PERIOD_S)
    slip_clutch(memory, sense, commands, torque_nm if fading > 0.0 else 0.0, law)
    hold_on_hill(memory, sense, commands, law)
    if has_foot_on_pedal(memory, law):
        begin_launch(memory, sense, EventKind.LAUNCH.value, law)
    elif memory[at.BRAKE] > BRAKING_M_S2 or fading == 0.0:
        end_event(memory)
        is_rolling = sense[at.VEHICLE_SPEED] > _STANDING_M_S
        enter_state(memory, DriveState.COASTING_OPEN.value if is_rolling else DriveState.STANDSTILL.value)


@array_kernel
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
        begin_launch(memory, sense, EventKind.LAUNCH.value, law)
    elif abs(sense[at.VEHICLE_SPEED]) < _STANDING_M_S and is_braking:
        enter_state(memory, DriveState.STANDSTILL.value)
    elif gear == 1 and not is_braking and shaft_rad_s < _CREEP_SHARE * law.driving.launch.creep_fade_rad_s:
        begin_creep_or_launch(memory, sense, law)
    elif not is_braking and shaft_rad_s > idle + 2.0 * law.driving.choice.open_above_idle_rad_s:
        begin_launch(memory, sense, EventKind.CLOSING.value, law)
