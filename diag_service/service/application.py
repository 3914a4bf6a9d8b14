"""Wiring: a checked configuration becomes stages, a store, a reporter and an outbox, and runs."""

import asyncio
import logging
import os
import sys
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, ExitStack, closing, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from rich.console import Console

from canlog.live import BusOpener, ReadSchedule, SupervisedSource, supervise
from canlog.notice import NOTICE
from diag_service.console.terminal import PeopleConsole
from diag_service.delivery import (
    Acknowledge,
    ConsoleReporter,
    DetachedReporter,
    JsonLinesReporter,
    Link,
    MqttConnector,
    Outbox,
    PipeReporter,
    Reporter,
)
from diag_service.delivery.outbox import MetricsMessage
from diag_service.diagnosis.results import ServiceStatus
from diag_service.diagnosis.summary import Summary, frames_line
from diag_service.service.controller_news import tell_controller
from diag_service.service.drive import open_drive, stream_of
from diag_service.service.live import run_live
from diag_service.service.monitor import Monitor
from diag_service.service.recorded import run_logs, run_logs_and_send
from diag_service.service.service_manager import ADDRESS_VARIABLE, ServiceManager
from diag_service.service.session import Session, utc_now, versions_for
from diag_service.service.snapshot import Board, Snapshot, SnapshotTaker
from diag_service.service.stopping import Controls, Trigger
from diag_service.service.tasks import run_to_end
from diag_service.settings.config import BusConfig, DiagnosisConfig, PollConfig
from diag_service.store import ResultStore
from fleet_contract import Outgoing, config_message, metrics_message
from program_io.legible import legible
from program_io.standard_output import discard

_LOG = logging.getLogger(__name__)


def run_bus(config: DiagnosisConfig, bus: BusConfig, store_path: Path, controls: Controls, *, as_json: bool) -> None:
    """Diagnose a live bus until it is told to stop."""
    decoder = config.interpretation().decoder()
    with closing(ResultStore.open(store_path, config.budget_bytes)) as store:
        reporter = DetachedReporter(reporter_of(controls.stop, as_json=as_json))
        session = Session(config, decoder, store, None, reporter)
        asyncio.run(_run_bus(config, bus, store, session, controls))


def run_monitor(config: DiagnosisConfig, bus: BusConfig, controls: Controls) -> None:
    """Show a live bus until told to stop; nothing is stored or published."""
    decoder = config.interpretation().decoder()
    with closing(ResultStore.in_memory()) as store, Monitor(PeopleConsole()) as monitor:
        session = Session(config, decoder, store, None, monitor)
        asyncio.run(_run_bus(replace(config, broker=None), bus, store, session, controls, monitor.show))


def run_recorded(
    config: DiagnosisConfig, paths: Sequence[Path], store_path: Path | None, reporter: Reporter, stop: Trigger
) -> Summary:
    """Diagnose the logs of a drive; the summary says whether it was all of it."""
    meaning = config.interpretation()
    decoder = meaning.decoder()
    logs = open_drive(paths, is_strict=config.is_strict)
    stream = stream_of([*(log.path for log in logs), *meaning.files])
    with closing(
        ResultStore.in_memory() if store_path is None else ResultStore.open(store_path, config.budget_bytes)
    ) as store:
        session = Session(config, decoder, store, stream, reporter)
        outbox = outbox_of(config, store, session, is_live=False)
        if outbox is None:
            return run_logs(logs, session, stop=stop)
        summary = run_to_end(run_logs_and_send(logs, session, stop=stop, outbox=outbox))
        if summary.unpublished_count and store_path is None:
            _LOG.warning("%d results were not delivered and are not kept; --store would", summary.unpublished_count)
        return summary


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
        manager.ready()
        outbox = outbox_of(config, store, session, is_live=True)
        if bus.poll is not None:
            stack.enter_context(_poller(config.vehicle, bus, bus.poll, store, session, outbox))
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


def _poller(
    vehicle: str, bus: BusConfig, poll: PollConfig, store: ResultStore, session: Session, outbox: Outbox | None
) -> AbstractContextManager[object]:
    """Return what asks a controller now and then while it is entered; to be called in the loop that runs the outbox."""
    from diag_service.service.polling import poller_for  # noqa: PLC0415 - libraries of an extra, for few runs

    loop = asyncio.get_running_loop()

    def publish(message: Outgoing) -> None:
        if outbox is not None:
            with suppress(RuntimeError):  # the run has ended meanwhile
                loop.call_soon_threadsafe(outbox.tell_state, message)

    return poller_for(
        vehicle, bus, poll, utc_now, lambda report: tell_controller(report, store, session.reporter, publish)
    )


def _report_life(manager: ServiceManager, snapshot: Snapshot) -> None:
    """Tell the manager that the service lives, unless one of its stages hangs."""
    if snapshot.stuck is None:
        manager.alive(f"bus {snapshot.bus.state.value}, {frames_line(snapshot.summary.frames)}")
        return
    _LOG.error("%s", snapshot.stuck)
    manager.struggling(str(snapshot.stuck))


def reporter_of(stop: Trigger, *, as_json: bool) -> Reporter:
    """Return who shows a run on standard output; a reader who hangs up sets ``stop``."""

    def hang_up() -> None:
        discard()
        stop.set()

    if as_json:
        return PipeReporter(JsonLinesReporter(sys.stdout, Console(stderr=True)), hang_up)
    return PipeReporter(ConsoleReporter(PeopleConsole()), hang_up)


def outbox_of(config: DiagnosisConfig, store: ResultStore, session: Session, *, is_live: bool) -> Outbox | None:
    """Return what sends the results of a session to the configured broker; None without one."""
    if config.broker is None:
        return None
    if danger := config.broker.exposure:
        _LOG.warning("%s", danger)
    versions = versions_for(config.calibration)
    status = ServiceStatus(
        vehicle=config.vehicle,
        is_online=True,
        connected_at=utc_now(),
        service_version=version("clutchdiag"),
        algorithm_version=versions.algorithm,
        calibration_version=versions.calibration,
    )
    identifier = f"clutchdiag-{config.vehicle}" if is_live else f"clutchdiag-{uuid.uuid4()}"
    connector = MqttConnector(
        config.broker,
        identifier,
        status if is_live else None,
        is_persistent=is_live and config.acknowledge is Acknowledge.BACKEND,
    )
    return Outbox(
        store,
        config.vehicle,
        _connect_now(connector),
        str(config.broker),
        acknowledge=config.acknowledge,
        greetings=[_greeting(config, status)] if is_live else (),
        holds_states=not is_live,
        metrics=_metrics_of(store, session) if is_live else None,
    )


def _greeting(config: DiagnosisConfig, status: ServiceStatus) -> Outgoing:
    """Return what a live service says of itself at birth; nothing secret is among it."""
    settings: dict[str, str | float | bool | None] = {
        "service_version": status.service_version,
        "algorithm_version": status.algorithm_version,
        "calibration_version": status.calibration_version,
        "broker": str(config.broker),
        "broker_is_encrypted": config.broker is not None and config.broker.tls is not None,
        "acknowledge": config.acknowledge.value,
        "store_budget_bytes": config.budget_bytes,
        "dbc": legible(str(config.dbc or "shipped")),
        "profile": legible(str(config.profile or "shipped")),
    }
    return config_message(config.vehicle, utc_now(), settings)


def _metrics_of(store: ResultStore, session: Session) -> MetricsMessage:
    def message(numbers: Mapping[str, float]) -> Outgoing:
        dropped = store.dropped_counts()
        own = {
            "store_used_bytes": store.used_bytes(),
            "store_dropped_delivered_count": dropped.delivered,
            "store_dropped_empty_count": dropped.empty,
            "store_dropped_undelivered_count": dropped.undelivered,
            "store_given_up_count": session.given_up_count,
        }
        return metrics_message(session.vehicle, utc_now(), {**numbers, **own})

    return message


def _connect_now(connector: MqttConnector) -> Callable[[], AbstractAsyncContextManager[Link]]:
    return lambda: connector.connect(utc_now())
