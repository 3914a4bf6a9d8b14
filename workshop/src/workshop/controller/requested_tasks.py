"""What a tester starts (service 31): the workshop routine, adapting the clutches, clearing what was learned."""

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
MOST_MOMENTS: Final = 4096  # that are heard and not looked at yet


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """What the car has done on the bus."""

    shift_count: int = 0
    gear: float = 0.0  # the last one that was engaged


class RequestedRoutine:
    """Has the car perform what a tester's routine asks for, and ends the routine once that is driven.

    Parameters
    ----------
    performer
        The car.
    controller
        Whose routines are looked after.
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
        """Do what is due after what the car has done on the bus; to be called about ten times a second."""
        found = running_routine(self._controller, Task.REVS)
        if found is None:
            self._shifts_before = None
            return
        number, run = found
        if self._shifts_before is None:
            self._performer.order(lambda plant: plant.begin_routine(*run.options[:2]))
            self._shifts_before = driven.shift_count
        if driven.shift_count > self._shifts_before and driven.gear == FIRST_GEAR:  # is back in it
            self._controller.finish(number)


def running_routine(controller: Controller, task: Task) -> tuple[int, RoutineRun] | None:
    """Return a routine that runs and is of this kind, with its number, if there is one."""
    for number, run in controller.state.routines.items():
        if run.is_running and controller.table.routines[number].task is task:
            return number, run
    return None


@dataclass(slots=True)
class _Work:
    """An adaptation that is under way."""

    search: Search
    steps: PressureSteps | None = None
    is_asked: bool = False  # the car was, for these steps
    samples: list[Sample] = field(default_factory=list)
    ended: dict[int, tuple[Result, TouchPoint | None]] = field(default_factory=dict)


class RequestedAdaptation:
    """Has the car hold the steps that a search asks for, and the control work with what it finds.

    Parameters
    ----------
    car
        Whose clutches are adapted.
    controller
        Whose routines are looked after, and who keeps what is found.
    """

    def __init__(self, car: Drive, controller: Controller) -> None:
        self._car = car
        self._controller = controller
        self._nominal_pa = nominal_touch_pressures_pa(car.transmission)
        self._work: _Work | None = None
        self._heard: deque[tuple[float, Mapping[str, float]]] = deque(maxlen=MOST_MOMENTS)
        self._results: dict[int, Result] = {}
        self.problem: str | None = None  # why something could not be kept, for people
        adaptation = controller.state.adaptation
        if adaptation is not None:
            car.believe(adaptation.pressures_pa(self._nominal_pa))

    @property
    def is_possible(self) -> bool:
        """Whether the car could begin now."""
        return self._car.is_waiting

    @property
    def is_listening(self) -> bool:
        """Whether it wants to hear every moment."""
        return self._work is not None

    @property
    def values(self) -> dict[str, float]:
        """What is known, as values of the controller by source."""
        adaptation = self._controller.state.adaptation
        pressures = zip(CLUTCHES, self._car.touch_pressures_pa, strict=True)
        return {
            **{f"clutch{clutch}_touch_pressure_pa": pressure_pa for clutch, pressure_pa in pressures},
            **{f"clutch{clutch}_adaptation": float(result) for clutch, result in self._results.items()},
            **({} if adaptation is None else adaptation.stds_pa),
        }

    def hear(self, t_s: float, values: Mapping[str, float]) -> None:
        """Take what is commanded and sensed at a moment of the drive, a hundred times a second; any thread may call."""
        self._heard.append((t_s, values))

    def step(self, values: Values) -> None:
        """Do what is due; to be called about ten times a second.

        Parameters
        ----------
        values
            What the controller knows now.
        """
        found = running_routine(self._controller, Task.TOUCH_POINTS)
        if found is None:
            self._break_off()
            return
        number = found[0]
        if (nrc := self._unkept(number, values)) is not None:
            self._break_off()
            self._controller.fail(number, nrc)
            return
        if self._work is None:
            self._results = {}
            self._work = self._begun(CLUTCHES[0], {})
        work = self._work
        if not work.is_asked:
            self._ask(work)
            return
        self._listen(work)
        if are_over(work.samples):
            self._go_on(work, number)

    def forget(self) -> bool:
        """Work by the touch points of the type again; return whether that could be kept."""
        return self._keep(Adaptation())

    def _break_off(self) -> None:
        if self._work is not None:
            self._car.order(lambda plant: plant.stop_steps())
            self._work = None

    def _unkept(self, number: int, values: Values) -> int | None:
        """Return the response of the first condition that does not hold any more."""
        table = self._controller.table
        conditions = (table.conditions[name] for name in table.routines[number].held_conditions)
        return next((condition.nrc for condition in conditions if not holds(condition, values)), None)

    def _begun(self, clutch: int, ended: dict[int, tuple[Result, TouchPoint | None]]) -> _Work:
        most_pa = self._controller.table.clutches.most_touch_change_pa
        search = Search(clutch=clutch, nominal_pa=self._nominal_pa[clutch - 1], most_change_pa=most_pa)
        return _Work(search=search, steps=search.next_steps(), ended=ended)

    def _ask(self, work: _Work) -> None:
        """Have the car hold the next steps, once it has let go of what it held before."""
        self._heard.clear()
        if (steps := work.steps) is not None and self._car.is_waiting:
            self._car.order(lambda plant: plant.begin_steps(steps))
            work.is_asked = True

    def _listen(self, work: _Work) -> None:
        """Take what was heard, from where the clutch is empty: what is still on its way belongs to other steps."""
        while self._heard:
            t_s, values = self._heard.popleft()
            sample = sample_of(values, t_s, work.search.clutch)
            if sample is not None and (work.samples or sample.command_pa == 0.0):
                work.samples.append(sample)

    def _go_on(self, work: _Work, number: int) -> None:
        """Take what steps have shown; go on with others, with the other clutch, or end."""
        if work.steps is None:
            return
        work.search = work.search.after(finding_of(work.samples, work.steps))
        work.steps, work.samples, work.is_asked = work.search.next_steps(), [], False
        if work.steps is not None:
            return
        clutch = work.search.clutch
        work.ended[clutch] = work.search.ended()
        if clutch != CLUTCHES[-1]:
            self._work = self._begun(clutch + 1, work.ended)
            return
        self._work = None
        self._results = {clutch: result for clutch, (result, _) in work.ended.items()}
        found = {clutch: point for clutch, (_, point) in work.ended.items() if point is not None}
        if found and not self._keep(self._with(found)):
            self._controller.fail(number)
        else:
            self._controller.finish(number)

    def _with(self, found: Mapping[int, TouchPoint]) -> Adaptation:
        """Return what is adapted now; a clutch of which nothing was found stays as it is."""
        before = self._controller.state.adaptation
        if before is None and self._car.is_adapted:
            as_built = zip(CLUTCHES, self._car.touch_pressures_pa, strict=True)
            before = Adaptation(
                touch_points={clutch: TouchPoint(pressure_pa=pa, std_pa=float("nan")) for clutch, pa in as_built}
            )
        before = before or Adaptation()
        return replace(before, touch_points={**before.touch_points, **found})

    def _keep(self, adaptation: Adaptation) -> bool:
        try:
            self._controller.adapt(adaptation)
        except RecordError as exc:
            self.problem = self.problem or str(exc)
            return False
        self._car.believe(adaptation.pressures_pa(self._nominal_pa))
        return True


def clear_if_requested(controller: Controller, monitoring: Monitoring, adaptation: RequestedAdaptation) -> None:
    """Clear the touch points when a routine asks for it, as after a change of the fluid, and test what is left."""
    found = running_routine(controller, Task.NEW_FLUID)
    if found is None:
        return
    if adaptation.forget():
        monitoring.judge_adaptation()
        controller.finish(found[0])
    else:
        controller.fail(found[0])
