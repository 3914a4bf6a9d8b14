"""paho-mqtt's client on asyncio's loop, as paho-mqtt means an event loop of others to carry it."""

import asyncio
import logging
import ssl
from collections.abc import Callable
from socket import IPPROTO_TCP, TCP_NODELAY, socket
from typing import Any, Final

from paho.mqtt.client import MQTT_ERR_SUCCESS, Client

from fleet_link.bulk import Bulk

_LOG: Final = logging.getLogger(__name__)
_MISC_PERIOD_S: Final = 1.0  # of what is due without news from the socket: pings


class SocketLoop:
    """Reads, writes and pings for a client whenever its socket is ready.

    ``connect`` blocks and so runs in a thread; paho-mqtt opens the socket there, hence the thread-safe calls.

    Parameters
    ----------
    lose :
        Called when reading or writing fails in a way that the client does not report itself.
    """

    def __init__(self, client: Client, lose: Callable[[], None]) -> None:
        self._client = client
        self._lose = lose
        self._loop = asyncio.get_running_loop()
        self._pings: asyncio.Task[None] | None = None
        self._is_ended = False
        self._bulk: Bulk | None = None
        client.on_socket_open = self._on_open
        client.on_socket_close = self._on_close
        client.on_socket_register_write = self._on_write_wanted
        client.on_socket_unregister_write = self._on_write_done

    def go_on_with(self, bulk: Bulk) -> None:
        """Read and write without the client from now on; call it where the last packet that it read was complete."""
        self._bulk = bulk

    def write(self) -> None:
        """Write what waits, and go on with it as soon as the socket takes more."""
        self._write()

    def end(self) -> None:
        """Ping no more; a socket that is opened after this is closed at once."""
        self._is_ended = True
        if self._pings is not None:
            self._pings.cancel()

    def _on_open(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        self._loop.call_soon_threadsafe(self._watch, sock)

    def _watch(self, sock: socket) -> None:
        if self._is_ended:  # whoever opened it has been cancelled meanwhile
            self._client.disconnect()
            self._client.loop_write()
        elif sock.fileno() >= 0:
            sock.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)  # else a second message waits until the first has arrived
            self._loop.add_reader(sock.fileno(), self._read)
            self._pings = self._loop.create_task(self._ping(), name="mqtt-pings")

    def _on_close(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        if sock.fileno() >= 0:
            self._loop.remove_reader(sock.fileno())
            self._loop.remove_writer(sock.fileno())
        if self._pings is not None:
            self._loop.call_soon_threadsafe(self._pings.cancel)

    def _on_write_wanted(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        self._loop.call_soon_threadsafe(self._want_write, sock)

    def _want_write(self, sock: socket) -> None:
        if sock.fileno() >= 0:
            self._loop.add_writer(sock.fileno(), self._write)

    def _on_write_done(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        if sock.fileno() >= 0:
            self._loop.remove_writer(sock.fileno())

    def _read(self) -> None:
        if self._bulk is None:
            self._advance(self._client.loop_read)
            while self._bulk is None and isinstance(sock := self._client.socket(), ssl.SSLSocket) and sock.pending():
                self._advance(self._client.loop_read)  # decrypted already: the socket will not become ready for it
            if self._bulk is None or not isinstance(self._client.socket(), ssl.SSLSocket):
                return
        self._advance(self._bulk.read)
        self._write()

    def _write(self) -> None:
        if self._bulk is None:
            self._advance(self._client.loop_write)
            return
        self._advance(self._bulk.flush)
        if self._client.want_write() and not self._bulk.has_more:  # it takes leave
            self._advance(self._client.loop_write)
        sock = self._client.socket()
        if sock is None or sock.fileno() < 0:
            return
        if self._bulk.has_more:
            self._loop.add_writer(sock.fileno(), self._write)
        else:
            self._loop.remove_writer(sock.fileno())

    def _advance(self, step: Callable[[], object]) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - a peer may send anything; whatever it was, this connection is at its end
            _LOG.debug("the connection breaks", exc_info=True)
            self._client.disconnect()
            self._lose()

    async def _ping(self) -> None:
        while self._client.socket() is not None:
            if self._bulk is not None:
                self._advance(self._bulk.tick)
                self._write()
            elif self._client.loop_misc() != MQTT_ERR_SUCCESS:
                return
            await asyncio.sleep(_MISC_PERIOD_S)
