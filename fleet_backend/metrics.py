"""What Prometheus reads of an ingest worker, and how each program of the backend shows its metrics."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager

from prometheus_client.core import Metric

from clutchdiag_io.metrics import counter, gauge, serving_metrics
from fleet_backend.config import Place
from fleet_backend.errors import ConfigError
from fleet_backend.ingest import Worker
from fleet_backend.intake import MessageKind


@contextmanager
def shown_at(place: Place | None, tell: Callable[[], Iterable[Metric]]) -> Iterator[None]:
    """Serve metrics while entered, where that is asked for; raises ConfigError if nothing can listen there."""
    with ExitStack() as stack:
        if place is not None:
            try:
                stack.enter_context(serving_metrics(place.host, place.port, tell))
            except OSError as exc:
                raise ConfigError(f"cannot serve metrics at {place.host}:{place.port}: {exc.strerror}") from exc
        yield


def worker_families(worker: Worker) -> Iterator[Metric]:
    """Yield what a worker has done and what it holds."""
    counts = {kind.name.lower(): worker.counts[kind] for kind in MessageKind}
    yield counter("ingest_messages", "Messages that are settled, by what became of them.", counts, "kind")
    yield gauge("ingest_listening", "Whether the worker has a connection to its broker.", float(worker.is_listening))
    yield gauge("ingest_backlog_messages", "Messages that were delivered and are not settled.", worker.backlog_count)
    yield gauge("ingest_lag_seconds", "How long the batch at hand has waited for its commit.", worker.lag_s)
    if worker.committed_at is not None:
        at_s = worker.committed_at.timestamp()
        yield gauge("ingest_last_commit_timestamp_seconds", "When messages were committed last.", at_s)
