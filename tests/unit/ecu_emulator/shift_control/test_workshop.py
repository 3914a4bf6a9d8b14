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


def test_an_engine_that_does_not_get_fast_or_slow_ends_its_rev_all_the_same() -> None:
    routine = Routine(open_revs=1)
    routine.sense[tcu_data.ENGINE_SPEED] = 250.0
    routine.run(SETTLE_MS + 2010)
    assert (routine.memory[tcu_data.REV], routine.pedal_ratio) == (1.0, 0.0)
    routine.run(2000)
    assert routine.stage == tcu_data.ENGAGING


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
