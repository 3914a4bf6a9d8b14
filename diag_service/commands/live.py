"""``diag-service run``, ``monitor`` and ``config check``: a live bus is diagnosed or shown, or what a run would use."""

import asyncio
import logging
import sys
import textwrap
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
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
from diag_service.api.choices import diagnosis_config
from diag_service.commands.options import SETTINGS
from diag_service.delivery import News
from diag_service.delivery.console import order_lines, shift_head, shift_line, short_shift_head, short_shift_line
from diag_service.diagnosis.summary import frames_line, shifts_line
from diag_service.service import bus_run
from diag_service.service.session import Session
from diag_service.service.snapshot import Snapshot
from diag_service.service.stopping import Controls
from diag_service.settings.config import LiveOptions, bus_config, default_store
from diag_service.store import ResultStore
from fleet_contract.orders import name_of


def run(options: LiveOptions, controls: Controls) -> None:
    """Diagnose the bus until it is told to stop."""
    diagnosis = diagnosis_config(options)
    bus = bus_config(options)
    store = options.store or default_store(diagnosis.vehicle)
    bus_run.run_bus(diagnosis, bus, store, controls, as_json=options.json, is_detailed=controls.verbosity > 0)


def monitor(options: LiveOptions, controls: Controls) -> None:
    """Show the bus until it is told to stop; nothing is stored or published."""
    config, bus = diagnosis_config(options), bus_config(options)
    decoder = config.interpretation().decoder()
    with (
        closing(ResultStore.in_memory()) as store,
        Monitor(PeopleConsole(), config.calibration) as onlooker,
    ):
        session = Session(config, decoder, store, None, onlooker)
        asyncio.run(bus_run.serve_bus(replace(config, broker=None), bus, store, session, controls, onlooker.show))


WHOLE_WIDTH = 140  # columns that everything takes, reasons included
TABLE_HEADS = 2  # over messages and shifts
FEW_SHIFTS = 2
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
        self._live = Live(console=console, auto_refresh=False, transient=False)

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
        size = (self._console.width, self._console.height) if self._console.is_terminal else None
        sparks = [spark_line(name, list(left)) for name, left in sorted(self._left.items())]
        self._live.update(screen(snapshot, size, sparks), refresh=True)


def spark_line(name: str, left: Sequence[float]) -> Text:
    """Return how the friction margin of a clutch went: the top is new fluid, the bottom the limit of a change."""
    highest = len(SPARKS) - 1
    marks = "".join(" " if isnan(one) else SPARKS[round(min(max(one, 0.0), 1.0) * highest)] for one in left)
    style = "red" if left[-1] <= 0.0 else "yellow" if left[-1] < WATCH_MARGIN_RATIO else "green"
    now = "not known yet" if isnan(left[-1]) else f"{100.0 * left[-1]:.0f} % of new fluid"
    return Text.assemble(f"{name:<8} friction margin ", (marks, style), f" {now}")


def screen(snapshot: Snapshot, size: tuple[int, int] | None = None, sparks: Sequence[Text] = ()) -> RenderableType:
    """Return everything as one picture, within the columns and lines of ``size``; None: as large as it is.

    Where lines are short, what each clutch says gives way first, then the shifts.
    """
    width, height = size or (WHOLE_WIDTH, sys.maxsize)
    head = _head(snapshot)
    below = [Text(frames_line(snapshot.summary.frames)), Text(shifts_line(snapshot.summary))]
    free = height - _folded_count([head, *sparks, *below], width) - len(snapshot.messages) - TABLE_HEADS
    sentences = order_lines(snapshot.summary.order)
    if free - _folded_count(sentences, width) < FEW_SHIFTS:
        sentences = sentences[:1]
    shown_count = min(max(0, free - _folded_count(sentences, width)), len(snapshot.recent))
    recent = snapshot.recent[len(snapshot.recent) - shown_count :]
    is_short = width < WHOLE_WIDTH
    shift_heading, line = (short_shift_head, short_shift_line) if is_short else (shift_head, shift_line)
    return Group(
        head,
        *sentences,
        *sparks,
        _message_table(snapshot),
        *below,
        *([shift_heading(), *(line(result) for result in reversed(recent))] if recent else []),
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


def _words(name: str) -> str:
    return name.replace("_", " ")


_LOG = logging.getLogger(__name__)


def check(options: LiveOptions) -> None:
    """Check the settings and print what a run would use."""
    diagnosis = diagnosis_config(options)
    bus_config(options)
    diagnosis.interpretation()
    broker = diagnosis.broker
    if broker is not None and broker.exposure:
        _LOG.warning("%s", broker.exposure)
    sys.stdout.write(describe({**asdict(options), "vehicle": diagnosis.vehicle}))


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
