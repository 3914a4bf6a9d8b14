"""Wiring: a checked configuration becomes a worker, and runs until it is told to stop."""

import asyncio
import logging
import socket
import uuid
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final

from prometheus_client.core import Metric
from sqlalchemy import Engine, select
from sqlalchemy.exc import SQLAlchemyError

from clutchdiag_io.files import give_sign, make_sign
from clutchdiag_io.metrics import counter, gauge
from fleet_backend.choices import Pace, Quotas
from fleet_backend.config import ServerAddress
from fleet_backend.database import place_of
from fleet_backend.errors import BackendConfigError
from fleet_backend.ingest import Inbox, Worker, connected, filters_of, until_it_answers
from fleet_backend.intake import MessageKind
from fleet_backend.migrate import make_ready
from fleet_backend.programs import metrics_served, until_stopped
from fleet_backend.quotas import QuotaGate
from fleet_backend.writer import Writer
from fleet_link import BrokerAddress

PERIOD_S: Final = 5.0
RETRY_S: Final = 0.5  # how soon it is told that all is well again


def prepare(path: Path) -> None:
    """Make the file, from 1970: nothing is well yet; raises ConfigError if it cannot be made."""
    try:
        make_sign(path)
    except OSError as exc:
        raise BackendConfigError(f"cannot touch {path}: {exc.strerror}") from exc


async def give_signs(path: Path, worker: Worker, engine: Engine, period_s: float = PERIOD_S) -> None:
    """Touch a file every ``period_s``, for ever, while the worker listens to its broker and the database answers.

    A database that hangs touches nothing.
    """
    while True:
        is_well = worker.is_listening and await asyncio.to_thread(answers, engine)
        if is_well:
            give_sign(path)
        await asyncio.sleep(period_s if is_well else min(RETRY_S, period_s))


def answers(engine: Engine) -> bool:
    try:
        with engine.connect() as connection:
            connection.execute(select(1))
    except SQLAlchemyError:
        return False
    return True


REPORT_S = 60.0
_LOG = logging.getLogger(__name__)


def run_ingest(
    engine: Engine,
    address: BrokerAddress,
    pace: Pace,
    name: str | None,
    alive: Path | None = None,
    *,
    group: str,
    quotas: Quotas,
    metrics: ServerAddress | None = None,
) -> None:
    """Ingest until SIGINT or SIGTERM; while all is well, touch the file ``alive``.

    An SQLite database of an earlier schema, which belongs to this program alone, is upgraded first; a PostgreSQL must
    have the present one, since other workers may still write the schema before it.

    Raises
    ------
    DatabaseError
        If the database has another schema.
    ConfigError
        If the file ``alive`` cannot be made, or nothing can listen where ``metrics`` are to be read.
    """
    if alive is not None:
        prepare(alive)
    own_name = name or f"{socket.gethostname()}-{uuid.uuid4().hex[:8]}"

    def connect() -> AbstractAsyncContextManager[Inbox]:
        return connected(address, filters_of(group), max_unsettled=pace.max_unsettled)

    gate = QuotaGate(engine, quotas)
    worker = Worker(connect, Writer(engine), name=own_name, now=partial(datetime.now, UTC), pace=pace, judge=gate.judge)
    if address.exposure:
        _LOG.warning("%s", address.exposure)
    with metrics_served(metrics, lambda: worker_families(worker)):
        asyncio.run(_ingest(engine, worker, gate, f"{own_name}: {address} into {place_of(engine)}", alive))


async def _ingest(engine: Engine, worker: Worker, gate: QuotaGate, title: str, alive: Path | None) -> None:
    try:
        await until_stopped(_work(engine, worker, gate, title, alive))
    except ExceptionGroup as exc:
        if len(exc.exceptions) > 1:
            raise
        raise exc.exceptions[0] from exc
    _LOG.info("%s", _counts_line(worker))


async def _work(engine: Engine, worker: Worker, gate: QuotaGate, title: str, alive: Path | None) -> None:
    await until_it_answers(make_ready, engine)
    _LOG.info("worker %s", title)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(worker.run(), name="worker")
        tasks.create_task(_report(worker), name="report")
        tasks.create_task(gate.share(), name="quotas")
        if alive is not None:
            tasks.create_task(give_signs(alive, worker, engine), name="sign of life")


async def _report(worker: Worker) -> None:
    while True:
        await asyncio.sleep(REPORT_S)
        _LOG.info("%s", _counts_line(worker))


def _counts_line(worker: Worker) -> str:
    kinds = (MessageKind.SHIFT, MessageKind.POISON, MessageKind.WITHHELD)
    results, poison, withheld = (worker.counts[kind] for kind in kinds)
    beyond = f"; {withheld} beyond quotas" if withheld else ""
    return f"{results} results committed, repetitions included; {poison} messages kept aside{beyond}"


def worker_families(worker: Worker) -> Iterator[Metric]:
    """Yield what a worker has done and what it holds."""
    counts = {kind.name.lower(): worker.counts[kind] for kind in MessageKind}
    yield counter("ingest_messages", "Messages that are settled, by what became of them.", counts, "kind")
    yield gauge("ingest_listening", "Whether the worker has a connection to its broker.", float(worker.is_listening))
    backlog_count = 0 if worker.inbox is None or not worker.is_listening else worker.inbox.unsettled_count
    yield gauge("ingest_backlog_messages", "Messages that were delivered and are not settled.", backlog_count)
    lag_s = 0.0 if worker.begun_at is None else (datetime.now(UTC) - worker.begun_at).total_seconds()
    yield gauge("ingest_lag_seconds", "How long the batch at hand has waited for its commit.", lag_s)
    if worker.committed_at is not None:
        at_s = worker.committed_at.timestamp()
        yield gauge("ingest_last_commit_timestamp_seconds", "When messages were committed last.", at_s)
