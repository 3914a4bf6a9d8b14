"""What the program says: progress and results for people on standard error, data on standard output."""

import json
import sys
from collections.abc import Mapping

from rich.console import Console

from clutchdiag_io.program import legible


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
