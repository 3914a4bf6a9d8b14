"""What Prometheus reads of an ingest worker, and how each program of the backend shows its metrics."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import Metric

from clutchdiag_io.metrics import Told, counter, gauge
from fleet_backend.config import Place
from fleet_backend.errors import ConfigError
from fleet_backend.ingest import Worker
from fleet_backend.intake import MessageKind


@contextmanager
def shown_at(place: Place | None, tell: Callable[[], Iterable[Metric]]) -> Iterator[None]:
    """Serve metrics while entered, where that is asked for; raises ConfigError if nothing can listen there."""
    if place is None:
        yield
        return
    registry = CollectorRegistry()
    registry.register(Told(tell))
    try:
        server, thread = start_http_server(place.port, place.host, registry)
    except OSError as exc:
        raise ConfigError(f"cannot serve metrics at {place.host}:{place.port}: {exc.strerror}") from exc
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


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
