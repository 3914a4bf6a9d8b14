"""What long-running programs of the backend share: an end by signals, and metrics for Prometheus."""

import asyncio
import signal
from collections.abc import Callable, Coroutine, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import Metric

from clutchdiag_io.metrics import Told
from fleet_backend.config import ServerAddress
from fleet_backend.errors import BackendConfigError


@contextmanager
def stopping(stop: Callable[[], object]) -> Iterator[None]:
    """Have SIGINT and SIGTERM call ``stop`` in the running loop, each time; main thread only.

    The loop's own handlers would leave the default behind when it closes, and a signal then kills the process. Here
    what held before holds again.
    """
    loop = asyncio.get_running_loop()

    def handle(_number: int, _frame: FrameType | None) -> None:
        with suppress(RuntimeError):  # the loop is closed: all has ended already
            loop.call_soon_threadsafe(stop)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


async def until_stopped(work: Coroutine[None, None, None]) -> None:
    """Run a coroutine until it ends or SIGINT or SIGTERM comes; main thread only."""
    task = asyncio.ensure_future(work)
    with stopping(task.cancel), suppress(asyncio.CancelledError):
        await task


@contextmanager
def metrics_served(place: ServerAddress | None, families: Callable[[], Iterable[Metric]]) -> Iterator[None]:
    """Serve metrics while entered, where that is asked for; raises ConfigError if nothing can listen there."""
    if place is None:
        yield
        return
    registry = CollectorRegistry()
    registry.register(Told(families))
    try:
        server, thread = start_http_server(place.port, place.host, registry)
    except OSError as exc:
        raise BackendConfigError(f"cannot serve metrics at {place.host}:{place.port}: {exc.strerror}") from exc
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
