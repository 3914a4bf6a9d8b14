"""``diag-service run``, ``monitor`` and ``config check``: a live bus is diagnosed or shown, or what a run would use."""

import logging
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isnan
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import tomli_w
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from canlog.e2e.e2e_state import E2eState
from canlog.live import BusState
from clutch_model.calibration import Calibration
from clutch_results.curves import WATCH_MARGIN_RATIO, margin_left
from clutch_results.records import ShiftResult
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.program import legible
from diag_service.api import live
from diag_service.commands.options import SETTINGS
from diag_service.delivery import DetachedReporter, News, standard_output_reporter
from diag_service.delivery.console import order_lines, shift_head, shift_line
from diag_service.diagnosis.frame_counts import frames_line
from diag_service.diagnosis.summary import shifts_line
from diag_service.service.snapshot import Snapshot
from diag_service.settings.options import LiveOptions, diagnosis_config
from diag_service.stopping import Controls
from fleet_contract.orders import name_of


def run(options: LiveOptions, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    reporter = standard_output_reporter(controls.stop, as_json=options.json, is_detailed=controls.verbosity > 0)
    live.run(options, controls, DetachedReporter(reporter))


def monitor(options: LiveOptions, controls: Controls) -> None:
    """Show the bus until it is told to stop; nothing is stored or published."""
    with Monitor(PeopleConsole(), diagnosis_config(options).calibration) as screen:
        live.run(options, controls, screen, screen.show)


WHOLE_WIDTH = 140  # columns that everything takes, reasons included
SPARKS = "▁▂▃▄▅▆▇█"  # from no friction margin to that of new fluid
SPARK_COUNT = 40  # events of a clutch that are remembered
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
    """Draws snapshots while it is entered; a stream that is no terminal gets the last one only.

    It remembers what each clutch had left of its friction margin after each of its last events.
    """

    def __init__(self, console: Console, calibration: Calibration) -> None:
        self._console = console
        self._calibration = calibration
        self._left: dict[str, deque[float]] = {}
        self._live = Live(console=console, auto_refresh=False, vertical_overflow="crop")

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def report(self, news: News) -> None:
        """Remember the margin of a clutch, as the reporter of the run; the next snapshot has all else."""
        if isinstance(news, ShiftResult):
            verdict = news.verdict
            left, _ = margin_left(verdict, self._calibration.clutches[verdict.clutch - 1].friction)
            name = name_of(verdict.clutch, verdict.element)
            self._left.setdefault(name, deque(maxlen=SPARK_COUNT)).append(left)

    def show(self, snapshot: Snapshot) -> None:
        sparks = [spark_line(name, list(left)) for name, left in sorted(self._left.items())]
        is_detailed = not self._console.is_terminal or self._console.width >= WHOLE_WIDTH
        self._live.update(screen(snapshot, sparks, is_detailed=is_detailed), refresh=True)


def spark_line(name: str, left: Sequence[float]) -> Text:
    """Return how the friction margin of a clutch went: the top is new fluid, the bottom the limit of a change."""
    highest = len(SPARKS) - 1
    marks = "".join(" " if isnan(share) else SPARKS[round(min(max(share, 0.0), 1.0) * highest)] for share in left)
    style = "red" if left[-1] <= 0.0 else "yellow" if left[-1] < WATCH_MARGIN_RATIO else "green"
    now = "not known yet" if isnan(left[-1]) else f"{100.0 * left[-1]:.0f} % of new fluid"
    return Text.assemble(f"{name:<8} friction margin ", (marks, style), f" {now}")


def screen(snapshot: Snapshot, sparks: Sequence[Text], *, is_detailed: bool) -> RenderableType:
    """Return everything as one picture, the newest shift first; lines of shifts are cropped at the right."""
    recent = [shift_line(result, is_detailed=is_detailed) for result in reversed(snapshot.recent)]
    lines = [shift_head(is_detailed=is_detailed), *recent] if recent else []
    for line in lines:
        line.no_wrap, line.overflow = True, "ellipsis"
    return Group(
        _head(snapshot),
        *order_lines(snapshot.summary.order),
        *sparks,
        _message_table(snapshot),
        Text(frames_line(snapshot.summary.frames)),
        Text(shifts_line(snapshot.summary)),
        *lines,
    )


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


def _words(name: str) -> str:
    return name.replace("_", " ")


_LOG = logging.getLogger(__name__)


def check(options: LiveOptions) -> None:
    """Check the settings and print what a run would use."""
    config = live.checked(options)
    if config.broker is not None and config.broker.exposure:
        _LOG.warning("%s", config.broker.exposure)
    sys.stdout.write(describe({**asdict(options), "vehicle": config.vehicle}))


def describe(values: Mapping[str, Any]) -> str:
    """Return values of settings as the text of a settings file, with what is secret masked."""
    return "".join(_line(name, values[name]) for name in SETTINGS)


def _line(name: str, value: str | float | Path | None) -> str:
    if value is None:
        return f"# {name} is not set\n"
    if isinstance(value, str | Path):
        text = str(value)
        if name == "broker" and (password := urlsplit(text).password) is not None:
            text = text.replace(f":{password}@", ":***@")
        value = legible(text)
    return tomli_w.dumps({name: value})
