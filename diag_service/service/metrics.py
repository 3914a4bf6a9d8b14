"""A live run for machines: Prometheus metrics and health checks over HTTP, in threads of their own."""

import logging
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server
from wsgiref.types import StartResponse, WSGIEnvironment

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from canlog.e2e.e2e_state import E2eState
from canlog.live import BusState
from diag_service.console.progress import Stage
from diag_service.errors import ConfigError
from diag_service.service.snapshot import Board, Snapshot
from diag_service.settings.config import ListenAddress

CLIENT_TIMEOUT_S = 5.0
_LOG = logging.getLogger(__name__)


_Value = float | Mapping[Any, float]


class SnapshotCollector(Collector):
    """The latest snapshot as metric families; no families before the first."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def collect(self) -> Iterable[Metric]:
        """Yield the families."""
        snapshot = self._board.latest
        if snapshot is not None:
            yield from _of_the_bus(snapshot)
            yield from _of_messages(snapshot)
            yield from _of_shifts(snapshot)


def _of_the_bus(snapshot: Snapshot) -> Iterator[Metric]:
    bus, frames = snapshot.bus, snapshot.summary.frames
    fates = {
        "decoded": frames.decoded,
        "ignored": frames.ignored,
        "unsupported": frames.unsupported,
        "kernel_dropped": frames.kernel_dropped,
        "queue_dropped": frames.queue_dropped,
        **{f"rejected_{reason}": count for reason, count in frames.rejected.items()},
    }
    yield _gauge("bus_state", "1 for the state that the bus is in.", _one_of(BusState, bus.state), "state")
    yield _gauge("bus_load_ratio", "Share of the bit rate, stuff bits estimated.", snapshot.load_ratio)
    yield _counter("bus_errors", "Error frames by what they tell.", dict(bus.errors), "kind")
    yield _counter("bus_interruptions", "Times that the interface was lost.", bus.interruption_count)
    yield _counter("bus_restarts_asked", "Restarts asked of the controller.", bus.restart_count)
    yield _counter("clock_steps", "Steps of the wall clock.", snapshot.clock_steps)
    yield _counter("frames_on_bus", "Frames that reached this machine.", frames.on_bus)
    yield _counter("frames", "Frames by what became of them.", fates, "fate")
    yield _counter("frames_missing", "Frames that alive counters show to be lost.", frames.missing)


def _of_messages(snapshot: Snapshot) -> Iterator[Metric]:
    messages = snapshot.messages.items()
    nominal = {name: message.nominal_hz for name, message in messages if message.nominal_hz is not None}
    states = {
        (name, state): value
        for name, message in messages
        for state, value in _one_of(E2eState, message.e2e_state).items()
    }
    lapses = {name: message.invalidations for name, message in messages}
    yield _gauge("message_rate_hertz", "Frames per second, as received.", snapshot.rates_hz, "message")
    yield _gauge("message_nominal_hertz", "Frames per second, as the database says.", nominal, "message")
    yield _gauge("message_e2e_state", "1 for the E2E state of the message.", states, "message", "state")
    yield _counter("message_invalidations", "Times that a message lost its trust.", lapses, "message")


def _of_shifts(snapshot: Snapshot) -> Iterator[Metric]:
    summary, stuck = snapshot.summary, {stage.value: 0.0 for stage in Stage}
    if snapshot.stuck is not None:
        stuck[snapshot.stuck.stage.value] = snapshot.stuck.for_s
    yield _gauge("stage_stuck_seconds", "How long a stage has held work without progress.", stuck, "stage")
    yield _counter("shifts", "Shifts by what their estimate is worth.", summary.shifts.by_status, "status")
    yield _counter("shift_reasons", "Shifts that were not used, by reason.", summary.shifts.by_reason, "reason")
    qualities = [result.estimate.data_quality for result in snapshot.recent if result.estimate.data_quality is not None]
    if qualities:
        yield _gauge("last_shift_trust", "Trust in the last shift, 0..1.", qualities[-1].score)


def _gauge(name: str, text: str, value: _Value, *labels: str) -> Metric:
    return _filled(GaugeMetricFamily(f"clutchdiag_{name}", text, labels=labels), value)


def _counter(name: str, text: str, value: _Value, *labels: str) -> Metric:
    return _filled(CounterMetricFamily(f"clutchdiag_{name}", text, labels=labels), value)


def _filled(family: GaugeMetricFamily | CounterMetricFamily, value: _Value) -> Metric:
    """Return a family with its value, or with one value for each of its labels."""
    values = value if isinstance(value, Mapping) else {(): value}
    for key, one in values.items():
        family.add_metric(key if isinstance(key, tuple) else (str(key),), one)
    return family


def _one_of(states: Any, present: Any) -> dict[str, float]:  # noqa: ANN401 - any enumeration
    return {state.name.lower(): float(state is present) for state in states}


class _Server(ThreadingMixIn, WSGIServer):
    """A thread per request, so that a client that stalls holds up nobody."""

    daemon_threads = True
    block_on_close = False


class _Server6(_Server):
    """The same on an IPv6 address."""

    address_family = socket.AF_INET6


class _Handler(WSGIRequestHandler):
    """Requests are no news."""

    timeout = CLIENT_TIMEOUT_S

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name that the library gave it
        _LOG.debug(format, *args)


@contextmanager
def serving(address: ListenAddress, board: Board) -> Iterator[int]:
    """Serve ``/metrics``, ``/livez`` and ``/readyz`` while entered; yield the port.

    Raises ConfigError if the address cannot be listened to.
    """
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(board))
    metrics = make_wsgi_app(registry)
    checks = {"/livez": lambda: board.is_live, "/readyz": lambda: board.is_ready}

    def answer(environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        path = environ.get("PATH_INFO", "")
        if path == "/metrics":
            found: Iterable[bytes] = metrics(environ, start_response)
            return found
        check = checks.get(path)
        status = HTTPStatus.NOT_FOUND
        if check is not None:
            status = HTTPStatus.OK if check() else HTTPStatus.SERVICE_UNAVAILABLE
        start_response(f"{status.value} {status.phrase}", [("Content-Type", "text/plain; charset=utf-8")])
        return [f"{status.phrase}\n".encode()]

    kind = _Server6 if ":" in address.host else _Server
    try:
        server = make_server(address.host, address.port, answer, kind, _Handler)
    except OSError as exc:
        raise ConfigError(f"cannot serve metrics on {address.host}:{address.port}: {exc.strerror or exc}") from exc
    thread = threading.Thread(target=server.serve_forever, name="metrics", daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
