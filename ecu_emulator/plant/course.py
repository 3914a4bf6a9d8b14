"""What the shift cycles and a trip on the road have in common: a machine, its clock, its energy account."""

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.errors import DomainError
from ecu_emulator.plant import state as at
from ecu_emulator.plant.audit import PowerBalance, power_balance
from ecu_emulator.plant.integration import workspace
from ecu_emulator.plant.loop import Machine
from ecu_emulator.plant.rates import PlantLaw

ROWS_PER_S = 1000


def blank_machine(
    cycles: FloatArray, *, memory_count: int, sense_count: int, command_count: int, is_audited: bool
) -> Machine:
    """Return a machine at time 0 whose numbers are all 0; controllers have the counts of places they need."""
    return Machine(
        y=np.zeros(at.STATE_COUNT),
        u=np.zeros(at.INPUT_COUNT),
        modes=np.zeros(at.MODE_COUNT, np.int64),
        work=workspace(is_audited=is_audited),
        memory=np.zeros(memory_count),
        sense=np.zeros(sense_count),
        commands=np.zeros(command_count),
        clock=np.zeros(1, np.int64),
        cycles=cycles,
    )


class Course:
    """A machine from its start on.

    Parameters
    ----------
    machine : Machine
        As it starts.
    plant : PlantLaw
        What it obeys.
    """

    def __init__(self, machine: Machine, plant: PlantLaw) -> None:
        self._machine = machine
        self._plant = plant
        self._start = machine.y.copy()

    @property
    def time_s(self) -> float:
        """Time of the next row since the start [s]."""
        return int(self._machine.clock[0]) / ROWS_PER_S

    @property
    def power_balance(self) -> PowerBalance:
        """Energies since the start.

        Raises
        ------
        DomainError
            If no account is kept.
        """
        if self._machine.work.account.size == 0:
            raise DomainError("there is a power balance only of what was audited from its start")
        return power_balance(self._machine.work.account, self._start, self._machine.y, self._plant)
