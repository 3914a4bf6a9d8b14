"""In whose time a program listens and looks beside its drive: in threads, or in the steps of a simulation."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final, Protocol

LISTEN_S: Final = 0.1  # how soon a thread notices that it is over
JOIN_S: Final = 5.0  # for a driver that does not return


class SendingPace(Protocol):
    """Has something done again and again; what it raises is raised where that ends, unless another error is."""

    @property
    def is_virtual(self) -> bool:
        """Whether time waits until what is due has been done."""

    def now_s(self) -> float:
        """Return a time [s] that never goes back."""

    def listening(self, listen: Callable[[float], bool], name: str) -> AbstractContextManager[None]:
        """Call ``listen`` while this is entered: it may wait for so long [s], and returns whether there may be more."""

    def looking(self, look: Callable[[], None], period_s: float, name: str) -> AbstractContextManager[None]:
        """Call ``look`` once in each period while this is entered."""


class WallPace:
    """The time of this machine."""

    is_virtual = False

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.now_s = clock

    def listening(self, listen: Callable[[float], bool], name: str) -> AbstractContextManager[None]:
        return self._in_thread(lambda _: listen(LISTEN_S), name)

    def looking(self, look: Callable[[], None], period_s: float, name: str) -> AbstractContextManager[None]:
        def turn(is_over: threading.Event) -> None:
            if not is_over.wait(period_s):
                look()

        return self._in_thread(turn, name)

    @contextmanager
    def _in_thread(self, turn: Callable[[threading.Event], object], name: str) -> Iterator[None]:
        is_over, failures = threading.Event(), list[BaseException]()

        def run() -> None:
            try:
                while not is_over.is_set():
                    turn(is_over)
            except BaseException as exc:  # noqa: BLE001 - carried to the caller's thread, which raises it
                failures.append(exc)

        thread = threading.Thread(target=run, name=name, daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join(JOIN_S)
        for failure in failures:
            raise failure


class StepClock(Protocol):
    """The virtual time of a simulation, which passes in steps."""

    def step_time_s(self) -> float:
        """Return the time [s] of the step."""

    def in_each_step(self, task: Callable[[], None]) -> AbstractContextManager[None]:
        """Have something done in each step while this is entered, before the step's frames leave."""


class StepPace:
    """The virtual time of a simulation: what is due in a step is done in it, whatever the machine is busy with."""

    is_virtual = True

    def __init__(self, clock: StepClock) -> None:
        self._clock = clock
        self.now_s = clock.step_time_s

    def listening(self, listen: Callable[[float], bool], name: str) -> AbstractContextManager[None]:  # noqa: ARG002
        def turn() -> None:
            while listen(0.0):
                pass

        return self._in_steps(turn)

    def looking(self, look: Callable[[], None], period_s: float, name: str) -> AbstractContextManager[None]:  # noqa: ARG002
        due_s = self.now_s() + period_s

        def turn() -> None:
            nonlocal due_s
            if self.now_s() >= due_s:
                due_s += period_s
                look()

        return self._in_steps(turn)

    @contextmanager
    def _in_steps(self, turn: Callable[[], None]) -> Iterator[None]:
        failures: list[BaseException] = []

        def task() -> None:
            if failures:
                return
            try:
                turn()
            except BaseException as exc:  # noqa: BLE001 - carried to the caller's thread, which raises it
                failures.append(exc)

        with self._clock.in_each_step(task):
            yield
        for failure in failures:
            raise failure


def pace_of(bus: object) -> SendingPace:
    """Return the pace of a bus whose time passes in steps, which then waits for us; else that of this machine."""
    clock = getattr(bus, "clock", None)
    return WallPace() if clock is None else StepPace(clock)
