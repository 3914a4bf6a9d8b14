"""A live bus from its interface to everyone who hears of results, and to those who look on."""

import asyncio
import logging
import os
import socket
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, ExitStack, aclosing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from canlog.errors import NOTICE, ExtraMissingError
from canlog.live import BusOpener, LiveSource, ReadSchedule, SupervisedSource, supervise
from canlog.logs import read_log
from canlog.time_order import compile_order
from clutch_model.calibration import nominal_calibration
from clutchdiag_io.program import attached
from dbc.contract import load_contract
from diag_service.delivery import Outbox
from diag_service.diagnosis.frame_counts import frames_line
from diag_service.diagnosis.summary import Summary
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.application import outbox_of
from diag_service.service.live import run_live
from diag_service.service.session import Session
from diag_service.service.snapshot import Board, Snapshot, SnapshotTaker
from diag_service.service.stages import Stages
from diag_service.settings.config import BusConfig, DiagnosisConfig
from diag_service.stopping import Controls
from diag_service.store import ResultStore

_LOG = logging.getLogger(__name__)


async def open_live(config: BusConfig, session: Session) -> tuple[SupervisedSource, ReadSchedule, BusConfig]:
    """Open a bus that is opened again whenever it was away; return it with the schedule that ``run_live`` is to fill.

    The configuration returned has no duration where the bus counts it, in its own time.

    Raises SourceError if it cannot be opened now.
    """
    warm_up()
    filters = session.stages.decoder.kernel_filters if config.is_filtered else ()
    schedule = ReadSchedule()
    opener = BusOpener(
        config.interface, config.channel, config.bitrate, fd=config.is_fd, filters=filters, schedule=schedule,
        duration_s=config.duration_s,
    )  # fmt: skip
    source = await supervise(opener, is_once=config.is_once)
    return source, schedule, replace(config, duration_s=None) if opener.counts_duration else config


async def serve_bus(
    config: DiagnosisConfig,
    bus: BusConfig,
    store: ResultStore,
    session: Session,
    controls: Controls,
    onlooker: Callable[[Snapshot], None] | None = None,
) -> None:
    """Diagnose a live bus into a session until it is told to stop; ``onlooker`` sees how it stands."""
    source, schedule, bus = await open_live(bus, session)
    session.reporter.report(f"{source.description} for {config.vehicle}, results in {store.where}")
    now_s = asyncio.get_running_loop().time
    taker = SnapshotTaker(source, session, now_s(), bus.bitrate)
    tell, board = partial(notify, os.environ.get("NOTIFY_SOCKET")), Board()

    def show() -> None:
        snapshot = taker.snapshot(now_s())
        board.latest = snapshot
        if onlooker is not None:
            onlooker(snapshot)
        if snapshot.stuck is None:
            tell(f"WATCHDOG=1\nSTATUS=bus {snapshot.bus.state.value}, {frames_line(snapshot.summary.frames)}")
        else:
            _LOG.error("%s", snapshot.stuck)
            tell(f"STATUS={snapshot.stuck}")  # no sign of life: the watchdog restarts the service

    with ExitStack() as stack:
        stack.callback(tell, "STOPPING=1")
        if bus.metrics is not None:
            from diag_service.service.metrics import serving  # noqa: PLC0415 - a web server and its library, for few runs

            port = stack.enter_context(serving(bus.metrics, board))
            _LOG.log(NOTICE, "metrics on http://%s:%d/metrics", bus.metrics.host, port)
        tell("READY=1")
        await diagnose_source(source, schedule, config, bus, store, session, controls, show)


async def diagnose_source(
    source: LiveSource,
    schedule: ReadSchedule,
    config: DiagnosisConfig,
    bus: BusConfig,
    store: ResultStore,
    session: Session,
    controls: Controls,
    show: Callable[[], None] = lambda: None,
) -> Summary:
    """Diagnose an open bus until it is told to stop: send results, ask controllers if wanted; return the numbers."""
    outbox = outbox_of(config, store, session, is_live=True)
    async with aclosing(source), AsyncExitStack() as asks:
        await asks.enter_async_context(polling(config.vehicle, bus, store, session, outbox))
        return await run_live(
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
    """Return a context that asks controllers for signals, or periodically for trouble codes, if that is configured."""
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
    """Return the context for signals or codes of the workshop distribution; raises ExtraMissingError without it."""
    try:
        return attached("diag_service.asking")[what]
    except KeyError as exc:
        raise ExtraMissingError("asking controllers: pip install './workshop[uds]' in the checkout") from exc


def notify(address: str | None, text: str) -> None:
    """Send a state to the service manager at its datagram socket (sd_notify).

    ``@`` begins an abstract address; None: no manager started this process.
    """
    if not address:
        return
    address = f"\0{address[1:]}" if address.startswith("@") else address
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as channel:
            channel.sendto(text.encode(), address)
    except OSError as exc:
        _LOG.debug("the service manager could not be told: %s", exc)


RECORDING: Final = Path(__file__).with_name("warm_up.log.xz")  # two seconds of the emulator, with one upshift


def warm_up() -> None:
    """Compile the kernels by diagnosing a recording of two seconds, and those that it does not use."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    decoder.sources.late.compile()
    compile_order()
    stages = Stages(decoder, calibration)
    for batch in read_log(RECORDING):
        stages.feed(batch)
