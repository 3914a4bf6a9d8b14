"""A live bus from its interface to everyone who hears of results, and to those who look on."""

import asyncio
import logging
import os
import socket
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from canlog.errors import NOTICE
from canlog.live import BusOpener, ReadSchedule, SupervisedSource, supervise
from clutchdiag_io.program import part
from diag_service.console import PeopleConsole, ending_key
from diag_service.delivery import DetachedReporter, Outbox
from diag_service.diagnosis.summary import frames_line
from diag_service.errors import ConfigError
from diag_service.service.application import opened_store, outbox_of, reporter_of
from diag_service.service.live import run_live
from diag_service.service.monitor import Monitor
from diag_service.service.onlookers import LastShifts, LiveRun, OpenPage
from diag_service.service.session import Session
from diag_service.service.snapshot import Board, Snapshot, SnapshotTaker
from diag_service.service.stopping import Controls
from diag_service.settings.config import BusConfig, DiagnosisConfig
from diag_service.store import ResultStore

QUIT_KEY = "q"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shown:
    """What a page shows of a run, and what opens one."""

    shifts: LastShifts
    open_page: OpenPage


def run_bus(
    config: DiagnosisConfig,
    bus: BusConfig,
    store_path: Path,
    controls: Controls,
    *,
    as_json: bool,
    is_detailed: bool = False,  # text for specialists
    open_page: OpenPage,
) -> None:
    """Diagnose a live bus until it is told to stop; a page that is wanted is opened meanwhile."""
    decoder = config.interpretation().decoder()
    with opened_store(config, store_path, keeps_results=True) as store:
        reporter = DetachedReporter(reporter_of(controls.stop, as_json=as_json, is_detailed=is_detailed))
        shifts = LastShifts()
        witness = (lambda *_: None) if bus.page is None else shifts.add
        session = Session(config, decoder, store, None, reporter, witness=witness)
        asyncio.run(_run_bus(config, bus, store, session, controls, shown=_Shown(shifts=shifts, open_page=open_page)))


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
    *,
    shown: _Shown | None = None,
) -> None:
    source, schedule = await open_live(bus, session)
    session.reporter.report(f"{source.description} for {config.vehicle}, results in {store.where}")
    now_s = asyncio.get_running_loop().time
    taker = SnapshotTaker(source, session, now_s(), bus.bitrate)
    manager, board = ServiceManager(os.environ.get(ADDRESS_VARIABLE)), Board()

    def show() -> None:
        snapshot = taker.take(now_s())
        board.latest = snapshot
        onlooker(snapshot)
        _report_life(manager, snapshot)

    with ExitStack() as stack:
        stack.callback(manager.stopping)
        if bus.metrics is not None:
            from diag_service.service.metrics import serving  # noqa: PLC0415 - a web server and its library, for few runs

            port = stack.enter_context(serving(bus.metrics, board))
            _LOG.log(NOTICE, "metrics on http://%s:%d/metrics", bus.metrics.host, port)
        if bus.page is not None and shown is not None:
            run = LiveRun(
                vehicle=config.vehicle,
                source=source.description,
                store=store.where,
                calibration=config.calibration,
                board=board,
                shifts=shown.shifts,
            )
            _LOG.log(NOTICE, "page on %s", stack.enter_context(shown.open_page(bus.page, run)))
        manager.ready()
        outbox = outbox_of(config, store, session, is_live=True)
        async with polling(config.vehicle, bus, store, session, outbox):
            await run_live(
                source,
                session,
                stop=controls.stop,
                counts_wanted=controls.counts_wanted,
                outbox=outbox,
                duration_s=bus.duration_s,
                show=show,
                schedule=schedule,
            )


def polling(
    vehicle: str, bus: BusConfig, store: ResultStore, session: Session, outbox: Outbox | None
) -> AbstractAsyncContextManager[None]:
    """Return what asks controllers while it is entered, if that is wanted: for signals, or now and then for codes."""
    decoder = session.stages.decoder
    if (decoder.asked or decoder.groups) and bus.asks:
        if bus.poll is not None:
            raise ConfigError("--poll: this profile asks all the time already, and two testers disturb each other")
        asks: AbstractAsyncContextManager[None] = part("diag_service.parts", "signals")(
            bus, decoder.asked, decoder.asking, decoder.groups
        )
        return asks
    if decoder.asked:
        _LOG.log(
            NOTICE, "%d signals have to be asked for, which --active allows; answers to others are read meanwhile",
            len(decoder.asked),
        )  # fmt: skip
    if bus.poll is None:
        return nullcontext()
    poll: AbstractAsyncContextManager[None] = part("diag_service.parts", "polling")(
        vehicle, bus, bus.poll, store, session.reporter, outbox
    )
    return poll


def _report_life(manager: "ServiceManager", snapshot: Snapshot) -> None:
    """Tell the manager that the service lives, unless one of its stages hangs."""
    if snapshot.stuck is None:
        manager.alive(f"bus {snapshot.bus.state.value}, {frames_line(snapshot.summary.frames)}")
        return
    _LOG.error("%s", snapshot.stuck)
    manager.struggling(str(snapshot.stuck))


ADDRESS_VARIABLE = "NOTIFY_SOCKET"


class ServiceManager:
    """The manager that started this process; without one, everything is told to nobody.

    ``address`` is its datagram socket, as the environment names it; ``@`` begins an abstract one.
    """

    def __init__(self, address: str | None) -> None:
        self._address = address

    def ready(self) -> None:
        """Say that the bus is open."""
        self._notify("READY=1")

    def alive(self, status: str) -> None:
        """Say that the service is at work, and how it is, in a few words."""
        self._notify(f"WATCHDOG=1\nSTATUS={status}")

    def struggling(self, status: str) -> None:
        """Say how the service is without saying that it is alive: a watchdog that hears only this restarts it."""
        self._notify(f"STATUS={status}")

    def stopping(self) -> None:
        """Say that the end has begun."""
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
