"""Scheduler and workers of a cluster as programs of their own: TLS only, and on this machine unless told otherwise."""

import asyncio
import logging
import os
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any, Final

from canlog.extras import load_extra
from diag_service.errors import StoreError
from diag_service.lake.links import LOOPBACK, SCHEME, ClusterAddress, check_identity, load_distributed, security
from diag_service.service.stopping import Trigger
from fleet_link import TlsFiles

ALLOWED_FAILURES: Final = 1  # deaths beyond it are told to the run, which tries such a log alone
MIB: Final = 1 << 20
QUIET: Final = {  # by itself Dask looks at itself many times a second, which takes a twelfth of a core all day
    "distributed.worker.profile.enabled": False,  # what a worker is doing, for a page that few open
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.worker-saturation": 1.0,  # what waits goes to the worker that is free first
    "distributed.worker.memory.monitor-interval": "500ms",  # of a worker as of its guardian
    # By itself Dask has workers give back memory at once, only to have it mapped anew for the next arrays.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}


def run_scheduler(host: str, port: int, tls: TlsFiles, page: tuple[str, int] | None, stop: Trigger) -> None:
    """Run a scheduler until it is told to stop; ``page`` is where its state is shown, by default on a free port here.

    Raises ConfigError if a file cannot be used, StoreError if it cannot listen.
    """
    check_identity(tls)
    distributed = load_distributed()
    _quieten()

    def started() -> Any:  # noqa: ANN401 - an untyped library
        return distributed.Scheduler(
            host=host,
            port=port,
            protocol=SCHEME,
            security=security(tls),
            dashboard_address=_page_address(page),
            allowed_failures=ALLOWED_FAILURES,
        )

    _run([started], stop)


def run_workers(
    address: ClusterAddress, host: str, jobs: int | None, memory_limit_mib: int | None, stop: Trigger
) -> None:
    """Run workers, each a process that a guardian starts again when it dies, until told to stop.

    A process that takes more than its part of the memory is ended by its guardian.

    Raises ConfigError if a file cannot be used or the scheduler is not to be trusted, StoreError if there is none.
    """
    address.check()
    distributed = load_distributed()
    _quieten()

    def started() -> Any:  # noqa: ANN401 - an untyped library
        return distributed.Nanny(
            address.url,
            nthreads=1,
            host=host,
            protocol=SCHEME,
            security=security(address.tls),
            dashboard_address=_page_address(None),
            silence_logs=logging.WARNING,
            memory_limit="auto" if memory_limit_mib is None else memory_limit_mib * MIB,
        )

    _run([started] * (jobs or os.cpu_count() or 1), stop)


def _quieten() -> None:
    load_extra("dask.config", "a cluster needs Dask", "cluster").set(QUIET)


def _page_address(page: tuple[str, int] | None) -> str:
    host, port = page or (LOOPBACK, 0)
    return f"{host}:{port}"


def _run(makers: list[Callable[[], Any]], stop: Trigger) -> None:
    try:
        asyncio.run(_until(makers, stop))
    except (OSError, TimeoutError, RuntimeError) as exc:  # the last from a guardian whose process did not start
        raise StoreError(f"the cluster's part cannot run: {exc}") from exc


async def _until(makers: list[Callable[[], Any]], stop: Trigger) -> None:
    """Start servers and keep them until one ends or the trigger is set."""
    is_told = asyncio.Event()
    loop = asyncio.get_running_loop()

    def tell() -> None:
        loop.call_soon_threadsafe(is_told.set)

    stop.subscribe(tell)
    async with AsyncExitStack() as stack:
        servers = await asyncio.gather(*(stack.enter_async_context(maker()) for maker in makers))
        ends: list[Awaitable[object]] = [is_told.wait(), *(server.finished() for server in servers)]
        tasks = [asyncio.ensure_future(one) for one in ends]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
