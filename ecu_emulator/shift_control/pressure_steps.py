"""Pressure steps on a clutch whose gear is engaged against the brake: what a touch point is looked for with.

The engine idles, the car stands. The clutch is filled, then its pressure comes down step by step; where it carries no
torque any more the engine is relieved. Whoever asked for the steps watches that; docs/model.md "Touch points".
"""

from canlog.arrays import FloatArray
from canlog.jit import part
from ecu_emulator.shift_control import tcu, workshop
from ecu_emulator.shift_control import tcu_data as at
from ecu_emulator.shift_control.tcu_data import ControlParameters

# All [C].
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
def engage(memory: FloatArray, sense: FloatArray, commands: FloatArray) -> None:
    """Engage the gear; the brake holds the wheels, and so the shaft."""
    clutch = int(memory[at.STEP_CLUTCH])
    move_shafts(memory, commands, GEARS[clutch])
    if sense[at.IS_ENGAGED + clutch] != 0.0 and sense[at.SHAFT_GEAR + clutch] == GEARS[clutch]:
        workshop.enter_stage(memory, at.STEPS_OPEN)


@part
def stay_open(memory: FloatArray) -> None:
    """Leave the clutch empty for a while: what the engine gives now it gives without it."""
    if memory[at.REV_TIME] >= OPEN_S:
        memory[at.IS_FILLED] = 0.0
        workshop.enter_stage(memory, at.STEPS_FILLING)


@part
def fill(memory: FloatArray, sense: FloatArray, commands: FloatArray, control: ControlParameters) -> None:
    """Fill the cavity fast, then hold it above the first step."""
    clutch = int(memory[at.STEP_CLUTCH])
    if memory[at.IS_FILLED] == 0.0 and sense[at.FILL + clutch] >= control.prefill_ratio:
        memory[at.IS_FILLED] = 1.0
        memory[at.REV_TIME] = 0.0
    is_filled = memory[at.IS_FILLED] != 0.0
    held_pa = memory[at.STEP_TOP] + FILL_ABOVE_PA
    tcu.command_pressure(commands, clutch, held_pa if is_filled else control.prefill_pressure_pa)
    if is_filled and memory[at.REV_TIME] >= FILL_S:
        memory[at.STEP] = 0.0
        workshop.enter_stage(memory, at.STEPPING)


@part
def step(memory: FloatArray, commands: FloatArray) -> None:
    """Hold each step for its time, from the highest pressure to the lowest."""
    pressure_pa = memory[at.STEP_TOP] - memory[at.STEP] * memory[at.STEP_DOWN]
    tcu.command_pressure(commands, int(memory[at.STEP_CLUTCH]), pressure_pa)
    if memory[at.REV_TIME] >= STEP_S:
        memory[at.STEP] += 1.0
        memory[at.REV_TIME] = 0.0
    if memory[at.STEP] >= memory[at.STEP_COUNT]:
        workshop.enter_stage(memory, at.STEPS_RELEASING)


@part
def release(memory: FloatArray, sense: FloatArray, commands: FloatArray, control: ControlParameters) -> None:
    """Empty the clutch, take the gear out and wait for whoever asks next."""
    is_empty = max(sense[at.FILL], sense[at.FILL + 1]) < control.preselect_fill_ratio
    if is_empty and memory[at.REV_TIME] >= RELEASE_S:
        move_shafts(memory, commands, 0)
        workshop.enter_stage(memory, at.WAITING)


@part
def perform(memory: FloatArray, sense: FloatArray, commands: FloatArray, control: ControlParameters) -> None:
    """Take one step of 1 ms."""
    tcu.tick(memory, sense, control)
    memory[at.REV_TIME] += at.PERIOD_S
    workshop.wait(commands)
    stage = int(memory[at.ROUTINE])
    if stage == at.STEPS_ENGAGING:
        engage(memory, sense, commands)
    elif stage == at.STEPS_OPEN:
        stay_open(memory)
    elif stage == at.STEPS_FILLING:
        fill(memory, sense, commands, control)
    elif stage == at.STEPPING:
        step(memory, commands)
    else:
        release(memory, sense, commands, control)
