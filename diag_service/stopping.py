"""Signals of the operating system, caught from the first moment on; imports next to nothing."""

import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import Final

WRITER_ENDS_S: Final = 1.0


class Trigger:
    """A flag that signal handlers or any thread set; a listener that subscribes later is called at once."""

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
        """Reset the trigger after it ended one part of a run."""
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


def patient_trigger(first: Trigger, patience_s: float = WRITER_ENDS_S) -> Trigger:
    """Return a trigger that is set ``patience_s`` after ``first``.

    Ctrl-C ends the writer of a pipe, too; meanwhile its last frames come.
    """
    later = Trigger()
    timer = threading.Timer(patience_s, later.set)
    timer.daemon = True

    def begin() -> None:
        with suppress(RuntimeError):  # one Ctrl-C may come twice: from the terminal, and from a wrapper
            timer.start()

    first.subscribe(begin)
    return later


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
