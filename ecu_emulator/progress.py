"""What the program says: progress and results for people on standard error, data on standard output."""

import json
import sys
from collections.abc import Mapping
from typing import Final, Self

from rich.console import Console
from rich.status import Status

from clutchdiag_io.program import legible

LOG_PERIOD_S: Final = 10.0


def people() -> Console:
    """Return the console for people: standard error, so that standard output stays free for data."""
    return Console(stderr=True, highlight=False, soft_wrap=True)


def print_json(content: Mapping[str, object]) -> None:
    """Print one JSON line on standard output."""
    texts = {name: legible(value) for name, value in content.items() if isinstance(value, str)}
    sys.stdout.write(json.dumps({**content, **texts}) + "\n")


def driven_text(driven_s: float, shifts: int, events: int) -> str:
    """Return in a few words how far a drive has come; the shift cycle has no events."""
    return f"{driven_s:.0f} s driven, {shifts} shifts{f', {events} events' if events else ''}"


class ProgressLine:
    """Shows the latest text on a terminal; elsewhere one line every ten seconds of the time it is told."""

    def __init__(self, console: Console, text: str) -> None:
        self._console = console
        self._status = Status(text, console=console) if console.is_terminal else None
        self._next_s = LOG_PERIOD_S

    def __enter__(self) -> Self:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def update(self, text: str, at_s: float) -> None:
        """Show the text that holds ``at_s`` seconds after the beginning."""
        if self._status is not None:
            self._status.update(text)
        elif at_s >= self._next_s:
            self._console.print(text, markup=False)
            self._next_s = (at_s // LOG_PERIOD_S + 1.0) * LOG_PERIOD_S
