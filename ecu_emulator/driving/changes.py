"""Changes of gear on the road: upshifts, changes without power, downshifts under power, and the change of mind."""

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.driving import indices as at
from ecu_emulator.driving.gear_choice import low_rad_s
from ecu_emulator.driving.indices import ManoeuvreKind
from ecu_emulator.driving.laws import DrivingLaw, gear_speed_rad_s, overrun_nm, shift_shaft
from ecu_emulator.shift_control import tcu, tcu_data

_KEEPS_RATIO = 0.85  # of the map's threshold: so far must the pedal have changed for the old gear to be right again
_LATEST_SHARE = 0.7  # of the torque phase: later no change of mind
_SHOWN_S = 0.05  # a target that was chosen stands so long: others have seen it
SYNC_BAND_RAD_S = 2.0
NOBODY = -1  # no clutch gives its torque away
_RAISE_MARGIN_NM = 15.0
_RELEASED_RATIO = 0.6  # of the touch pressure
_SETTLE_RATE_RAD_S2 = 25.0


@part
def is_turned_back(memory: FloatArray, sense: FloatArray, law: DrivingLaw) -> bool:
    """Tell whether the driver's foot has made the old gear the right one again while there is time to go back."""
    phase = int(memory[tcu_data.PHASE])
    early_s = _LATEST_SHARE * law.drive.control.torque_phase_s
    if phase != tcu_data.PREFILL and not (phase == tcu_data.TORQUE and memory[tcu_data.PHASE_TIME] < early_s):
        return False
    if phase == tcu_data.PREFILL and memory[tcu_data.PHASE_TIME] < _SHOWN_S:
        return False
    low, kind = low_rad_s(memory, sense, law), int(memory[at.EVENT_KIND])
    if kind in (ManoeuvreKind.POWER_ON_UPSHIFT.value, ManoeuvreKind.POWER_OFF_UPSHIFT.value):
        return gear_speed_rad_s(sense, int(memory[tcu_data.TARGET_GEAR]), law) < _KEEPS_RATIO * low
    if kind in (ManoeuvreKind.COAST_DOWNSHIFT.value, ManoeuvreKind.COAST_SKIP.value):
        return False
    is_released = memory[at.PEDAL] <= law.driving.pedal.overrun_ratio
    return is_released and gear_speed_rad_s(sense, int(memory[tcu_data.CURRENT_GEAR]), law) > low


@part
def lock_up(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Raise the pressure to the hold level and keep it until the clutch sticks, which takes longer in the cold."""
    control, clutch = law.drive.control, tcu.clutch_of(int(memory[tcu_data.TARGET_GEAR]))
    is_over = sense[tcu_data.IS_LOCKED + clutch] != 0.0 or memory[tcu_data.PHASE_TIME] > law.driving.change.longest_s
    if memory[tcu_data.PHASE_TIME] < control.lockup_time_s or is_over:
        tcu.lock_up_phase(memory, commands, law.drive)
        return
    tcu.command_torque(commands, clutch, tcu.hold_torque_nm(memory, law.drive), law.drive)
    tcu.command_pressure(commands, 1 - clutch, 0.0)


@part
def return_to_gear(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the clutch of the old gear take up its torque again and the other one open."""
    clutch = tcu.clutch_of(int(memory[tcu_data.CURRENT_GEAR]))
    p = law.driving.change
    share = min(memory[tcu_data.PHASE_TIME] / p.return_s, 1.0)
    hold_nm = tcu.hold_torque_nm(memory, law.drive)
    torque_nm = max(abs(memory[tcu_data.INPUT_TORQUE]), share * hold_nm)
    tcu.command_torque(commands, clutch, torque_nm, law.drive)
    tcu.command_pressure(commands, 1 - clutch, 0.0)
    commands[tcu_data.SPARK] = 1.0
    is_locked = abs(sense[tcu_data.SLIP + clutch]) < law.drive.control.locked_slip_rad_s
    if (share >= 1.0 and is_locked) or memory[tcu_data.PHASE_TIME] > p.longest_s:
        memory[tcu_data.PHASE] = tcu_data.HOLD


@part
def turn_engine(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Have the engine come to the speed of the target gear by itself: a blip of the throttle, or less fuel."""
    p = law.driving.change
    goal_rad_s = gear_speed_rad_s(sense, int(memory[tcu_data.TARGET_GEAR]), law)
    error_rad_s = goal_rad_s - sense[tcu_data.ENGINE_SPEED]
    torque_nm = p.blip_gain_nms_rad * error_rad_s
    least_nm = overrun_nm(sense[tcu_data.ENGINE_SPEED], law)
    most_nm = p.blip_rad_s2 * law.drive.actuation.inertia_kg_m2
    commands[at.REQUEST] = at.EXACTLY
    commands[at.REQUESTED_TORQUE] = min(max(torque_nm, least_nm), most_nm)


@part
def catch(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Close the clutch of the target gear once the engine turns nearly as fast as its shaft."""
    p, clutch = law.driving.change, tcu.clutch_of(int(memory[tcu_data.TARGET_GEAR]))
    slip_rad_s = sense[tcu_data.SLIP + clutch]
    is_near = abs(slip_rad_s) < p.catch_rad_s or memory[tcu_data.PHASE_TIME] > p.longest_s
    if memory[at.SHARE] == 0.0 and not is_near:
        tcu.fill_clutch(memory, sense, commands, clutch, law.drive)
    else:
        memory[at.SHARE] += tcu_data.PERIOD_S  # time since it began to close
        grip_nm = min(p.catch_nm + p.catch_rate_nm_s * memory[at.SHARE], p.catch_limit_nm)
        driven_nm = memory[tcu_data.INPUT_TORQUE] if slip_rad_s > 0.0 else 0.0
        tcu.command_torque(commands, clutch, grip_nm + max(driven_nm, 0.0), law.drive)
        tcu.begin_lock_up(memory, sense, commands, clutch, law.drive)
    tcu.command_pressure(commands, 1 - clutch, 0.0)


@part
def catch_overrun(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Bring up an engine that a lift in mid-shift has made slower than the new gear, then catch it."""
    if memory[at.FROM_CLUTCH] != NOBODY:
        memory[at.FROM_CLUTCH] = NOBODY
        memory[at.SHARE] = 0.0
    turn_engine(memory, sense, commands, law)
    catch(memory, sense, commands, law)


@part
def upshift(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Power-on upshift: prefill, torque phase, inertia phase with less spark, lock-up, as on the shift cycles."""
    phase = int(memory[tcu_data.PHASE])
    if phase == tcu_data.PREFILL:
        tcu.prefill_phase(memory, sense, commands, law.drive)
    elif phase == tcu_data.TORQUE:
        tcu.torque_phase(memory, sense, commands, law.drive)
    elif phase == tcu_data.INERTIA:
        coming = tcu.clutch_of(int(memory[tcu_data.TARGET_GEAR]))
        if memory[at.FROM_CLUTCH] == NOBODY or sense[tcu_data.SLIP + coming] < -SYNC_BAND_RAD_S:
            catch_overrun(memory, sense, commands, law)
        else:
            tcu.inertia_phase(memory, sense, commands, law.drive)
    else:
        lock_up(memory, sense, commands, law)


@part
def unloaded_change(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Change up or down without power: the old clutch opens, the engine turns itself, the new clutch catches it."""
    phase = int(memory[tcu_data.PHASE])
    if phase == tcu_data.PREFILL:
        tcu.prefill_phase(memory, sense, commands, law.drive)
        if memory[tcu_data.PHASE] == tcu_data.TORQUE:
            memory[at.SHARE] = 0.0
            memory[tcu_data.LOCKED_TIME] = 0.0
            tcu.enter_phase(memory, tcu_data.INERTIA)
    elif phase == tcu_data.INERTIA:
        turn_engine(memory, sense, commands, law)
        catch(memory, sense, commands, law)
    else:
        lock_up(memory, sense, commands, law)


@part
def coast_skip(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Two gears down on one shaft while coasting: the clutch opens, the shaft changes its gear, the clutch catches."""
    if memory[tcu_data.PHASE] == tcu_data.LOCK_UP:
        lock_up(memory, sense, commands, law)
        return
    turn_engine(memory, sense, commands, law)
    target = int(memory[tcu_data.TARGET_GEAR])
    clutch = tcu.clutch_of(target)
    if memory[tcu_data.PHASE] == tcu_data.PREFILL:
        memory[at.SHARE] = 0.0
        memory[tcu_data.LOCKED_TIME] = 0.0
        memory[tcu_data.IS_FILLED] = 0.0
        tcu.open_both(commands)
        if shift_shaft(memory, sense, commands, clutch, target, law):
            tcu.enter_phase(memory, tcu_data.INERTIA)
        return
    catch(memory, sense, commands, law)


@part
def carried_nm(memory: FloatArray, sense: FloatArray, commands: FloatArray, gear: int, law: DrivingLaw) -> float:
    """Return the torque the clutches shall take from the engine [N m]: so it rises to a little above a gear's speed."""
    control, change = law.drive.control, law.driving.change
    rise_rad_s = gear_speed_rad_s(sense, gear, law) + change.overshoot_rad_s - memory[at.START_SPEED]
    length_s = max(change.raise_time_s, 1.5 * rise_rad_s / change.raise_rad_s2)
    q = min(memory[tcu_data.PHASE_TIME] / length_s, 1.0)
    inertia_nm = law.drive.actuation.inertia_kg_m2 * (rise_rad_s * 6.0 * q * (1.0 - q) / length_s)
    commands[at.REQUEST] = at.AT_LEAST
    commands[at.REQUESTED_TORQUE] = inertia_nm + _RAISE_MARGIN_NM
    error_rad_s = sense[at.HUB_SPEED] - (memory[at.START_SPEED] + rise_rad_s * q * q * (3.0 - 2.0 * q))
    help_nm = max(-change.gain_nms_rad * error_rad_s, 0.0)
    commands[at.REQUESTED_TORQUE] += min(help_nm, law.driving.launch.engine_help_nm)
    limit_rad = control.slip_integral_limit_rad
    summed_rad = memory[tcu_data.INTEGRAL] + error_rad_s * tcu_data.PERIOD_S
    memory[tcu_data.INTEGRAL] = min(max(summed_rad, -limit_rad), limit_rad)
    torque_nm = memory[tcu_data.INPUT_TORQUE] - inertia_nm + change.gain_nms_rad * error_rad_s
    torque_nm += control.slip_integral_gain_nm_rad * memory[tcu_data.INTEGRAL]
    return float(torque_nm)


@part
def begin_leg(memory: FloatArray, sense: FloatArray, from_clutch: int, to_gear: int) -> None:
    """Begin to hand the torque from one clutch to that of a gear."""
    memory[at.FROM_CLUTCH] = from_clutch
    memory[at.TO_GEAR] = to_gear
    memory[at.SHARE] = 0.0
    memory[at.START_SPEED] = sense[at.HUB_SPEED]
    memory[tcu_data.IS_FILLED] = 0.0


@part
def fill_next(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> bool:
    """Bring the next clutch to its touch point, its shaft to its gear first; True once it may take torque."""
    to_gear = int(memory[at.TO_GEAR])
    clutch = tcu.clutch_of(to_gear)
    if not shift_shaft(memory, sense, commands, clutch, to_gear, law):
        tcu.command_pressure(commands, clutch, 0.0)
        return False
    tcu.fill_clutch(memory, sense, commands, clutch, law.drive)
    return bool(memory[tcu_data.IS_FILLED] != 0.0)


@part
def raise_engine(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Let the engine rise over a slipping off-going clutch; at the speed of the next gear torque may be handed over."""
    to_gear, target = int(memory[at.TO_GEAR]), int(memory[tcu_data.TARGET_GEAR])
    torque_nm = carried_nm(memory, sense, commands, target, law)
    going = int(memory[at.FROM_CLUTCH])
    if torque_nm > 0.0:
        tcu.command_torque(commands, going, torque_nm, law.drive)
    else:  # far enough open for its film to let go
        tcu.command_pressure(commands, going, _RELEASED_RATIO * law.drive.actuation.touch_pressure_pa[going])
    is_ready = fill_next(memory, sense, commands, law)
    is_fast = sense[at.HUB_SPEED] > gear_speed_rad_s(sense, to_gear, law) + SYNC_BAND_RAD_S
    if is_ready and (is_fast or memory[tcu_data.PHASE_TIME] > law.driving.change.longest_s):
        memory[at.SHARE] = 1.0e-6


@part
def hand_over(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: DrivingLaw) -> None:
    """Move the torque from clutch to clutch; behind a bridge the next leg begins, else the new clutch locks."""
    target, to_gear, control = int(memory[tcu_data.TARGET_GEAR]), int(memory[at.TO_GEAR]), law.drive.control
    coming, going = tcu.clutch_of(to_gear), int(memory[at.FROM_CLUTCH])
    torque_nm = max(carried_nm(memory, sense, commands, target, law), control.min_torque_nm)
    memory[at.SHARE] = min(memory[at.SHARE] + tcu_data.PERIOD_S / law.driving.change.handover_s, 1.0)
    tcu.command_torque(commands, coming, memory[at.SHARE] * torque_nm, law.drive)
    if memory[at.SHARE] < control.dump_ratio:
        tcu.command_torque(commands, going, (1.0 - memory[at.SHARE]) * torque_nm, law.drive)
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


@part
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
    tcu.command_torque(commands, coming, max(torque_nm, law.drive.control.min_torque_nm), law.drive)
    tcu.command_pressure(commands, 1 - coming, 0.0)
    tcu.begin_lock_up(memory, sense, commands, coming, law.drive)


@part
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
        tcu.command_torque(commands, going, release_nm, law.drive)
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
