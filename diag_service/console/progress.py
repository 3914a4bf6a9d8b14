"""Which stage holds work and gets nothing done: a loop that still turns says nothing of a thread that hangs."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

STUCK_AFTER_S = 30.0  # a shift takes a fraction of a second, a slow disk a few


class Stage(StrEnum):
    """What is done with a shift beside the loop that reads the bus."""

    ESTIMATE = "estimate"
    STORE = "store"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stuck:
    """A stage that has been at one piece of work for too long."""

    stage: Stage
    for_s: float

    def __str__(self) -> str:
        return f"stuck in {self.stage} for {self.for_s:.0f} s"


class Progress:
    """Since when each stage has been at the work it has; asked and told from any thread."""

    def __init__(self, *, limit_s: float = STUCK_AFTER_S, now_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s = limit_s
        self._now_s = now_s
        self._lock = threading.Lock()
        self._since_s: dict[Stage, float] = {}

    @contextmanager
    def working(self, stage: Stage) -> Iterator[None]:
        """Be at one piece of work while this is entered."""
        with self._lock:
            self._since_s[stage] = self._now_s()
        try:
            yield
        finally:
            with self._lock:
                del self._since_s[stage]

    @property
    def stuck(self) -> Stuck | None:
        """The stage that has been at its work for longest, if that is too long."""
        with self._lock:
            longest = min(self._since_s.items(), key=lambda item: item[1], default=None)
        if longest is None or (for_s := self._now_s() - longest[1]) < self._limit_s:
            return None
        return Stuck(stage=longest[0], for_s=for_s)
