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
from fleet_backend.programs import shown_at, stopping

_BACKLOG: Final = 128
_NICE: Final = 5  # who stores results beside us goes first
_THREADS: Final = 6  # that answer at a time: more would wait for each other, and for new connections
HEADERS_S: Final = 10.0  # from the first byte of a request, or the connection, to the end of its head
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
    """Serve the page until SIGINT or SIGTERM; say on standard output where it is.

    What runs ``beside`` shares its view of the fleet.

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
        asyncio.run(_serve_until_told(sources, listener, None if beside is None else beside(keeper)))


async def show(metrics: ServerAddress | None, keeper: Keeper) -> None:
    """Show the metrics of a server that watches nothing, until it is cancelled."""
    with shown_at(metrics, lambda: fleet_families(keeper)):
        await asyncio.Event().wait()


@contextmanager
def closing_socket(host: str, port: int) -> Iterator[socket.socket]:
    """Yield a socket that listens; raises ConfigError if it cannot."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # Only where the protocol is named does asyncio send small answers at once, not 40 ms later.
    with socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
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


async def serve(sources: Sources, listener: socket.socket, *, on_start: Callable[[uvicorn.Server], None]) -> None:
    """Serve until ``should_exit`` of the server, which ``on_start`` is given, is set."""

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
        http=HeadersInTime,
    )
    server = _Server(config)
    on_start(server)
    await server.serve(sockets=[listener])


class HeadersInTime(H11Protocol):
    """A connection that is closed unless the head of each request comes whole in time."""

    _too_late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the class has it
        """Expect a request."""
        super().connection_made(transport)
        self._expect()

    def data_received(self, data: bytes) -> None:
        """Take bytes; those of an earlier request's body do not matter."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._expect_nothing()
        elif self._too_late is None:
            self._expect()

    def connection_lost(self, exc: Exception | None) -> None:
        """Expect nothing more."""
        self._expect_nothing()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._too_late = self.loop.call_later(HEADERS_S, self.transport.abort)

    def _expect_nothing(self) -> None:
        if self._too_late is not None:
            self._too_late.cancel()
            self._too_late = None


class _Server(uvicorn.Server):
    """A server that leaves signals to us: our programs end with status 0 when they are told to stop."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def _serve_until_told(
    sources: Sources, listener: socket.socket, beside: Coroutine[None, None, None] | None
) -> None:
    servers: list[uvicorn.Server] = []

    def stop() -> None:
        for server in servers:
            server.should_exit = True

    task = None if beside is None else asyncio.create_task(beside)
    if task is not None:
        task.add_done_callback(lambda _: stop())  # neither goes on without the other
    with stopping(stop):
        await serve(sources, listener, on_start=servers.append)
    if task is not None:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    _LOG.info("ended")
