"""paho-mqtt's client on asyncio's loop, as paho-mqtt means an event loop of others to carry it."""

import asyncio
import logging
import ssl
from collections.abc import Callable
from socket import IPPROTO_TCP, TCP_NODELAY, socket
from typing import Any, Final

from paho.mqtt.client import MQTT_ERR_SUCCESS, Client

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
        client.on_socket_open = self._on_open
        client.on_socket_close = self._on_close
        client.on_socket_register_write = self._on_write_wanted
        client.on_socket_unregister_write = self._on_write_done

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
        self._advance(self._client.loop_read)
        while isinstance(sock := self._client.socket(), ssl.SSLSocket) and sock.pending():
            self._advance(self._client.loop_read)  # decrypted already: the socket will not become ready for it

    def _write(self) -> None:
        self._advance(self._client.loop_write)

    def _advance(self, step: Callable[[], object]) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - a peer may send anything; whatever it was, this connection is at its end
            _LOG.debug("the connection breaks", exc_info=True)
            self._client.disconnect()
            self._lose()

    async def _ping(self) -> None:
        while self._client.loop_misc() == MQTT_ERR_SUCCESS:  # noqa: ASYNC110 - the client is asked, it tells nobody
            await asyncio.sleep(_MISC_PERIOD_S)
