"""Work beside a drive: in threads, or in the steps of a simulation, where it is done when it is due."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from ecu_emulator.bus.pace import SendingPace, StepPace, WallPace, pace_of
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.live import check_step
from tests.support.patience import HANG_S


class Steps:
    """A simulation whose steps a test takes."""

    def __init__(self) -> None:
        self.tasks: list[Callable[[], None]] = []
        self.t_s = 0.0

    def step_time_s(self) -> float:
        return self.t_s

    @contextmanager
    def in_each_step(self, task: Callable[[], None]) -> Iterator[None]:
        self.tasks.append(task)
        yield
        self.tasks.remove(task)

    def step(self, t_s: float) -> None:
        self.t_s = t_s
        for task in self.tasks:
            task()


def test_in_steps_all_that_waits_is_heard_and_what_is_due_is_done_once_a_period() -> None:
    steps, waiting, looked_s = Steps(), [1, 2, 3], list[float]()
    pace = StepPace(steps)

    def listen(timeout_s: float) -> bool:
        assert timeout_s == 0.0
        return bool(waiting and waiting.pop())

    with pace.listening(listen, "ears"), pace.looking(lambda: looked_s.append(pace.now_s()), 0.125, "eyes"):
        for ms in range(0, 1001, 8):
            steps.step(ms / 1024)
            assert not waiting
    assert looked_s == [0.125 * count for count in range(1, 8)]
    assert not steps.tasks


def test_in_threads_it_is_done_until_the_end() -> None:
    pace, heard, seen = WallPace(), threading.Event(), threading.Event()

    def listen(_timeout_s: float) -> bool:
        heard.set()
        return False

    with pace.listening(listen, "ears"), pace.looking(seen.set, 0.001, "eyes"):
        assert heard.wait(HANG_S)
        assert seen.wait(HANG_S)
    assert not {"ears", "eyes"} & {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize("is_virtual", [False, True])
def test_what_goes_wrong_is_raised_at_the_end_unless_something_else_is(*, is_virtual: bool) -> None:
    steps, tried = Steps(), threading.Event()
    pace: SendingPace = StepPace(steps) if is_virtual else WallPace()

    def fail(_timeout_s: float = 0.0) -> bool:
        tried.set()
        raise ValueError("deaf")

    def play(error: BaseException | None = None) -> None:
        steps.step(1.0)
        assert tried.wait(HANG_S)
        if error is not None:
            raise error

    with pytest.raises(ValueError, match="deaf"), pace.listening(fail, "ears"):
        play()
    with pytest.raises(KeyError), pace.listening(fail, "ears"):
        play(KeyError())


def test_a_bus_without_a_time_of_its_own_has_that_of_the_machine() -> None:
    class Bus:
        clock = Steps()

    assert isinstance(pace_of(Bus()), StepPace)
    assert isinstance(pace_of(object()), WallPace)


def test_a_step_of_half_of_the_shortest_cycle_is_the_longest() -> None:
    check_step(0.0, [10, 20, 0])
    check_step(0.005, [10, 20, 0])
    with pytest.raises(EmulatorConfigError, match=r"a step of 0\.01 s is too long: .* at most 0\.005 s"):
        check_step(0.01, [10, 20, 0])
