"""The workshop routine that a tester starts (service 31): the car performs it, then its estimate is waited for.

Open and closed revs, a start, once through the gears: what the estimate then says of both clutches is the result.
"""

from dataclasses import dataclass, replace
from typing import Final, Protocol

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.descriptions import Task
from ecu_emulator.diagnostics.opinion import Opinions
from ecu_emulator.diagnostics.state import RoutineRun
from ecu_emulator.scenario.scenario import Routine

ESTIMATE_S: Final = 10.0  # how long the estimate of the last shift is waited for
SAME_END_NS: Final = (
    500_000_000  # the end of a shift on the bus and in the estimate; the shift before ended 1.8 s sooner
)
FIRST_GEAR: Final = 1.0


class Performer(Protocol):
    """The car, as far as it can be asked to do something."""

    @property
    def is_waiting(self) -> bool:
        """Whether it waits for somebody to ask for the workshop routine."""

    def begin_routine(self, request: Routine) -> None:
        """Begin the routine soon."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """What the car has done on the bus."""

    shift_count: int = 0
    gear: float = 0.0  # the last one that was engaged
    last_shift_ns: int = 0  # end of the last shift, time of the bus


@dataclass(frozen=True, slots=True, kw_only=True)
class _Performance:
    """A routine that the car performs."""

    shifts_before: int
    over_s: float | None = None  # since when all of it is driven


class RequestedRoutine:
    """Has the car perform what a tester's routine asks for, and ends the routine once that is judged.

    Parameters
    ----------
    performer
        The car.
    controller
        Whose routines are looked after.
    """

    def __init__(self, performer: Performer, controller: Controller) -> None:
        self._performer = performer
        self._controller = controller
        self._performance: _Performance | None = None

    @property
    def is_possible(self) -> bool:
        """Whether the car could begin now."""
        return self._performer.is_waiting

    def step(self, driven: Driven, opinions: Opinions, t_s: float, *, is_live: bool) -> None:
        """Do what is due; to be called about ten times a second.

        Parameters
        ----------
        driven
            What the car has done on the bus.
        opinions
            What is thought of its clutches.
        t_s
            A time that never goes back [s].
        is_live
            Whether opinions follow what is driven.
        """
        found = running_routine(self._controller, Task.REVS)
        if found is None:
            self._performance = None
            return
        number, run = found
        if self._performance is None:
            self._performer.begin_routine(Routine(open_revs=run.options[0], closed_revs=run.options[1]))
            self._performance = _Performance(shifts_before=driven.shift_count)
        now = self._performance = _after(self._performance, driven, t_s)
        if now.over_s is not None and (not is_live or has_judged(opinions, driven) or t_s >= now.over_s + ESTIMATE_S):
            self._controller.finish(number)


def running_routine(controller: Controller, task: Task) -> tuple[int, RoutineRun] | None:
    """Return a routine that runs and is of this kind, with its number, if there is one."""
    for number, run in controller.state.routines.items():
        if run.is_running and controller.table.routines[number].task is task:
            return number, run
    return None


def _after(performance: _Performance, driven: Driven, t_s: float) -> _Performance:
    """Return how far the car is: it is through the gears once it is back in the first one."""
    is_through = driven.shift_count > performance.shifts_before and driven.gear == FIRST_GEAR
    return replace(performance, over_s=t_s) if is_through and performance.over_s is None else performance


def has_judged(opinions: Opinions, driven: Driven) -> bool:
    """Return whether opinions take the last shift into account."""
    latest_ns = max((opinion.end_ns for opinion in opinions.values()), default=0)
    return latest_ns >= driven.last_shift_ns - SAME_END_NS
