"""A controller on an IP network: sockets around the pure functions of `doip`, in an event loop."""

import asyncio
import random
import socket
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from functools import partial
from ipaddress import IPv4Address
from typing import Final, Self

from ecu_emulator.errors import BusError, EmulatorConfigError
from workshop.controller import doip
from workshop.controller.controller import TICK_S, Controller
from workshop.controller.doip import announcement, datagram_reply
from workshop.controller.iso14229 import NEGATIVE, Nrc
from workshop.controller.server import AGAIN_RATIO, KEEP_ALIVE, PENDING_RATIO
from workshop.controller.table import DoipEntity

LARGEST_PORT: Final = 65535
LOOPBACK: Final = "127.0.0.1"
LOCAL_BROADCAST: Final = "127.255.255.255"
BROADCAST: Final = "255.255.255.255"
BACKLOG: Final = 16
SEND_BYTES: Final = 1 << 16  # send buffer of a connection; while it is full nothing is read from its tester


@dataclass(frozen=True, slots=True, kw_only=True)
class DoipAddress:
    """Host and port to listen on."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Listening:
    """Open sockets of one address."""

    tcp: socket.socket
    udp: tuple[socket.socket, ...]  # the first one also sends
    broadcast: tuple[str, int]  # receivers of announcements
    is_exposed: bool  # whether other machines can reach it

    def close(self) -> None:
        for opened in (self.tcp, *self.udp):
            opened.close()


def parse_place(text: str, option: str = "--doip", *, least_port: int = 1) -> DoipAddress:
    """Return the address that ``[HOST:]PORT`` names; without a host the loopback. IPv6 stands in brackets.

    Raises ConfigError if it is invalid.
    """
    host, _, port = text.rpartition(":")
    is_bracketed = host.startswith("[") and host.endswith("]")
    is_port = port.isascii() and port.isdecimal() and least_port <= int(port) <= LARGEST_PORT
    if not is_port or text.startswith(":") or (":" in host and not is_bracketed):
        raise EmulatorConfigError(
            f"{option} must be [HOST:]PORT with a port of {least_port}..{LARGEST_PORT}, got {text}"
        )
    return DoipAddress(host=(host[1:-1] if is_bracketed else host) or LOOPBACK, port=int(port))


def listen(place: DoipAddress) -> Listening:
    """Return open sockets of an IPv4 address, which also receive broadcasts of its network.

    Raises BusError if the address is not of this machine, or is in use.
    """
    with ExitStack() as stack:
        try:
            address = IPv4Address(socket.gethostbyname(place.host))
            broadcast = LOCAL_BROADCAST if address.is_loopback else BROADCAST
            tcp = _connections(stack, str(address), place.port)
            hosts = [str(address)] if address.is_unspecified else [str(address), broadcast]
            udp = tuple(_datagrams(stack, host, place.port) for host in hosts)
        except OSError as exc:
            raise BusError(f"DoIP cannot listen on {place}: {exc.strerror or exc}") from exc
        stack.pop_all()
    return Listening(tcp=tcp, udp=udp, broadcast=(broadcast, place.port), is_exposed=not address.is_loopback)


def _connections(stack: ExitStack, host: str, port: int) -> socket.socket:
    listener = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # inherited by connections: no delay of 40 ms
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    listener.bind((host, port))
    listener.listen(BACKLOG)
    return listener


def _datagrams(stack: ExitStack, host: str, port: int) -> socket.socket:
    receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    receiver.setblocking(False)
    receiver.bind((host, port))
    return receiver


VIN = 0xF190
MOST_DELAYED = 64  # identification answers that wait for their random pause


@dataclass(slots=True)
class DatagramCounts:
    """Counts of datagrams."""

    datagrams: int = 0
    answered_datagrams: int = 0
    dropped_datagrams: int = 0  # more than `MOST_DELAYED` were waiting
    unsent_datagrams: int = 0  # the network refused them


class DatagramServer(asyncio.DatagramProtocol):
    """Answers in the running event loop from ``start`` until ``close``.

    Parameters
    ----------
    entity
        Description of the entity.
    controller
        Knows the VIN, and whether it sleeps after a reset.
    open_sockets
        Returns the present number of connections.
    """

    def __init__(self, entity: DoipEntity, controller: Controller, *, open_sockets: Callable[[], int]) -> None:
        self._entity = entity
        self._controller = controller
        self._open_sockets = open_sockets
        self._ends: list[asyncio.DatagramTransport] = []
        self._delayed: set[asyncio.TimerHandle] = set()
        self.counts = DatagramCounts()

    async def start(self, sockets: Listening) -> None:
        loop = asyncio.get_running_loop()
        for opened in sockets.udp:
            end, _ = await loop.create_datagram_endpoint(lambda: self, sock=opened)
            self._ends.append(end)

    def close(self) -> None:
        """Stop answering."""
        for timer in self._delayed:
            timer.cancel()
        for end in self._ends:
            end.close()

    async def announce(self, broadcast: tuple[str, int], delay_s: float = 0.0) -> None:
        """Send the announcements of a start, after a delay [s]."""
        await asyncio.sleep(delay_s + self._pause_s())
        for _ in range(self._entity.announce_count):
            self._send(announcement(self._entity, self._controller.datum(VIN), self._entity.version), broadcast)
            await asyncio.sleep(self._entity.announce_interval_s)

    def datagram_received(self, data: bytes, sender: tuple[str, int]) -> None:
        """Answer a datagram, an identification after a random pause."""
        self.counts.datagrams += 1
        reply = datagram_reply(self._entity, self._controller.datum(VIN), self._open_sockets(), data)
        if reply is None or self._controller.is_asleep:
            return
        if not reply.is_identification:
            self._answer(reply.data, sender)
        elif len(self._delayed) >= MOST_DELAYED:
            self.counts.dropped_datagrams += 1
        else:
            timer: asyncio.TimerHandle

            def say() -> None:
                self._delayed.discard(timer)
                self._answer(reply.data, sender)

            timer = asyncio.get_running_loop().call_later(self._pause_s(), say)
            self._delayed.add(timer)

    def error_received(self, _error: Exception) -> None:
        """Count a datagram that the network refused."""
        self.counts.unsent_datagrams += 1

    def _answer(self, data: bytes, receiver: tuple[str, int]) -> None:
        self.counts.answered_datagrams += 1
        self._send(data, receiver)

    def _send(self, data: bytes, receiver: tuple[str, int]) -> None:
        with suppress(OSError):  # invalid receiver; other errors come to error_received
            self._ends[0].sendto(data, receiver)

    def _pause_s(self) -> float:
        return random.uniform(0.0, self._entity.announce_wait_s)  # noqa: S311 - so that entities do not answer at once


READ_BYTES: Final = 4096
LINGER_S: Final = 1.0  # time for a tester to read the last data before its connection is aborted


@dataclass(slots=True)
class DoipCounts:
    """Counts of connections."""

    connections: int = 0
    refused_connections: int = 0  # beyond the accepted number, or during a reset
    requests: int = 0
    responses: int = 0


class DoipServer:
    """Answers over TCP and UDP while the ``with`` block runs.

    Parameters
    ----------
    controller
        The controller that answers.
    place
        Where it listens.

    Raises
    ------
    BusError
        If it cannot listen there.
    """

    def __init__(self, controller: Controller, place: DoipAddress) -> None:
        self._controller = controller
        self._entity = controller.table.doip
        self._step = doip.Step(sockets={})
        self._writers: dict[int, asyncio.StreamWriter] = {}
        self._asks: dict[int, asyncio.Queue[doip.Ask]] = {}
        self._reset_s = controller.state.asleep_until_s  # end of the last reset
        self._asking_count = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._pool = ThreadPoolExecutor(1, "DoIP asks")
        self._datagrams = DatagramServer(self._entity, controller, open_sockets=lambda: len(self._step.sockets))
        self._counts = DoipCounts()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_over = asyncio.Event()
        self._is_ready = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="DoIP", daemon=True)
        self._sockets = listen(place)
        self.place = place

    @property
    def is_exposed(self) -> bool:
        """Whether other machines can reach it."""
        return self._sockets.is_exposed

    @property
    def counts(self) -> dict[str, int]:
        return asdict(self._counts) | asdict(self._datagrams.counts)

    def __enter__(self) -> Self:
        self._thread.start()
        self._is_ready.wait()
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop has ended by itself
                self._loop.call_soon_threadsafe(self._is_over.set)
        self._thread.join()
        if self._error is not None and error is None:
            raise self._error

    def close(self) -> None:
        """Close the sockets, as the end of the block does; needed if it is never entered."""
        self._sockets.close()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as exc:  # noqa: BLE001 - carried to the caller's thread, which raises it
            self._error = exc
        finally:
            self._is_ready.set()
            self._pool.shutdown()
            self.close()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        async with asyncio.TaskGroup() as group:
            server = await asyncio.start_server(partial(self._accept, group), sock=self._sockets.tcp, limit=READ_BYTES)
            await self._datagrams.start(self._sockets)
            self._start(group, self._datagrams.announce(self._sockets.broadcast))
            self._start(group, self._advance(group))
            self._is_ready.set()
            try:
                await self._is_over.wait()
            finally:
                server.close()
                self._datagrams.close()
                for writer in self._writers.values():
                    writer.transport.abort()
                for task in self._tasks:
                    task.cancel()

    def _start(self, group: asyncio.TaskGroup, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = group.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _accept(self, group: asyncio.TaskGroup, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        most = self._entity.most_sockets + doip.MORE_CONNECTIONS
        if self._controller.is_asleep or len(self._writers) >= most:
            self._counts.refused_connections += 1
            writer.transport.abort()
            return
        self._counts.connections += 1
        number = self._counts.connections
        self._writers[number], self._asks[number] = writer, asyncio.Queue()
        self._step = doip.opened(self._step, number, time.monotonic())
        self._start(group, self._converse(group, number, reader))

    async def _converse(self, group: asyncio.TaskGroup, number: int, reader: asyncio.StreamReader) -> None:
        """Read from one connection until its tester closes it; data after a close from here are ignored."""
        answering = self._start(group, self._answer(number))
        writer = self._writers[number]
        try:
            while data := await reader.read(READ_BYTES):
                self._apply(doip.received(self._entity, self._step, number, data, time.monotonic()))
                if number in self._step.sockets:
                    await writer.drain()
        except OSError:  # the connection broke
            pass
        finally:
            answering.cancel()
            writer.transport.abort() if reader.exception() else writer.close()
            del self._writers[number], self._asks[number]
            self._apply(doip.closed(self._entity, self._step, number, time.monotonic()))
            self._pool.submit(self._controller.leave, number)

    def _apply(self, step: doip.Step) -> None:
        self._step = step.done()
        for action in step.actions:
            match action:
                case doip.Send(number=number, data=data):
                    if not self._writers[number].is_closing():  # it may have closed a moment ago
                        self._writers[number].write(data)
                case doip.Ask(number=number):
                    self._asks[number].put_nowait(action)
                case doip.Close(number=number):
                    self._close(self._writers[number])

    def _close(self, writer: asyncio.StreamWriter) -> None:
        """End sending to a tester, and abort the connection after `LINGER_S`."""
        with suppress(OSError):
            writer.write_eof()
        asyncio.get_running_loop().call_later(LINGER_S, writer.transport.abort)

    async def _advance(self, group: asyncio.TaskGroup) -> None:
        while True:
            await asyncio.sleep(TICK_S)
            self._note_reset(group)
            self._apply(doip.advanced(self._entity, self._step, time.monotonic()))

    def _note_reset(self, group: asyncio.TaskGroup) -> None:
        """Close all connections once a reset has been answered, and send the announcements of a start."""
        reset_s = self._controller.state.asleep_until_s
        if reset_s == self._reset_s or self._asking_count:
            return
        self._reset_s, step = reset_s, self._step
        for number in step.sockets:
            step = step.closing(number)
        self._apply(step)
        self._start(group, self._datagrams.announce(self._sockets.broadcast, self._controller.table.timing.reset_s))

    # --- the controller -----------------------------------------------------------------------------------------------

    async def _answer(self, number: int) -> None:
        """Pass one tester's requests to the controller, one at a time, and the responses back."""
        asks, writer = self._asks[number], self._writers[number]
        loop = asyncio.get_running_loop()
        try:
            while True:
                if not self._controller.awaits(number) or not asks.empty():
                    ask = await asks.get()
                    self._asking_count += 1
                    try:
                        await self._ask(number, ask)
                    finally:
                        self._asking_count -= 1
                else:
                    await asyncio.sleep(TICK_S)
                    response = await loop.run_in_executor(self._pool, self._controller.tick, number)
                    self._respond(number, response, is_final=False)
                await writer.drain()
        except OSError:  # the connection broke; the reader notices, too
            return

    async def _ask(self, number: int, ask: doip.Ask) -> None:
        """Answer one request; 78 comes first if saving takes long."""
        self._counts.requests += 1
        timing = self._controller.table.timing
        work = partial(self._controller.reply_to, ask.payload, is_functional=ask.is_functional, client=number)
        asking = asyncio.get_running_loop().run_in_executor(self._pool, work)
        patience_s, was_promised = PENDING_RATIO * timing.p2_s, False
        while not (await asyncio.wait([asking], timeout=patience_s))[0]:
            patience_s = AGAIN_RATIO * timing.p2_star_s
            if ask.payload != KEEP_ALIVE:
                was_promised = True
                self._respond(number, bytes([NEGATIVE, ask.payload[0], Nrc.RESPONSE_PENDING]), is_final=False)
        self._respond(number, asking.result().response(was_promised=was_promised), is_final=True)

    def _respond(self, number: int, response: bytes | None, *, is_final: bool) -> None:
        self._counts.responses += response is not None
        self._apply(doip.responded(self._entity, self._step, number, response, time.monotonic(), is_final=is_final))
