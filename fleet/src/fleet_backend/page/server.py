"""The server: a socket, the application behind it, and the tasks that keep its view of the fleet fresh."""

import asyncio
import contextlib
import logging
import os
import socket
import sys
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Final

import anyio.to_thread
import scipy.special  # noqa: F401 - prognoses load it, and the first reader of a vehicle does not wait for that
import uvicorn
from sqlalchemy import Engine
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from fleet_backend.config import ServerAddress
from fleet_backend.database import place_of
from fleet_backend.errors import BackendConfigError
from fleet_backend.page.access import Access
from fleet_backend.page.fleet import Keeper, fleet_families
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.page.routes import routes
from fleet_backend.page.site import Sources, application
from fleet_backend.programs import metrics_served, stopping

_BACKLOG: Final = 128
_NICE: Final = 5  # ingest workers on the same machine go first
_THREADS: Final = 6  # that answer requests; more would wait for the interpreter's lock
HEADERS_S: Final = 10.0  # from the first byte of a request, or the connection, to the end of its head
STALLED_S: Final = 10.0  # in which a reader takes some of what is to be sent
MOST_CONNECTIONS: Final = 256  # at once; others are told that the server is busy
_UNSENT_BYTES: Final = 131_072  # of a connection in the system's memory, which would hold megabytes of it
_GRACE_S: Final = 3  # for readers who are being answered when the server is told to stop
_LOG: Final = logging.getLogger(__name__)


def run_server(
    engine: Engine,
    writer: Engine,
    host: str,
    port: int,
    access: Access,
    beside: Callable[[Keeper], Coroutine[None, None, None]] | None = None,
) -> None:
    """Serve the pages until SIGINT or SIGTERM, and write their address to standard output.

    ``beside`` is a task that shares the snapshot: the watch.

    Raises
    ------
    ConfigError
        If nothing can listen there.
    DatabaseError
        If the database cannot be read.
    """
    os.nice(_NICE)
    keeper = Keeper(DatabaseSource(engine))
    keeper.refresh()
    with closing_socket(host, port) as listener:
        where = address_of(listener)
        sys.stdout.write(f"{where}  {len(keeper.snapshot.vehicles)} vehicles of {place_of(engine)}; ends with Ctrl-C\n")
        sys.stdout.flush()
        sources = Sources(engine=engine, keeper=keeper, access=access, writer=writer if access.proxy else None)
        asyncio.run(_serve_until_stopped(sources, listener, None if beside is None else beside(keeper)))


async def show(metrics: ServerAddress | None, keeper: Keeper) -> None:
    """Serve the metrics of the snapshot until cancelled."""
    with metrics_served(metrics, lambda: fleet_families(keeper)):
        await asyncio.Event().wait()


@contextmanager
def closing_socket(host: str, port: int) -> Iterator[socket.socket]:
    """Yield a socket that listens; raises ConfigError if it cannot."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # Only where the protocol is named does asyncio send small answers at once, not 40 ms later.
    with socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)  # connections inherit it
        try:
            listener.bind((host, port))
            listener.listen(_BACKLOG)
        except OSError as exc:
            raise BackendConfigError(f"cannot listen at {host}:{port}: {exc.strerror}") from exc
        yield listener


def address_of(listener: socket.socket) -> str:
    """Return where a browser finds a server that listens."""
    host, port = listener.getsockname()[:2]
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def server_of(sources: Sources) -> uvicorn.Server:
    """Return a server of the pages; ``serve`` runs it until its ``should_exit`` is set."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        anyio.to_thread.current_default_thread_limiter().total_tokens = _THREADS
        tasks = [asyncio.create_task(work) for work in (sources.keeper.run(), sources.keeper.work())]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    config = uvicorn.Config(
        application(sources, routes(), lifespan),
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_GRACE_S,
        http=ReaderInTime,
        limit_concurrency=MOST_CONNECTIONS,
        ws="none",
    )
    return _Server(config)


class ReaderInTime(H11Protocol):
    """A connection that is closed unless its reader asks and reads.

    The head of each request arrives within `HEADERS_S`, and `STALLED_S` do not pass twice without a byte that leaves.
    """

    _timer: asyncio.TimerHandle | None = None
    _watch: asyncio.TimerHandle | None = None
    _resumed_count = 0  # how often the reader has taken so much that there was room for more
    _unsent: tuple[int, int] | None = None  # bytes, and the count above, when it was looked last

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the class has it
        super().connection_made(transport)
        self._start_timer()
        self._look()

    def resume_writing(self) -> None:
        """Note that the reader reads."""
        super().resume_writing()
        self._resumed_count += 1

    def _look(self) -> None:
        """End a connection of which nothing left since the last look; bytes behind an answer's end count, too."""
        unsent = self.transport.get_write_buffer_size(), self._resumed_count
        if unsent[0] and unsent == self._unsent:
            self.transport.abort()
            return
        self._unsent = unsent
        self._watch = self.loop.call_later(STALLED_S, self._look)

    def data_received(self, data: bytes) -> None:
        """Stop the timer once a head is whole; bytes of a body start none."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_timer()
        elif self._timer is None:
            self._start_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_timer()
        if self._watch is not None:
            self._watch.cancel()
        super().connection_lost(exc)

    def _start_timer(self) -> None:
        self._timer = self.loop.call_later(HEADERS_S, self.transport.abort)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class _Server(uvicorn.Server):
    """A server without signal handlers of its own: `stopping` has them, and the exit status stays 0."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def _serve_until_stopped(
    sources: Sources, listener: socket.socket, beside: Coroutine[None, None, None] | None
) -> None:
    server = server_of(sources)

    def stop() -> None:
        server.should_exit = True

    task = None if beside is None else asyncio.create_task(beside)
    if task is not None:
        task.add_done_callback(lambda _: stop())  # neither goes on without the other
    with stopping(stop):
        await server.serve(sockets=[listener])
    if task is not None:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    _LOG.info("ended")
