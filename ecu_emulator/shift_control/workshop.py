"""What a car does in a workshop: the routine of revs and a start from rest, and pressure steps on a clutch.

The routine begins with the drive, or when a tester asks for it; until then the car waits. It is made of revs in neutral
with both clutches open, then closed, and a start from rest into 1st gear.

What the revs are for: with the clutches open the engine accelerates itself and the hub, with both closed the input
shafts as well, whose inertia is known from the drawing; docs/model.md section "Workshop routine".

By pressure steps on a clutch whose gear is engaged against the brake a touch point is looked for. The engine idles, the
car stands. The clutch is filled, then its pressure comes down step by step; where it carries no torque any more the
engine is relieved. Whoever asked for the steps watches that; docs/model.md "Touch points".
"""

from canlog.arrays import FloatArray
from canlog.jit import kernel, part
from ecu_emulator.shift_control import tcu
from ecu_emulator.shift_control import tcu_data as at
from ecu_emulator.shift_control.tcu_data import ControlLaw, WorkshopParameters

STANDING_BRAKE_M_S2 = 0.5  # [C] about 5 bar, what holds a car on level ground


@kernel
def enter_stage(memory: FloatArray, stage: int) -> None:
    memory[at.ROUTINE] = stage
    memory[at.REV] = 0.0
    memory[at.REV_TIME] = 0.0
    memory[at.IS_REVVING] = 0.0


@part
def rev(memory: FloatArray, sense: FloatArray, count: int, is_settled: bool, p: WorkshopParameters) -> bool:  # noqa: FBT001 - kernels take their arguments by position
    """Move the pedal through the revs of a stage; True once all ``count`` are over."""
    memory[at.REV_TIME] += at.PERIOD_S
    time_s, speed_rad_s = memory[at.REV_TIME], sense[at.ENGINE_SPEED]
    if memory[at.REV] == 0.0:
        is_over = is_settled and time_s >= p.settle_time_s
    elif memory[at.IS_REVVING] != 0.0:
        if speed_rad_s >= p.rev_top_rad_s or time_s >= 0.5 * p.longest_rev_s:
            memory[at.IS_REVVING] = 0.0
        is_over = False
    else:
        is_over = bool(speed_rad_s <= p.rev_bottom_rad_s or time_s >= p.longest_rev_s)
    if not is_over:
        return False
    if memory[at.REV] >= count:
        return True
    memory[at.REV] += 1.0
    memory[at.REV_TIME] = 0.0
    memory[at.IS_REVVING] = 1.0
    return False


@part
def wait(commands: FloatArray) -> None:
    """Idle with both clutches empty and the brake held; whoever asks for the routine moves on to its first stage."""
    tcu.open_both(commands)
    commands[at.THROTTLE] = 0.0
    commands[at.BRAKE] = STANDING_BRAKE_M_S2


@part
def open_revs(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Rev with both clutches empty."""
    tcu.open_both(commands)
    count = int(memory[at.OPEN_REV_COUNT])
    if count == 0 or rev(memory, sense, count, True, law.workshop):
        enter_stage(memory, at.CLOSED_REVS)


@part
def closed_revs(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Rev with both clutches locked, so that both input shafts turn with the hub."""
    count = int(memory[at.CLOSED_REV_COUNT])
    if count == 0:
        enter_stage(memory, at.ENGAGING)
        return
    hold_nm = tcu.hold_torque_nm(memory, law)
    tcu.command_torque(commands, 0, hold_nm, law)
    tcu.command_torque(commands, 1, hold_nm, law)
    is_locked = sense[at.IS_LOCKED] != 0.0 and sense[at.IS_LOCKED + 1] != 0.0
    if rev(memory, sense, count, is_locked, law.workshop):
        enter_stage(memory, at.ENGAGING)


@part
def engage(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Release the brake, empty both clutches, preselect 2nd gear, engage 1st."""
    tcu.open_both(commands)
    commands[at.BRAKE] = 0.0
    memory[at.REV_TIME] += at.PERIOD_S
    is_empty = max(sense[at.FILL], sense[at.FILL + 1]) < law.control.preselect_fill_ratio
    if memory[at.REV_TIME] >= law.workshop.settle_time_s and is_empty:
        commands[at.WANTED_GEAR + 1] = 2.0
    if sense[at.IS_ENGAGED + 1] != 0.0:
        commands[at.WANTED_GEAR] = 1.0
    if sense[at.IS_ENGAGED] != 0.0:
        memory[at.TARGET_GEAR] = 1.0
        memory[at.IS_FILLED] = 0.0
        tcu.enter_phase(memory, at.PREFILL)
        enter_stage(memory, at.FILLING)


@part
def launch(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Set the car in motion: the slipping clutch takes what holds the engine at its launch speed."""
    commands[at.THROTTLE] = law.workshop.launch_pedal_ratio
    excess_rad_s = sense[at.ENGINE_SPEED] - law.workshop.launch_engine_rad_s
    torque_nm = memory[at.INPUT_TORQUE] + law.workshop.launch_gain_nms_rad * excess_rad_s
    tcu.command_torque(commands, 0, max(torque_nm, law.control.min_torque_nm), law)
    tcu.begin_lock_up(memory, sense, commands, 0, law)
    if memory[at.PHASE] == at.LOCK_UP:
        enter_stage(memory, at.LOCKING)


@part
def perform(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Take one step of 1 ms of the routine."""
    tcu.tick(memory, sense, law)
    stage = int(memory[at.ROUTINE])
    if stage == at.WAITING:
        wait(commands)
    elif stage == at.OPEN_REVS:
        open_revs(memory, sense, commands, law)
    elif stage == at.CLOSED_REVS:
        closed_revs(memory, sense, commands, law)
    elif stage == at.ENGAGING:
        engage(memory, sense, commands, law)
    elif stage == at.FILLING:
        tcu.fill_clutch(memory, sense, commands, 0, law)
        if memory[at.PHASE_TIME] >= law.control.prefill_time_s:
            memory[at.LOCKED_TIME] = 0.0
            tcu.enter_phase(memory, at.INERTIA)
            enter_stage(memory, at.LAUNCHING)
    elif stage == at.LAUNCHING:
        launch(memory, sense, commands, law)
    else:  # to the hold level, then the shift control takes over in 1st gear
        tcu.lock_up_phase(memory, commands, law)
        if memory[at.PHASE] == at.HOLD:
            enter_stage(memory, at.NO_ROUTINE)
    if stage <= at.CLOSED_REVS:
        commands[at.THROTTLE] = law.workshop.rev_pedal_ratio if memory[at.IS_REVVING] != 0.0 else 0.0


# Of the pressure steps, all [C].
GEARS = (5, 6)  # in which each clutch is stepped: those in which the wheels feel least of it
OPEN_S = 1.0  # for which the clutch stays empty before it is filled
FILL_S = 0.5  # for which it is held above the first step, so that its film closes
FILL_ABOVE_PA = 0.2e5
STEP_S = 0.8
RELEASE_S = 0.4


@part
def move_shafts(memory: FloatArray, commands: FloatArray, gear: int) -> None:
    """Want a gear on the shaft whose clutch is stepped, and none on the other."""
    clutch = int(memory[at.STEP_CLUTCH])
    commands[at.WANTED_GEAR + clutch] = gear
    commands[at.WANTED_GEAR + 1 - clutch] = 0.0


@part
def fill_for_steps(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Fill the cavity fast, then hold it above the first step."""
    clutch = int(memory[at.STEP_CLUTCH])
    if memory[at.IS_FILLED] == 0.0 and sense[at.FILL + clutch] >= law.control.prefill_ratio:
        memory[at.IS_FILLED] = 1.0
        memory[at.REV_TIME] = 0.0
    is_filled = memory[at.IS_FILLED] != 0.0
    held_pa = memory[at.STEP_TOP] + FILL_ABOVE_PA
    tcu.command_pressure(commands, clutch, held_pa if is_filled else law.control.prefill_pressure_pa)
    if is_filled and memory[at.REV_TIME] >= FILL_S:
        memory[at.STEP] = 0.0
        enter_stage(memory, at.STEPPING)


@part
def perform_steps(memory: FloatArray, sense: FloatArray, commands: FloatArray, law: ControlLaw) -> None:
    """Take one step of 1 ms."""
    tcu.tick(memory, sense, law)
    memory[at.REV_TIME] += at.PERIOD_S
    wait(commands)
    stage, clutch = int(memory[at.ROUTINE]), int(memory[at.STEP_CLUTCH])
    if stage == at.STEPS_ENGAGING:  # the brake holds the wheels, and so the shaft
        move_shafts(memory, commands, GEARS[clutch])
        if sense[at.IS_ENGAGED + clutch] != 0.0 and sense[at.SHAFT_GEAR + clutch] == GEARS[clutch]:
            enter_stage(memory, at.STEPS_OPEN)
    elif stage == at.STEPS_OPEN:  # for a while: what the engine gives now it gives without the clutch
        if memory[at.REV_TIME] >= OPEN_S:
            memory[at.IS_FILLED] = 0.0
            enter_stage(memory, at.STEPS_FILLING)
    elif stage == at.STEPS_FILLING:
        fill_for_steps(memory, sense, commands, law)
    elif stage == at.STEPPING:  # each for its time, from the highest pressure to the lowest
        tcu.command_pressure(commands, clutch, memory[at.STEP_TOP] - memory[at.STEP] * memory[at.STEP_DOWN])
        if memory[at.REV_TIME] >= STEP_S:
            memory[at.STEP] += 1.0
            memory[at.REV_TIME] = 0.0
        if memory[at.STEP] >= memory[at.STEP_COUNT]:
            enter_stage(memory, at.STEPS_RELEASING)
    elif (
        memory[at.REV_TIME] >= RELEASE_S and max(sense[at.FILL], sense[at.FILL + 1]) < law.control.preselect_fill_ratio
    ):  # both clutches are empty: take the gear out, and wait for whoever asks next
        move_shafts(memory, commands, 0)
        enter_stage(memory, at.WAITING)
