"""The transmission control on the road: which state it is in, and which change it begins."""

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import changes, gear_choice, standing
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.indices import DrivelineState, ManoeuvreKind
from ecu_emulator.driving.laws import DrivingLaw, begin_event, end_event, enter_state, idle_rad_s
from ecu_emulator.shift_control import tcu, tcu_data

_PULLING_NM = 8.0  # torque from which the engine drives the car
_HOLD_RATIO = 1.15  # of the engine torque, and a margin: so much holds at once
_HOLD_MARGIN_NM = 15.0
_AHEAD_S = 0.15  # the clutch opens so long before the engine would get too slow
_HIGHEST_OPENED_GEAR = 2


@part
def kind_of_change(memory: FloatArray, wanted: int, law: DrivingLaw) -> int:
    """Return the kind of the change from the current to another gear."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    is_pulling = memory[tcu_data.INPUT_TORQUE] > _PULLING_NM
    is_pulling = is_pulling and memory[at.PEDAL] > law.driving.pedal.overrun_ratio
    if wanted > gear:
        return ManoeuvreKind.POWER_ON_UPSHIFT.value if is_pulling else ManoeuvreKind.POWER_OFF_UPSHIFT.value
    is_asked = memory[at.PEDAL] > law.driving.pedal.overrun_ratio
    if wanted == gear - 2:
        return ManoeuvreKind.POWER_ON_SKIP.value if is_asked else ManoeuvreKind.COAST_SKIP.value
    if not is_asked:
        return ManoeuvreKind.COAST_DOWNSHIFT.value
    if memory[at.PEDAL] > law.driving.choice.kickdown_pedal_ratio:
        return ManoeuvreKind.KICKDOWN.value
    return ManoeuvreKind.POWER_ON_DOWNSHIFT.value


@part
def begin_change(memory: FloatArray, sense: FloatArray, wanted: int, law: DrivingLaw) -> None:
    gear = int(memory[tcu_data.CURRENT_GEAR])
    begin_event(memory, kind_of_change(memory, wanted, law))
    enter_state(memory, DrivelineState.CHANGING.value)
    memory[tcu_data.TARGET_GEAR] = wanted
    next_gear = gear - 1 if memory[at.EVENT_KIND] == ManoeuvreKind.POWER_ON_SKIP.value else wanted
    changes.begin_leg(memory, sense, tcu.clutch_of(gear), next_gear)
    tcu.enter_phase(memory, tcu_data.PREFILL)


@part
def hold(memory: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Press the clutch of the current gear, harder step by step after it has locked."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    hold_nm = tcu.hold_torque_nm(memory, law.drive)
    ramp_nm = memory[at.LAUNCH_TORQUE] + law.driving.launch.hold_rate_nm_s * tcu_data.PERIOD_S
    least_nm = _HOLD_RATIO * abs(memory[tcu_data.INPUT_TORQUE]) + _HOLD_MARGIN_NM
    memory[at.LAUNCH_TORQUE] = min(hold_nm, max(ramp_nm, least_nm))
    tcu.command_torque(commands, tcu.clutch_of(gear), memory[at.LAUNCH_TORQUE], law.drive)
    tcu.command_pressure(commands, 1 - tcu.clutch_of(gear), 0.0)


@part
def is_too_slow(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether the engine would soon get too slow in this gear."""
    gear = int(memory[tcu_data.CURRENT_GEAR])
    slope_rad_s2 = -memory[at.BRAKE] * law.drive.overall_ratios[gear] / law.drive.plant.vehicle.wheel_radius_m
    soon_rad_s = sense[tcu_data.ENGINE_SPEED] + _AHEAD_S * slope_rad_s2
    margin_rad_s = law.driving.choice.open_above_idle_rad_s
    if gear > _HIGHEST_OPENED_GEAR:  # a lower gear comes first, if there is time
        margin_rad_s *= 0.3
    return bool(soon_rad_s < idle_rad_s(sense, law) + margin_rad_s)


@part
def stay_in_gear(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Hold the gear, prepare the next, change when the map says so, open before the engine stalls."""
    hold(memory, commands, law)
    if is_too_slow(memory, sense, law):
        if standing.has_foot_on_pedal(memory, law):
            standing.begin_launch(memory, sense, ManoeuvreKind.LAUNCH.value, law)
        else:
            enter_state(memory, DrivelineState.COASTING_OPEN.value)
        return
    wanted = gear_choice.wanted_gear(memory, sense, law)
    is_ready = gear_choice.preselect(memory, sense, commands, wanted, law)
    gear = int(memory[tcu_data.CURRENT_GEAR])
    is_pulling = memory[at.PEDAL] > law.driving.pedal.overrun_ratio
    if wanted > gear and gear_choice.is_foot_coming_off(memory, law):
        return  # in a moment the same upshift is one without power
    if is_ready or (wanted == gear - 2 and not is_pulling):
        begin_change(memory, sense, wanted, law)


@part
def change(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Go on with a change; back in gear when it is over."""
    kind = int(memory[at.EVENT_KIND])
    if memory[at.IS_ABORTED] != 0.0:
        changes.return_to_gear(memory, sense, commands, law)
    elif kind == ManoeuvreKind.POWER_ON_UPSHIFT.value:
        changes.upshift(memory, sense, commands, law)
    elif kind in (ManoeuvreKind.POWER_OFF_UPSHIFT.value, ManoeuvreKind.COAST_DOWNSHIFT.value):
        changes.unloaded_change(memory, sense, commands, law)
    elif kind == ManoeuvreKind.COAST_SKIP.value:
        changes.coast_skip(memory, sense, commands, law)
    else:
        changes.downshift_under_power(memory, sense, commands, law)
    if memory[at.IS_ABORTED] == 0.0 and changes.is_turned_back(memory, sense, law):
        memory[at.IS_ABORTED] = 1.0  # the target follows at once, the clutches need a moment
        memory[tcu_data.TARGET_GEAR] = memory[tcu_data.CURRENT_GEAR]
        tcu.enter_phase(memory, tcu_data.LOCK_UP)
    if memory[tcu_data.PHASE] == tcu_data.HOLD:
        memory[at.LAUNCH_TORQUE] = commands[tcu_data.TORQUE_COMMAND + tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))]
        memory[tcu_data.DWELL] = 0.0
        end_event(memory)
        enter_state(memory, DrivelineState.IN_GEAR.value)


@part
def lose_gear(memory: FloatArray) -> None:
    """Break off what is going on, shown for a millisecond; then both clutches open, and the gear is found anew."""
    if memory[at.EVENT_NUMBER] != 0.0 and memory[at.IS_ABORTED] == 0.0:
        memory[at.IS_ABORTED] = 1.0
        return
    memory[tcu_data.TARGET_GEAR] = memory[tcu_data.CURRENT_GEAR]
    end_event(memory)
    enter_state(memory, DrivelineState.COASTING_OPEN.value)


@part
def have_whim(memory: FloatArray, whims: FloatArray) -> None:
    """Let the driver's foot do what no trace asks for, some time after an event has begun."""
    if memory[at.WHIM_TIME] > 0.0:
        memory[at.WHIM_TIME] -= tcu_data.PERIOD_S
        return
    row = whims[int(memory[at.EVENT_COUNT]) % whims.shape[0]]
    delay_s = row[at.WHIM_DELAY] if memory[at.EVENT_NUMBER] != 0.0 else row[at.WHIM_IN_GEAR_DELAY]
    if abs(memory[at.STATE_TIME] - delay_s) < 0.5 * tcu_data.PERIOD_S:
        memory[at.WHIM_TIME] = row[at.WHIM_LENGTH]
        memory[at.WHIM_PEDAL] = row[at.WHIM_SIZE]


@part
def control(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Take one step of 1 ms: read ``sense``, update ``memory``, write ``commands``."""
    tcu.tick(memory, sense, law.drive)
    memory[at.STATE_TIME] += tcu_data.PERIOD_S
    commands[tcu_data.SPARK] = 1.0
    commands[at.REQUEST] = at.NO_REQUEST
    commands[at.HILL_BRAKE] = 0.0
    has_clutch = memory[at.STATE] not in (DrivelineState.STANDSTILL.value, DrivelineState.COASTING_OPEN.value)
    if has_clutch and gear_choice.is_gear_lost(memory, sense, law):
        lose_gear(memory)
    state = int(memory[at.STATE])
    if state == DrivelineState.IN_GEAR.value:
        stay_in_gear(memory, sense, commands, law)
    elif state == DrivelineState.CHANGING.value:
        change(memory, sense, commands, law)
    elif state == DrivelineState.STANDSTILL.value:
        standing.stand(memory, sense, commands, law)
    elif state == DrivelineState.CREEPING.value:
        standing.creep(memory, sense, commands, law)
    elif state == DrivelineState.LAUNCHING.value:
        standing.launch(memory, sense, commands, law)
    else:
        standing.coast_open(memory, sense, commands, law)
    commands[tcu_data.BRAKE] = max(memory[at.BRAKE], commands[at.HILL_BRAKE])
