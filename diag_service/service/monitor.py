"""A live run for people: one screen that is drawn anew, with everything that a listener can know of its bus."""

import sys
import textwrap
from collections.abc import Iterable
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from canlog.e2e.e2e_state import E2eState
from canlog.live import BusState
from diag_service.delivery import News
from diag_service.delivery.console import order_lines, shift_head, shift_line, short_shift_head, short_shift_line
from diag_service.diagnosis.records import ShiftResult
from diag_service.diagnosis.summary import frames_line, shifts_line
from diag_service.service.snapshot import Snapshot

WHOLE_WIDTH = 140  # columns that everything takes, reasons included
TABLE_HEADS = 2  # over messages and shifts
FEW_SHIFTS = 2
SLOW_RATIO = 0.9  # a message below this share of its nominal rate is marked
_STATE_STYLE = {
    BusState.UP: "green",
    BusState.DEGRADED: "yellow",
    BusState.DOWN: "bold red",
    BusState.BUS_OFF: "bold red",
    BusState.RESTARTED: "yellow",
}
_E2E_STYLE = {E2eState.NO_DATA: "dim", E2eState.INIT: "yellow", E2eState.VALID: "green", E2eState.INVALID: "bold red"}


class Monitor:
    """Draws snapshots while it is entered; a stream that is no terminal gets the last one only."""

    def __init__(self, console: Console, hint: str = "") -> None:
        self._console = console
        self._hint = hint
        self._live = Live(console=console, auto_refresh=False, transient=False)

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def report(self, news: News) -> None:
        """Do nothing, as the reporter of the run: the next snapshot has it all."""

    def show(self, snapshot: Snapshot) -> None:
        """Draw the present state."""
        size = (self._console.width, self._console.height) if self._console.is_terminal else None
        self._live.update(screen(snapshot, size, self._hint), refresh=True)


def screen(snapshot: Snapshot, size: tuple[int, int] | None = None, hint: str = "") -> RenderableType:
    """Return everything as one picture, within the columns and lines of ``size``; None: as large as it is.

    Where lines are short, what each clutch says gives way first, then the shifts.
    """
    width, height = size or (WHOLE_WIDTH, sys.maxsize)
    head = _head(snapshot)
    below = [Text(frames_line(snapshot.summary.frames)), Text(shifts_line(snapshot.summary))]
    free = height - _folded_count([head, *below, Text(hint)], width) - len(snapshot.messages) - TABLE_HEADS
    sentences = order_lines(snapshot.summary.order)
    if free - _folded_count(sentences, width) < FEW_SHIFTS:
        sentences = sentences[:1]
    shown_count = min(max(0, free - _folded_count(sentences, width)), len(snapshot.recent))
    recent = snapshot.recent[len(snapshot.recent) - shown_count :]
    return Group(
        head,
        *sentences,
        _message_table(snapshot),
        *below,
        *_shift_lines(recent, is_short=width < WHOLE_WIDTH),
        *([Text(hint, "dim")] if hint else []),
    )


def _folded_count(texts: Iterable[Text], width: int) -> int:
    """Return how many lines the texts take within so many columns."""
    return sum(len(textwrap.wrap(text.plain, width)) for text in texts)


def _head(snapshot: Snapshot) -> Text:
    bus = snapshot.bus
    head = Text(f"{snapshot.summary.vehicle}  bus ")
    head.append(_words(bus.state.value), _STATE_STYLE[bus.state])
    head.append(f"  load {100.0 * snapshot.load_ratio:.1f} %  interrupted {bus.interruption_count} times")
    if bus.errors:
        errors = ", ".join(f"{count} {_words(error.value)}" for error, count in bus.errors.items())
        head.append(f"  error frames: {errors}", "yellow")
    if bus.last_problem is not None:
        head.append(f"  last problem: {bus.last_problem}", "dim")
    if snapshot.stuck is not None:
        head.append(f"  {snapshot.stuck}", "bold red")
    return head


def _message_table(snapshot: Snapshot) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("message", overflow="ellipsis")  # the one that gives way
    for name in ("1/s", "nominal", "E2E", "decoded", "rejected", "missing", "lapses"):
        table.add_column(name, justify="left" if name == "E2E" else "right", no_wrap=True)
    for name, counts in snapshot.messages.items():
        rate_hz, nominal_hz = snapshot.rates_hz[name], counts.nominal_hz
        is_slow = nominal_hz is not None and rate_hz < SLOW_RATIO * nominal_hz
        table.add_row(
            name,
            Text(f"{rate_hz:.1f}", "red" if is_slow else ""),
            "-" if nominal_hz is None else f"{nominal_hz:.1f}",
            Text(_words(counts.e2e_state.name.lower()), _E2E_STYLE[counts.e2e_state]),
            str(counts.decoded),
            str(sum(counts.rejected.values())),
            str(counts.missing),
            str(counts.invalidations),
        )
    return table


def _shift_lines(recent: tuple[ShiftResult, ...], *, is_short: bool) -> list[Text]:
    head, line = (short_shift_head, short_shift_line) if is_short else (shift_head, shift_line)
    return [head(), *(line(result) for result in reversed(recent))] if recent else []


def _words(name: str) -> str:
    return name.replace("_", " ")
