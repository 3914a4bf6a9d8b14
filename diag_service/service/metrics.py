"""A live run for machines: Prometheus metrics and health checks over HTTP, in threads of their own."""

import logging
import socket
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from socketserver import ThreadingMixIn
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server
from wsgiref.types import StartResponse, WSGIEnvironment

from prometheus_client import CollectorRegistry, make_wsgi_app
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from diag_service.errors import ConfigError
from diag_service.service.families import families
from diag_service.service.snapshot import Board
from diag_service.settings.config import ListenAddress

CLIENT_TIMEOUT_S = 5.0
_LOG = logging.getLogger(__name__)


class SnapshotCollector(Collector):
    """The latest snapshot as metric families; no families before the first."""

    def __init__(self, board: Board) -> None:
        self._board = board

    def collect(self) -> Iterable[Metric]:
        """Yield the families."""
        snapshot = self._board.latest
        if snapshot is not None:
            yield from families(snapshot)


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
