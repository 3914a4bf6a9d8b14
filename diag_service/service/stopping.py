"""Signals of the operating system, caught from the first moment on; imports next to nothing."""

import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from types import FrameType


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

    def subscribe(self, listener: Callable[[], None]) -> None:
        """Call ``listener`` from now on, and now if the trigger is set; more than once does no harm to it."""
        self._listeners.append(listener)
        if self.is_set:
            listener()

    def unsubscribe(self, listener: Callable[[], None]) -> None:
        """Leave ``listener`` alone from now on."""
        self._listeners.remove(listener)

    def listen_to(self, *numbers: signal.Signals) -> None:
        """Let signals set the trigger instead of ending the process; main thread only."""

        def handle(number: int, _frame: FrameType | None) -> None:
            self.signal = self.signal or number
            self.set()

        for number in numbers:
            signal.signal(number, handle)


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """What the operating system's signals set."""

    stop: Trigger = field(default_factory=Trigger)
    counts_wanted: Trigger = field(default_factory=Trigger)


def ignore(*numbers: signal.Signals) -> None:
    """Let signals pass without any effect; main thread only."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
