"""A live run for machines: Prometheus metrics and health checks over HTTP, in threads of their own."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from wsgiref.types import StartResponse, WSGIEnvironment

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from diag_service.service.families import families
from diag_service.service.snapshot import Board
from diag_service.service.web import serving_web
from diag_service.settings.config import ListenAddress


class SnapshotCollector(Collector):
    """The latest snapshot as metric families; no families before the first."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def collect(self) -> Iterable[Metric]:
        """Yield the families."""
        snapshot = self._board.latest
        if snapshot is not None:
            yield from families(snapshot)


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

    with serving_web(address, answer, "metrics") as port:
        yield port
