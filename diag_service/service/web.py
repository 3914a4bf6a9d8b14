"""Small web servers of a live run, in threads of their own."""

import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from socketserver import ThreadingMixIn
from typing import Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server
from wsgiref.types import WSGIApplication

from diag_service.errors import ConfigError
from diag_service.settings.config import ListenAddress

CLIENT_TIMEOUT_S: Final = 5.0
_LOG = logging.getLogger(__name__)


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
def serving_web(address: ListenAddress, answer: WSGIApplication, name: str) -> Iterator[int]:
    """Serve while entered; yield the port. Raises ConfigError if the address cannot be listened to."""
    kind = _Server6 if ":" in address.host else _Server
    try:
        server = make_server(address.host, address.port, answer, kind, _Handler)
    except OSError as exc:
        raise ConfigError(f"cannot serve {name} on {address.host}:{address.port}: {exc.strerror or exc}") from exc
    thread = threading.Thread(target=server.serve_forever, name=name, daemon=True)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
