"""The adapter's TCP port: a thread for each client, all in front of the one controller.

It asks the controller's core, not the bus. What it monitors (``AT MA``) are the frames that the emulator sends.
"""

import socket
import threading
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from types import TracebackType
from typing import Final, Self

import can

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.elm327.client import POLL_S, Client, ElmCounts
from ecu_emulator.diagnostics.elm327.interpreter import Interpreter
from ecu_emulator.diagnostics.elm327.settings import LARGEST_STANDARD_ID
from ecu_emulator.errors import BusError, ConfigError, RecordError

PORT: Final = 35000  # where adapters on a wireless network listen
LOOPBACK: Final = "127.0.0.1"
MOST_CLIENTS: Final = 8
TICK_S: Final = 0.01
IDLE_S: Final = 300.0  # a client that says nothing for so long has gone, as DoIP has it
_LARGEST_PORT: Final = 65535


def parse_place(text: str) -> tuple[str, int]:
    """Return host and port of ``[HOST:]PORT``; without a host it is this machine alone.

    Raises
    ------
    ConfigError
        If it is no such thing.
    """
    host, colon, port = text.rpartition(":")
    if not (port.isascii() and port.isdecimal() and 0 <= int(port) <= _LARGEST_PORT) or (colon and not host):
        raise ConfigError(f"--elm327 must be [HOST:]PORT with a port of 0..{_LARGEST_PORT}, got {text}")
    return host.strip("[]") or LOOPBACK, int(port)


class ElmServer:
    """Serves clients while the ``with`` block runs.

    Parameters
    ----------
    controller
        Who is asked.
    place
        Host and port; port 0: any that is free.
    bitrate
        Of the bus [bit/s], which decides what the protocol is called; None: the usual one.
    idle_s
        A client that says nothing for so long is hung up on.

    Raises
    ------
    ConfigError
        If the controller has extended addresses, which such an adapter does not know.
    BusError
        If it cannot listen there.
    """

    def __init__(
        self, controller: Controller, place: tuple[str, int], bitrate: int | None = None, *, idle_s: float = IDLE_S
    ) -> None:
        if controller.table.transport.own_address is not None:
            raise ConfigError("an ELM327 does not reach a controller with extended addresses")
        self._controller = controller
        self._bitrate = bitrate
        self._idle_s = idle_s
        self._is_over = threading.Event()
        self._clients: list[Client] = []
        self._lock = threading.Lock()
        self._listener = _listening(*place)
        self._thread = threading.Thread(target=self._accept, name="ELM327", daemon=True)
        self._ticker = threading.Thread(target=self._tick, name="ELM327 ticks", daemon=True)
        self.counts = ElmCounts()

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port, *_ = self._listener.getsockname()
        return str(host), int(port)

    @property
    def place(self) -> str:
        """Where it listens, as people write it."""
        host, port = self.address
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @property
    def is_exposed(self) -> bool:
        """Whether others than this machine can reach it."""
        return not ip_address(self.address[0]).is_loopback

    def __enter__(self) -> Self:
        self._thread.start()
        self._ticker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over.set()
        self._thread.join()
        self._listener.close()
        for client in self._present():
            client.end()
        self._ticker.join()

    def close(self) -> None:
        """Listen no more, as it does after its block; one that is never entered needs it."""
        self._listener.close()

    def hear_frame(self, message: can.Message) -> None:
        """Show a frame of the bus to clients that monitor it; never waits."""
        for client in self._clients:
            client.hear_frame(message)

    def _tick(self) -> None:
        """Hand clients what the controller has for them without being asked again, until the end."""
        while not self._is_over.wait(TICK_S):
            for client in self._present():
                if self._controller.awaits(client.number):
                    response = self._controller.tick(client.number)
                    if response is not None:
                        client.hear_response(response)
                for payload in self._controller.broadcast(client.number):
                    client.hear_frame(self._periodic(payload))

    def _periodic(self, payload: bytes) -> can.Message:
        """Return data of service 2A as the frame that it would be on the bus."""
        periodic = self._controller.table.periodic
        can_id = 0 if periodic is None else periodic.response_id
        return can.Message(arbitration_id=can_id, is_extended_id=can_id > LARGEST_STANDARD_ID, data=payload)

    def _present(self) -> list[Client]:
        with self._lock:
            return list(self._clients)

    def _accept(self) -> None:
        while not self._is_over.is_set():
            try:
                connection, _ = self._listener.accept()
            except TimeoutError:
                continue
            except OSError:  # no descriptor is left, or the caller has gone already
                self._is_over.wait(POLL_S)
                continue
            self._take(connection)

    def _take(self, connection: socket.socket) -> None:
        with self._lock:
            if len(self._clients) >= MOST_CLIENTS:
                self.counts.refused_clients += 1
                connection.close()
                return
            self.counts.clients += 1
            table, number = self._controller.table, -self.counts.clients  # testers over IP have positive numbers
            ask = partial(self._ask, number)
            interpreter = Interpreter(table.addressing, table.transport, ask, self._bitrate)
            patience_s = table.timing.p2_star_s
            client = Client(number, connection, interpreter, self.counts, patience_s, self._idle_s, self._leave)
            self._clients = [*self._clients, client]
        client.start()

    def _ask(self, number: int, payload: bytes, is_functional: bool) -> bytes | None:  # noqa: FBT001 - a callable's
        return self._controller.ask(payload, is_functional=is_functional, client=number)

    def _leave(self, client: Client) -> None:
        with self._lock:
            self._clients = [other for other in self._clients if other is not client]
        with suppress(RecordError):  # what is kept is not about sessions
            self._controller.leave(client.number)


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listener = socket.socket(family, socket.SOCK_STREAM)
    except OSError as exc:
        raise BusError(f"ELM327 cannot listen at {host}:{port}: {exc.strerror or exc}") from exc
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(MOST_CLIENTS)
        listener.settimeout(POLL_S)
    except OSError as exc:
        listener.close()
        raise BusError(f"ELM327 cannot listen at {host}:{port}: {exc.strerror or exc}") from exc
    return listener
