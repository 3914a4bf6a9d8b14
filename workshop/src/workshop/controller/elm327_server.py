"""ELM327 adapters on a TCP port, one for each client, with a thread each, in front of the controllers of a vehicle.

Requests go to the controllers directly, not over the bus. ``AT MA`` shows the frames that the emulator sends.
"""

import queue
import select
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Final, Self

import can

from ecu_emulator.errors import BusError, EmulatorConfigError, RecordError
from workshop.controller.controller import TICK_S, Controller
from workshop.controller.elm327 import ElmReply, Interpreter, format_frame
from workshop.controller.iso14229 import NEGATIVE, Nrc

MOST_LINE_BYTES: Final = 512
MOST_MONITORED: Final = 512  # waiting frames of a client
STOPPED: Final = "STOPPED"
BUFFER_FULL: Final = "BUFFER FULL"
SEND_TIMEOUT_S: Final = 10.0  # a client that reads nothing for so long is disconnected
POLL_S: Final = 0.2
_READ_BYTES: Final = 4096
_IGNORED: Final = b"\0\n"


@dataclass(slots=True)
class ElmCounts:
    """Counts of clients and lines."""

    clients: int = 0
    refused_clients: int = 0
    lines: int = 0
    overlong_lines: int = 0


class Client:
    """One connection and its adapter."""

    def __init__(
        self,
        number: int,
        connection: socket.socket,
        interpreter: Interpreter,
        counts: ElmCounts,
        patience_s: float,
        idle_s: float,
        answer_s: float,
    ) -> None:
        self.number = number  # client number for the controller
        self._connection = connection
        self._interpreter = interpreter
        self._counts = counts
        self._patience_s = patience_s
        self._idle_s = idle_s
        self._answer_s = answer_s
        self._heard = b""
        self._frames: queue.Queue[can.Message] = queue.Queue(MOST_MONITORED)
        self._responses: queue.Queue[bytes] = queue.Queue(MOST_MONITORED)
        self._monitors = threading.Event()
        self._waits = threading.Event()
        self._is_full = threading.Event()

    def end(self) -> None:
        """Disconnect."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def feed_frame(self, message: can.Message) -> None:
        """Queue a frame if the client monitors the bus."""
        if not self._monitors.is_set() or message.is_error_frame:
            return
        try:
            self._frames.put_nowait(message)
        except queue.Full:
            self._is_full.set()

    def feed_response(self, payload: bytes) -> None:
        """Queue a response if the client waits for one."""
        if self._waits.is_set():
            with suppress(queue.Full):
                self._responses.put_nowait(payload)

    def converse(self) -> None:
        """Answer the client until it disconnects; raises OSError if the connection breaks."""
        self._connection.settimeout(SEND_TIMEOUT_S)
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while (text := self._line()) is not None:
            self._counts.lines += 1
            if len(text) > MOST_LINE_BYTES:
                self._counts.overlong_lines += 1
                self._send_lines([text[:MOST_LINE_BYTES]] if self._interpreter.settings.echoes else [])
                self._prompt(["?"])
                continue
            self._send_lines([text] if self._interpreter.settings.echoes else [])
            self._waits.set()  # before the request: its response may come at once
            reply = self._interpreter.execute(text)
            if reply.is_from_car:
                time.sleep(self._answer_s)
            self._send_lines(reply.lines)
            self._prompt(self._later_lines(reply))

    def _later_lines(self, reply: ElmReply) -> list[str]:
        """Return the lines before the prompt, after monitoring or a pending response."""
        try:
            if reply.monitors:
                return self._monitor()
            return [] if reply.awaited is None else self._await_response(reply.awaited)
        finally:
            self._waits.clear()
            _emptied(self._responses)

    def _line(self) -> str | None:
        """Return the next line, None at the end; a too long one is cut off just above the limit."""
        while b"\r" not in self._heard:
            if not self._read():
                return None
            if b"\r" not in self._heard:
                self._heard = self._heard[: MOST_LINE_BYTES + 1]
        text, _, self._heard = self._heard.partition(b"\r")
        return text.decode("ascii", "replace").replace("\ufffd", "?")

    def _read(self) -> bool:
        """Wait for data and return whether there are any; raises OSError if a client is idle for too long."""
        self._connection.settimeout(self._idle_s)
        received = self._connection.recv(_READ_BYTES)
        self._connection.settimeout(SEND_TIMEOUT_S)
        self._heard += received.translate(None, _IGNORED)
        return bool(received)

    def _is_interrupted(self, patience_s: float) -> bool:
        """Return whether the client has sent a character, which interrupts the adapter and is dropped."""
        if not self._heard:
            if not select.select([self._connection], [], [], patience_s)[0]:
                return False
            if not self._read():
                raise ConnectionResetError
        self._heard = self._heard[1:]
        return True

    def _monitor(self) -> list[str]:
        _emptied(self._frames)
        self._is_full.clear()
        self._monitors.set()
        try:
            while not self._is_full.is_set():
                if self._is_interrupted(0.0):
                    return [STOPPED]
                with suppress(queue.Empty):
                    message = self._frames.get(timeout=POLL_S)
                    settings, data = self._interpreter.settings, bytes(message.data)
                    self._send_lines([format_frame(message.arbitration_id, data, settings, len(data))])
            return [BUFFER_FULL]
        finally:
            self._monitors.clear()

    def _await_response(self, service: int) -> list[str]:
        """Send the final response after 78."""
        until_s = time.monotonic() + self._patience_s
        while time.monotonic() < until_s:
            if self._is_interrupted(0.01):
                return [STOPPED]
            with suppress(queue.Empty):
                response = self._responses.get_nowait()
                if service not in {response[0] - 0x40, response[1] if response[0] == NEGATIVE else None}:
                    continue
                self._send_lines(self._interpreter.lines(response))
                if response[0] != NEGATIVE or response[2] != Nrc.RESPONSE_PENDING:
                    return []
                until_s = time.monotonic() + self._patience_s
        return []

    def _send_lines(self, lines: "list[str] | tuple[str, ...]") -> None:
        end = "\r\n" if self._interpreter.settings.has_line_feeds else "\r"
        self._connection.sendall("".join(f"{text}{end}" for text in lines).encode("ascii"))

    def _prompt(self, lines: list[str]) -> None:
        self._send_lines([*lines, ""])
        self._connection.sendall(b">")


def _emptied(waiting: "queue.Queue[can.Message] | queue.Queue[bytes]") -> None:
    with suppress(queue.Empty):
        while True:
            waiting.get_nowait()


MOST_CLIENTS: Final = 8
IDLE_S: Final = 300.0  # an idle client is disconnected, as by DoIP
ANSWER_S: Final = 0.07  # of an adapter beside the car's own time: real ones reach 10 to 20 answers a second


class ElmServer(ThreadingTCPServer):
    """Serves clients while the ``with`` block runs.

    Parameters
    ----------
    controller, others
        The controllers that answer.
    place
        Host and port; port 0: any free one.
    bitrate
        Of the bus [bit/s], which decides the protocol; None: 500,000.
    idle_s
        Time after which an idle client is disconnected [s].
    answer_s
        What each request takes beside the time of its controller [s].

    Raises
    ------
    ConfigError
        If the controller has extended addressing, which the adapter does not support.
    BusError
        If it cannot listen there.
    """

    allow_reuse_address = True
    request_queue_size = MOST_CLIENTS

    def __init__(
        self,
        controller: Controller,
        place: tuple[str, int],
        bitrate: int | None = None,
        *others: Controller,
        idle_s: float = IDLE_S,
        answer_s: float = ANSWER_S,
    ) -> None:
        if controller.table.transport.own_address is not None:
            raise EmulatorConfigError("an ELM327 does not reach a controller with extended addresses")
        serve = self._serve

        class ElmCaller(BaseRequestHandler):
            def handle(self) -> None:
                serve(self.request)

        self._controller = controller
        self._bitrate = bitrate
        self._others = others
        self._idle_s = idle_s
        self._answer_s = answer_s
        self._is_over = threading.Event()
        self._clients: list[Client] = []
        self._lock = threading.Lock()
        self._places = threading.Semaphore(MOST_CLIENTS)
        self._thread = threading.Thread(target=self.serve_forever, args=(POLL_S,), name="ELM327", daemon=True)
        self._ticker = threading.Thread(target=self._tick, name="ELM327 ticks", daemon=True)
        self.counts = ElmCounts()
        host, port = place
        try:
            self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
            super().__init__((host, port), ElmCaller)
        except OSError as exc:
            raise BusError(f"ELM327 cannot listen at {host}:{port}: {exc.strerror or exc}") from exc

    @property
    def address(self) -> tuple[str, int]:
        host, port, *_ = self.socket.getsockname()
        return str(host), int(port)

    @property
    def place(self) -> str:
        """Host and port for people."""
        host, port = self.address
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @property
    def is_exposed(self) -> bool:
        """Whether other machines can reach it."""
        return not ip_address(self.address[0]).is_loopback

    def __enter__(self) -> Self:
        self._thread.start()
        self._ticker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self.shutdown()
        for client in self._current_clients():
            client.end()
        self.server_close()
        self._ticker.join()

    def close(self) -> None:
        """Close the socket, as the end of the block does; needed if it is never entered."""
        self.server_close()

    def feed_frame(self, message: can.Message) -> None:
        """Queue a frame for clients that monitor the bus; does not block."""
        for client in self._clients:
            client.feed_frame(message)

    def _tick(self) -> None:
        """Pass pending responses to clients, until the end."""
        while not self._is_over.wait(TICK_S):
            for client in self._current_clients():
                if self._controller.awaits(client.number):
                    response = self._controller.tick(client.number)
                    if response is not None:
                        client.feed_response(response)

    def _current_clients(self) -> list[Client]:
        with self._lock:
            return list(self._clients)

    def verify_request(self, request: object, client_address: object) -> bool:
        """Return whether one more client may connect."""
        del request, client_address
        has_room = self._places.acquire(blocking=False)
        self.counts.refused_clients += not has_room
        return has_room

    def _serve(self, connection: socket.socket) -> None:
        with self._lock:
            self.counts.clients += 1
            table, number = self._controller.table, -self.counts.clients  # DoIP connections have positive numbers
            others = {other.table.addressing: partial(_ask, other, number) for other in self._others}
            ask = partial(_ask, self._controller, number)
            interpreter = Interpreter(table.addressing, table.transport, ask, self._bitrate, others)
            patience_s = table.timing.p2_star_s
            client = Client(number, connection, interpreter, self.counts, patience_s, self._idle_s, self._answer_s)
            self._clients = [*self._clients, client]
        if self._is_over.is_set():  # connected during the end
            client.end()
        try:
            with suppress(OSError):  # a broken connection does not concern the drive
                client.converse()
        finally:
            with self._lock:
                self._clients = [other for other in self._clients if other is not client]
            self._places.release()
            with suppress(RecordError):  # the saved state has no sessions
                self._controller.leave(number)


def _ask(controller: Controller, number: int, payload: bytes, is_functional: bool) -> bytes | None:  # noqa: FBT001 - a callable's
    return controller.ask(payload, is_functional=is_functional, client=number)
