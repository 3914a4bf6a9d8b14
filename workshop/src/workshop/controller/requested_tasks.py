"""Routines that a tester starts (service 31): workshop routine, adaptation of the clutches, clearing of it."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from ecu_emulator.drive.recording import Drive
from ecu_emulator.errors import RecordError
from ecu_emulator.shift_control.touch_points import (
    PressureSteps,
    Result,
    Sample,
    Search,
    TouchPoint,
    are_over,
    finding_of,
    nominal_touch_pressures_pa,
    sample_of,
)
from workshop.controller.clutches import CLUTCHES, Adaptation
from workshop.controller.controller import Controller
from workshop.controller.descriptions import Task, Values, holds
from workshop.controller.monitoring import Monitoring
from workshop.controller.state import RoutineRun

FIRST_GEAR: Final = 1.0
MOST_MOMENTS: Final = 4096  # buffered moments of the drive


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """Shifts and gear, as sent on the bus."""

    shift_count: int = 0
    gear: float = 0.0  # the last one that was engaged


class RequestedRoutine:
    """Has the car perform the workshop routine, and ends the routine once the car has driven it.

    Parameters
    ----------
    performer
        The car.
    controller
        Whose routines these are.
    """

    def __init__(self, performer: Drive, controller: Controller) -> None:
        self._performer = performer
        self._controller = controller
        self._shifts_before: int | None = None  # None: nothing is performed

    @property
    def is_possible(self) -> bool:
        """Whether the car could begin now."""
        return self._performer.is_waiting

    def step(self, driven: Driven) -> None:
        """Start or end the routine, by what the car has driven; called about ten times a second."""
        running = running_routine(self._controller, Task.REVS)
        if running is None:
            self._shifts_before = None
            return
        number, run = running
        if self._shifts_before is None:
            self._performer.order(lambda plant: plant.begin_routine(*run.options[:2]))
            self._shifts_before = driven.shift_count
        if driven.shift_count > self._shifts_before and driven.gear == FIRST_GEAR:  # is back in it
            self._controller.finish(number)


def running_routine(controller: Controller, task: Task) -> tuple[int, RoutineRun] | None:
    """Return the number and run of the running routine with this task, None if there is none."""
    for number, run in controller.state.routines.items():
        if run.is_running and controller.table.routines[number].task is task:
            return number, run
    return None


@dataclass(slots=True)
class _Work:
    """An adaptation in progress."""

    search: Search
    steps: PressureSteps | None = None
    is_ordered: bool = False  # whether the car was ordered to hold these steps
    samples: list[Sample] = field(default_factory=list)
    ended: dict[int, tuple[Result, TouchPoint | None]] = field(default_factory=dict)


class RequestedAdaptation:
    """Has the car hold the pressure steps of a search, and the control use the touch points that it finds.

    Parameters
    ----------
    car
        Whose clutches are adapted.
    controller
        Whose routines these are, and who saves the touch points.
    """

    def __init__(self, car: Drive, controller: Controller) -> None:
        self._car = car
        self._controller = controller
        self._nominal_pa = nominal_touch_pressures_pa(car.transmission)
        self._work: _Work | None = None
        self._moments: deque[tuple[float, Mapping[str, float]]] = deque(maxlen=MOST_MOMENTS)
        self._results: dict[int, Result] = {}
        self.problem: str | None = None  # why something could not be saved, for people
        adaptation = controller.state.adaptation
        if adaptation is not None:
            car.believe(adaptation.pressures_pa(self._nominal_pa))

    @property
    def is_possible(self) -> bool:
        """Whether the car could begin now."""
        return self._car.is_waiting

    @property
    def needs_moments(self) -> bool:
        """Whether it needs every moment of the drive."""
        return self._work is not None

    @property
    def values(self) -> dict[str, float]:
        """Touch points, their deviations and results, as values of the controller by source."""
        adaptation = self._controller.state.adaptation
        pressures = zip(CLUTCHES, self._car.touch_pressures_pa, strict=True)
        return {
            **{f"clutch{clutch}_touch_pressure_pa": pressure_pa for clutch, pressure_pa in pressures},
            **{f"clutch{clutch}_adaptation": float(result) for clutch, result in self._results.items()},
            **({} if adaptation is None else adaptation.stds_pa),
        }

    def feed(self, t_s: float, values: Mapping[str, float]) -> None:
        """Buffer commanded and sensed values of a moment, a hundred times a second; safe for any thread."""
        self._moments.append((t_s, values))

    def step(self, values: Values) -> None:
        """Advance the adaptation; called about ten times a second.

        Parameters
        ----------
        values
            Present values of the controller.
        """
        running = running_routine(self._controller, Task.TOUCH_POINTS)
        if running is None:
            self._break_off()
            return
        number = running[0]
        if (nrc := self._violated_nrc(number, values)) is not None:
            self._break_off()
            self._controller.fail(number, nrc)
            return
        if self._work is None:
            self._results = {}
            self._work = self._begin(CLUTCHES[0], {})
        work = self._work
        if not work.is_ordered:
            self._order_steps(work)
            return
        self._collect_samples(work)
        if are_over(work.samples):
            self._conclude_steps(work, number)

    def clear(self) -> bool:
        """Return to the touch points of the type; return whether that could be saved."""
        return self._keep(Adaptation())

    def _break_off(self) -> None:
        if self._work is not None:
            self._car.order(lambda plant: plant.stop_steps())
            self._work = None

    def _violated_nrc(self, number: int, values: Values) -> int | None:
        """Return the response code of the first violated condition, None if all hold."""
        table = self._controller.table
        conditions = (table.conditions[name] for name in table.routines[number].held_conditions)
        return next((condition.nrc for condition in conditions if not holds(condition, values)), None)

    def _begin(self, clutch: int, ended: dict[int, tuple[Result, TouchPoint | None]]) -> _Work:
        most_pa = self._controller.table.clutches.most_touch_change_pa
        search = Search(clutch=clutch, nominal_pa=self._nominal_pa[clutch - 1], most_change_pa=most_pa)
        return _Work(search=search, steps=search.next_steps(), ended=ended)

    def _order_steps(self, work: _Work) -> None:
        """Have the car hold the next steps, once it waits again."""
        self._moments.clear()
        if (steps := work.steps) is not None and self._car.is_waiting:
            self._car.order(lambda plant: plant.begin_steps(steps))
            work.is_ordered = True

    def _collect_samples(self, work: _Work) -> None:
        """Take buffered samples from the first with an empty clutch on: earlier ones belong to other steps."""
        while self._moments:
            t_s, values = self._moments.popleft()
            sample = sample_of(values, t_s, work.search.clutch)
            if sample is not None and (work.samples or sample.command_pa == 0.0):
                work.samples.append(sample)

    def _conclude_steps(self, work: _Work, number: int) -> None:
        """Evaluate the steps; go on with the next steps, with the other clutch, or end."""
        if work.steps is None:
            return
        work.search = work.search.after(finding_of(work.samples, work.steps))
        work.steps, work.samples, work.is_ordered = work.search.next_steps(), [], False
        if work.steps is not None:
            return
        clutch = work.search.clutch
        work.ended[clutch] = work.search.ended()
        if clutch != CLUTCHES[-1]:
            self._work = self._begin(clutch + 1, work.ended)
            return
        self._work = None
        self._results = {clutch: result for clutch, (result, _) in work.ended.items()}
        touch_points = {clutch: point for clutch, (_, point) in work.ended.items() if point is not None}
        if touch_points and not self._keep(self._merged(touch_points)):
            self._controller.fail(number)
        else:
            self._controller.finish(number)

    def _merged(self, touch_points: Mapping[int, TouchPoint]) -> Adaptation:
        """Return the new adaptation; a clutch without a new touch point keeps its own."""
        before = self._controller.state.adaptation
        if before is None and self._car.is_adapted:
            as_built = zip(CLUTCHES, self._car.touch_pressures_pa, strict=True)
            before = Adaptation(
                touch_points={clutch: TouchPoint(pressure_pa=pa, std_pa=float("nan")) for clutch, pa in as_built}
            )
        before = before or Adaptation()
        return replace(before, touch_points={**before.touch_points, **touch_points})

    def _keep(self, adaptation: Adaptation) -> bool:
        try:
            self._controller.adapt(adaptation)
        except RecordError as exc:
            self.problem = self.problem or str(exc)
            return False
        self._car.believe(adaptation.pressures_pa(self._nominal_pa))
        return True


def clear_if_requested(controller: Controller, monitoring: Monitoring, adaptation: RequestedAdaptation) -> None:
    """Clear the touch points when a routine asks for it, as after a fluid change, and test the adaptation."""
    running = running_routine(controller, Task.NEW_FLUID)
    if running is None:
        return
    if adaptation.clear():
        monitoring.judge_adaptation()
        controller.finish(running[0])
    else:
        controller.fail(running[0])
