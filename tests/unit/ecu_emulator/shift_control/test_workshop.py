import numpy as np
import pytest

from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.shift_control import tcu_data, workshop
from ecu_emulator.shift_control.tcu_data import ClutchActuation

PARAMETERS = nominal_parameters()
ACTUATION = ClutchActuation(
    touch_pressure_pa=(1.3e5, 1.5e5), pressure_per_torque_pa_nm=(2.0e3, 3.0e3), inertia_kg_m2=0.24
)
SETTLE_MS = 800


class Routine:
    """The routine with its arrays, the engine idling; a test changes what it is about."""

    def __init__(self, *, open_revs: int = 0, closed_revs: int = 0) -> None:
        self.memory = np.zeros(tcu_data.MEMORY_COUNT)
        self.sense = np.zeros(tcu_data.SENSE_COUNT)
        self.commands = np.zeros(tcu_data.COMMAND_COUNT)
        self.memory[tcu_data.OPEN_REV_COUNT] = open_revs
        self.memory[tcu_data.CLOSED_REV_COUNT] = closed_revs
        self.memory[tcu_data.ROUTINE] = tcu_data.OPEN_REVS
        self.sense[tcu_data.ENGINE_SPEED] = 90.0

    def run(self, milliseconds: int = 1) -> None:
        for _ in range(milliseconds):
            workshop.perform(self.memory, self.sense, self.commands, ACTUATION, PARAMETERS.control, PARAMETERS.workshop)

    @property
    def stage(self) -> int:
        return int(self.memory[tcu_data.ROUTINE])

    @property
    def pedal_ratio(self) -> float:
        return float(self.commands[tcu_data.THROTTLE])


def test_the_pedal_goes_down_until_the_engine_is_fast_and_again_when_it_is_slow() -> None:
    routine = Routine(open_revs=2)
    routine.run(SETTLE_MS - 2)
    assert routine.pedal_ratio == 0.0
    routine.run(3)
    assert (routine.memory[tcu_data.REV], routine.pedal_ratio) == (1.0, 0.45)
    routine.sense[tcu_data.ENGINE_SPEED] = 401.0
    routine.run(2)
    assert (routine.memory[tcu_data.REV], routine.pedal_ratio) == (1.0, 0.0)
    routine.sense[tcu_data.ENGINE_SPEED] = 99.0
    routine.run()
    assert (routine.memory[tcu_data.REV], routine.pedal_ratio) == (2.0, 0.45)


def test_an_engine_that_does_not_get_fast_or_slow_ends_its_rev_all_the_same() -> None:
    routine = Routine(open_revs=1)
    routine.sense[tcu_data.ENGINE_SPEED] = 250.0
    routine.run(SETTLE_MS + 2010)
    assert (routine.memory[tcu_data.REV], routine.pedal_ratio) == (1.0, 0.0)
    routine.run(2000)
    assert routine.stage == tcu_data.ENGAGING


def test_closed_revs_wait_until_both_clutches_are_locked() -> None:
    routine = Routine(closed_revs=1)
    routine.sense[tcu_data.IS_LOCKED] = 1.0
    routine.run(2 * SETTLE_MS)
    assert (routine.stage, routine.memory[tcu_data.REV]) == (tcu_data.CLOSED_REVS, 0.0)
    assert routine.commands[tcu_data.PRESSURE : tcu_data.PRESSURE + 2] == pytest.approx(
        [1.3e5 + 70.0 * 2.0e3, 1.5e5 + 70.0 * 3.0e3]
    )
    routine.sense[tcu_data.IS_LOCKED + 1] = 1.0
    routine.run()
    assert routine.memory[tcu_data.REV] == 1.0


def test_gears_wait_for_empty_clutches_and_come_one_after_the_other() -> None:
    routine = Routine()
    routine.memory[tcu_data.ROUTINE] = tcu_data.ENGAGING
    routine.sense[tcu_data.FILL + 1] = 0.9
    routine.run(2 * SETTLE_MS)
    wanted = routine.commands[tcu_data.WANTED_GEAR : tcu_data.WANTED_GEAR + 2]
    assert wanted.tolist() == [0.0, 0.0]
    routine.sense[tcu_data.FILL + 1] = 0.1
    routine.run()
    assert wanted.tolist() == [0.0, 2.0]
    routine.sense[tcu_data.IS_ENGAGED + 1] = 1.0
    routine.run()
    assert wanted.tolist() == [1.0, 2.0]
    assert routine.stage == tcu_data.ENGAGING
    routine.sense[tcu_data.IS_ENGAGED] = 1.0
    routine.run()
    assert (routine.stage, routine.memory[tcu_data.TARGET_GEAR]) == (tcu_data.FILLING, 1.0)


def test_the_launching_clutch_takes_more_from_a_faster_engine() -> None:
    routine = Routine()
    routine.memory[tcu_data.ROUTINE] = tcu_data.LAUNCHING
    routine.memory[[tcu_data.TARGET_GEAR, tcu_data.PHASE]] = 1, tcu_data.INERTIA
    routine.sense[tcu_data.ENGINE_TORQUE] = routine.memory[tcu_data.INPUT_TORQUE] = 80.0
    routine.sense[tcu_data.SLIP] = 60.0
    for speed_rad_s, torque_nm in ((60.0, 4.0), (130.0, 80.0), (140.0, 100.0)):
        routine.sense[tcu_data.ENGINE_SPEED] = speed_rad_s
        routine.run()
        assert routine.commands[tcu_data.TORQUE_COMMAND] == pytest.approx(torque_nm)
    routine.sense[tcu_data.SLIP] = 0.1
    routine.run(22)
    assert (routine.stage, routine.memory[tcu_data.PHASE]) == (tcu_data.LOCKING, tcu_data.LOCK_UP)
    routine.run(251)
    assert (routine.stage, routine.memory[tcu_data.CURRENT_GEAR]) == (tcu_data.NO_ROUTINE, 1.0)


def test_a_car_that_waits_idles_with_the_brake_held_until_it_starts() -> None:
    routine = Routine()
    routine.memory[tcu_data.ROUTINE] = tcu_data.WAITING
    routine.run(20 * SETTLE_MS)
    assert (routine.stage, routine.pedal_ratio) == (tcu_data.WAITING, 0.0)
    assert routine.commands[tcu_data.BRAKE] == workshop.STANDING_BRAKE_M_S2
    routine.memory[tcu_data.ROUTINE] = tcu_data.ENGAGING
    routine.run()
    assert routine.commands[tcu_data.BRAKE] == 0.0
