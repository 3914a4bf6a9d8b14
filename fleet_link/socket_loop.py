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
_MOST_AT_ONCE: Final = 100  # packets, before others on the loop have their turn
_NOBODYS: Final = "-"  # a topic that nobody subscribes to


class SocketLoop:
    """Reads, writes and pings for a client whenever its socket is ready.

    ``connect`` blocks and so runs in a thread; paho-mqtt opens the socket there, hence the thread-safe calls.

    Parameters
    ----------
    lose :
        Called when reading or writing fails in a way that the client does not report itself.
    wrote :
        Called whenever the socket took some of what is to be written.
    """

    def __init__(self, client: Client, lose: Callable[[], None], wrote: Callable[[], None]) -> None:
        self._client = client
        self._lose = lose
        self._wrote = wrote
        self._loop = asyncio.get_running_loop()
        self._pings: asyncio.Task[None] | None = None
        self._is_ended = False
        self._is_paused = False
        self._judged_after_s = 0.0  # until then a peer that is not heard is none that has gone
        self._taken_count = 0
        client.on_socket_open = self._on_open
        client.on_socket_close = self._on_close
        client.on_socket_register_write = self._on_write_wanted
        client.on_socket_unregister_write = self._on_write_done

    def end(self) -> None:
        """Ping no more; a socket that is opened after this is closed at once."""
        self._is_ended = True
        if self._pings is not None:
            self._pings.cancel()

    def took(self) -> None:
        """Note that a message came: where there is one, there may be more to read."""
        self._taken_count += 1

    def pause(self) -> None:
        """Read no more; what the peer still sends waits in the system's buffers, then with the peer."""
        if not self._is_paused:
            self._is_paused = True
            if (sock := self._open_socket()) is not None:
                self._loop.remove_reader(sock.fileno())

    def resume(self) -> None:
        """Read on."""
        if self._is_paused:
            self._is_paused = False
            self._judged_after_s = self._loop.time() + self._client.keepalive  # its answers wait behind what it sent
            if (sock := self._open_socket()) is not None:
                self._loop.add_reader(sock.fileno(), self._read)
                self._loop.call_soon(self._read)  # TLS may have decrypted what the system holds no longer

    def _open_socket(self) -> socket | None:
        sock = self._client.socket()
        return sock if isinstance(sock, socket) and sock.fileno() >= 0 else None

    def _on_open(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        self._loop.call_soon_threadsafe(self._watch, sock)

    def _watch(self, sock: socket) -> None:
        if self._is_ended:  # whoever opened it has been cancelled meanwhile
            self._client.disconnect()
            self._client.loop_write()
        elif sock.fileno() >= 0:
            sock.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)  # else a second message waits until the first has arrived
            if not self._is_paused:
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
        for _ in range(_MOST_AT_ONCE):
            before = self._taken_count
            if self._is_paused or self._open_socket() is None:
                return
            self._advance(self._client.loop_read)
            if self._taken_count == before:
                break
        self._read_decrypted()

    def _read_decrypted(self) -> None:
        """Read what the socket will not become ready for, since TLS holds it already."""
        while not self._is_paused and isinstance(sock := self._client.socket(), ssl.SSLSocket) and sock.pending():
            self._advance(self._client.loop_read)

    def _write(self) -> None:
        self._advance(self._client.loop_write)
        self._wrote()

    def _advance(self, step: Callable[[], object]) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - a peer may send anything; whatever it was, this connection is at its end
            _LOG.debug("the connection breaks", exc_info=True)
            self._client.disconnect()
            self._lose()

    async def _ping(self) -> None:
        """Ping, and give up a peer that does not answer; while its answers cannot be read, only be heard by it."""
        period_s = min(_MISC_PERIOD_S, self._client.keepalive / 4)
        spoke_s = self._loop.time()
        while True:
            now_s = self._loop.time()
            if not self._is_paused and now_s >= self._judged_after_s:
                if self._client.loop_misc() != MQTT_ERR_SUCCESS:
                    return
            elif now_s >= spoke_s + self._client.keepalive / 2:
                self._client.unsubscribe(_NOBODYS)  # paho-mqtt takes a ping without an answer for a loss
                spoke_s = now_s
            await asyncio.sleep(period_s)
