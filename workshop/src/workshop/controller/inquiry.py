"""How a controller is asked by a link: in a thread, which may wait for the disk, or within a step of virtual time."""

import random
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, Self

from ecu_emulator.bus.pace import SendingPace, StepPace, WallPace, pace_of
from workshop.controller.controller import Controller
from workshop.controller.state import Reply
from workshop.controller.table import Timing


class Asked(Protocol):
    """A request that a controller has been given."""

    def done(self) -> bool:
        """Return whether its reply is due."""

    def result(self) -> Reply:
        """Return the reply that is due."""


class Inquiry(AbstractContextManager["Inquiry"], Protocol):
    """Asks controllers while it is entered."""

    @property
    def pace(self) -> SendingPace:
        """In whose time."""

    def ask(self, controller: Controller, payload: bytes, is_functional: bool, wake: Callable[[], None]) -> Asked:  # noqa: FBT001 - of one caller
        """Pass a request on; ``wake`` is called when the reply is due, unless somebody looks in each step."""

    def work(self, timing: Timing) -> Callable[[], None]:
        """Return what a controller does before and after it reads the values: it takes half of its time to answer."""


class ThreadInquiry:
    """Asks in threads, one for each link that asks: a reply takes as long as it takes."""

    def __init__(self, pace: SendingPace | None = None) -> None:
        self.pace: SendingPace = WallPace() if pace is None else pace
        self._pool = ThreadPoolExecutor(thread_name_prefix="diagnostics asks")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def ask(self, controller: Controller, payload: bytes, is_functional: bool, wake: Callable[[], None]) -> Asked:  # noqa: FBT001
        asked = self._pool.submit(controller.reply_to, payload, is_functional=is_functional)
        asked.add_done_callback(lambda _: wake())
        return asked

    def work(self, timing: Timing) -> Callable[[], None]:
        times = random.Random()  # noqa: S311 - no secret: how long an answer takes
        return lambda: time.sleep(times.uniform(timing.least_answer_s, timing.most_answer_s) / 2.0)


@dataclass(frozen=True, slots=True)
class DueReply:
    """A reply that is due at a virtual time."""

    reply: Reply
    due_s: float
    now_s: Callable[[], float]

    def done(self) -> bool:
        return self.now_s() >= self.due_s

    def result(self) -> Reply:
        return self.reply


class StepInquiry:
    """Asks within a step: time waits for the controller, whose reply is due after its time to answer."""

    def __init__(self, pace: StepPace, seed: int = 0) -> None:
        self.pace: SendingPace = pace
        self._times = random.Random(seed)  # noqa: S311 - the same in each run

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def ask(self, controller: Controller, payload: bytes, is_functional: bool, wake: Callable[[], None]) -> Asked:  # noqa: ARG002, FBT001
        timing, now_s = controller.table.timing, self.pace.now_s
        reply = controller.reply_to(payload, is_functional=is_functional)
        return DueReply(reply, now_s() + self._times.uniform(timing.least_answer_s, timing.most_answer_s), now_s)

    def work(self, timing: Timing) -> Callable[[], None]:  # noqa: ARG002
        return lambda: None


def inquiry_of(bus: object) -> Inquiry:
    """Return how controllers on a bus are asked: in its virtual time if it has one, else in that of this machine."""
    pace = pace_of(bus)
    return StepInquiry(pace) if isinstance(pace, StepPace) else ThreadInquiry(pace)
