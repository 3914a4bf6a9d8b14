"""A live bus from its interface to everyone who hears of results, and to those who look on."""

import asyncio
import logging
import os
import socket
import sys
import textwrap
from collections.abc import Callable, Iterable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, ExitStack, closing, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from canlog.e2e.e2e_state import E2eState
from canlog.errors import NOTICE, ExtraMissingError
from canlog.live import BusOpener, BusState, ReadSchedule, SupervisedSource, supervise
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from clutchdiag_io.program import attached
from dbc.contract import load_contract
from diag_service.console import PeopleConsole, ending_key
from diag_service.delivery import DetachedReporter, News, Outbox
from diag_service.delivery.console import order_lines, shift_head, shift_line, short_shift_head, short_shift_line
from diag_service.diagnosis.summary import frames_line, shifts_line
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.application import opened_store, outbox_of, reporter_of
from diag_service.service.live import run_live
from diag_service.service.session import Session
from diag_service.service.snapshot import Board, Snapshot, SnapshotTaker
from diag_service.service.stages import Stages
from diag_service.service.stopping import Controls
from diag_service.settings.config import BusConfig, DiagnosisConfig
from diag_service.store import ResultStore

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
    is_short = width < WHOLE_WIDTH
    shift_heading, line = (short_shift_head, short_shift_line) if is_short else (shift_head, shift_line)
    return Group(
        head,
        *sentences,
        _message_table(snapshot),
        *below,
        *([shift_heading(), *(line(result) for result in reversed(recent))] if recent else []),
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


def _words(name: str) -> str:
    return name.replace("_", " ")


QUIT_KEY = "q"
_LOG = logging.getLogger(__name__)


def run_bus(
    config: DiagnosisConfig,
    bus: BusConfig,
    store_path: Path,
    controls: Controls,
    *,
    as_json: bool,
    is_detailed: bool = False,  # text for specialists
) -> None:
    """Diagnose a live bus until it is told to stop."""
    decoder = config.interpretation().decoder()
    with opened_store(config, store_path, keeps_results=True) as store:
        reporter = DetachedReporter(reporter_of(controls.stop, as_json=as_json, is_detailed=is_detailed))
        session = Session(config, decoder, store, None, reporter)
        asyncio.run(_run_bus(config, bus, store, session, controls))


def run_monitor(config: DiagnosisConfig, bus: BusConfig, controls: Controls) -> None:
    """Show a live bus until told to stop; nothing is stored or published."""
    decoder = config.interpretation().decoder()
    with (
        closing(ResultStore.in_memory()) as store,
        ending_key(QUIT_KEY, controls.stop.set) as has_keyboard,
        Monitor(PeopleConsole(), f"{QUIT_KEY} ends this" if has_keyboard else "") as monitor,
    ):
        session = Session(config, decoder, store, None, monitor)
        asyncio.run(_run_bus(replace(config, broker=None), bus, store, session, controls, monitor.show))


async def open_live(config: BusConfig, session: Session) -> tuple[SupervisedSource, ReadSchedule]:
    """Open a bus that is opened again whenever it was away; return it with the schedule that ``run_live`` is to fill.

    Raises SourceError if it cannot be opened now.
    """
    warm_up()
    filters = session.stages.decoder.kernel_filters if config.is_filtered else ()
    schedule = ReadSchedule()
    opener = BusOpener(
        config.interface, config.channel, config.bitrate, fd=config.is_fd, filters=filters, schedule=schedule
    )
    return await supervise(opener), schedule


async def _run_bus(
    config: DiagnosisConfig,
    bus: BusConfig,
    store: ResultStore,
    session: Session,
    controls: Controls,
    onlooker: Callable[[Snapshot], None] = lambda _: None,
) -> None:
    source, schedule = await open_live(bus, session)
    session.reporter.report(f"{source.description} for {config.vehicle}, results in {store.where}")
    now_s = asyncio.get_running_loop().time
    taker = SnapshotTaker(source, session, now_s(), bus.bitrate)
    manager, board = ServiceManager(os.environ.get(ADDRESS_VARIABLE)), Board()

    def show() -> None:
        snapshot = taker.snapshot(now_s())
        board.latest = snapshot
        onlooker(snapshot)
        if snapshot.stuck is None:
            manager.alive(f"bus {snapshot.bus.state.value}, {frames_line(snapshot.summary.frames)}")
        else:
            _LOG.error("%s", snapshot.stuck)
            manager.struggling(str(snapshot.stuck))

    with ExitStack() as stack:
        stack.callback(manager.stopping)
        if bus.metrics is not None:
            from diag_service.service.metrics import serving  # noqa: PLC0415 - a web server and its library, for few runs

            port = stack.enter_context(serving(bus.metrics, board))
            _LOG.log(NOTICE, "metrics on http://%s:%d/metrics", bus.metrics.host, port)
        manager.ready()
        outbox = outbox_of(config, store, session, is_live=True)
        async with AsyncExitStack() as asks:
            await asks.enter_async_context(polling(config.vehicle, bus, store, session, outbox))
            await run_live(
                source,
                session,
                stop=controls.stop,
                counts_wanted=controls.counts_wanted,
                outbox=outbox,
                duration_s=bus.duration_s,
                show=show,
                schedule=schedule,
                end_asking=asks.aclose,
            )


def polling(
    vehicle: str, bus: BusConfig, store: ResultStore, session: Session, outbox: Outbox | None
) -> AbstractAsyncContextManager[None]:
    """Return what asks controllers while it is entered, if that is wanted: for signals, or now and then for codes."""
    decoder = session.stages.decoder
    if (decoder.asked or decoder.groups) and bus.asks:
        if bus.poll is not None:
            raise ConfigError("--poll: this profile asks all the time already, and two testers disturb each other")
        asks: AbstractAsyncContextManager[None] = _asking("signals")(bus, decoder.asked, decoder.asking, decoder.groups)
        return asks
    if decoder.asked:
        _LOG.log(
            NOTICE, "%d signals have to be asked for, which --active allows; answers to others are read meanwhile",
            len(decoder.asked),
        )  # fmt: skip
    if bus.poll is None:
        return nullcontext()
    poll: AbstractAsyncContextManager[None] = _asking("codes")(vehicle, bus, bus.poll, store, session.reporter, outbox)
    return poll


def _asking(what: str) -> Any:  # noqa: ANN401 - of another distribution
    """Return what asks controllers for signals or codes; raises ExtraMissingError where no distribution has it."""
    try:
        return attached("diag_service.asking")[what]
    except KeyError as exc:
        raise ExtraMissingError("asking controllers: pip install './workshop[uds]' in the checkout") from exc


ADDRESS_VARIABLE = "NOTIFY_SOCKET"


class ServiceManager:
    """The manager that started this process; without one, everything is told to nobody.

    ``address`` is its datagram socket, as the environment names it; ``@`` begins an abstract one.
    """

    def __init__(self, address: str | None) -> None:
        self._address = address

    def ready(self) -> None:
        self._notify("READY=1")

    def alive(self, status: str) -> None:
        """Say that the service is at work, and how it is, in a few words."""
        self._notify(f"WATCHDOG=1\nSTATUS={status}")

    def struggling(self, status: str) -> None:
        """Say how the service is without saying that it is alive: a watchdog that hears only this restarts it."""
        self._notify(f"STATUS={status}")

    def stopping(self) -> None:
        self._notify("STOPPING=1")

    def _notify(self, text: str) -> None:
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as channel:
                channel.sendto(text.encode(), address)
        except OSError as exc:
            _LOG.debug("the service manager could not be told: %s", exc)


RECORDING: Final = Path(__file__).with_name("warm_up.log.xz")  # two seconds of the emulator, with one upshift


def warm_up() -> None:
    """Diagnose a recording of two seconds, and compile what it has no need of."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    decoder.sources.late.compile()
    stages = Stages(decoder, calibration)
    for batch in read_log(RECORDING):
        stages.feed(batch)
