"""Signals of the operating system, caught from the first moment on; imports next to nothing."""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import FrameType
from typing import Final

WRITER_ENDS_S: Final = 1.0


class Trigger:
    """Set from a signal handler or any thread; who subscribes late hears of it at once."""

    def __init__(self) -> None:
        self.is_set = False
        self.signal: int | None = None  # the first one that set it; None: none did
        self._listeners: list[Callable[[], None]] = []

    def set(self) -> None:
        """Set the trigger and tell those who subscribed, each time."""
        self.is_set = True
        for listener in tuple(self._listeners):
            listener()

    def rearm(self) -> None:
        """Begin afresh, where what set it ended one part of a run and not the run."""
        self.is_set, self.signal = False, None

    def subscribe(self, listener: Callable[[], None]) -> None:
        """Call ``listener`` from now on, and now if the trigger is set; more than once does no harm to it."""
        self._listeners.append(listener)
        if self.is_set:
            listener()

    def unsubscribe(self, listener: Callable[[], None]) -> None:
        self._listeners.remove(listener)

    def listen_to(self, *numbers: signal.Signals) -> None:
        """Let signals set the trigger instead of ending the process; main thread only."""

        def handle(number: int, _frame: FrameType | None) -> None:
            self.signal = self.signal or number
            self.set()

        for number in numbers:
            signal.signal(number, handle)


class PatientTrigger(Trigger):
    """A trigger that a signal sets only after a while: Ctrl-C ends the writer of a pipe, too, and then all has come.

    ``first`` is the trigger that signals set; for ``patience_s`` the writer has time to end the stream.
    """

    def __init__(
        self, first: Trigger, *, patience_s: float = WRITER_ENDS_S, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._is_set = False
        super().__init__()
        self._deadline_s: float | None = None
        self._patience_s = patience_s
        self._now_s = now_s
        first.subscribe(self._begin)

    @property
    def is_set(self) -> bool:
        """Whether it is set, or the time is over."""
        return self._is_set or (self._deadline_s is not None and self._now_s() >= self._deadline_s)

    @is_set.setter
    def is_set(self, value: bool) -> None:
        self._is_set = value

    def _begin(self) -> None:
        if self._deadline_s is None:  # one Ctrl-C may come twice: from the terminal, and from a wrapper
            self._deadline_s = self._now_s() + self._patience_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """What a command is controlled by: what the operating system's signals set, and how much it is to say."""

    stop: Trigger = field(default_factory=Trigger)
    counts_wanted: Trigger = field(default_factory=Trigger)
    verbosity: int = 0  # 1: more; 2: of libraries, too


def ignore(*numbers: signal.Signals) -> None:
    """Let signals pass without any effect; main thread only."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
