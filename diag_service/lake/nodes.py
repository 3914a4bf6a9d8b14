"""Scheduler and workers of a cluster, and connections to them: TLS both ways or none at all."""

import asyncio
import logging
import os
import socket
import ssl
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any, Final, Self
from urllib.parse import urlsplit

from canlog.extras import load_extra
from diag_service.errors import ConfigError, StoreError
from diag_service.service.stopping import Trigger
from fleet_link import AddressError, TlsFiles

SCHEME: Final = "tls"
DEFAULT_PORT: Final = 8786
LOOPBACK: Final = "127.0.0.1"
CONNECT_TIMEOUT_S: Final = 10.0
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


def load_distributed() -> Any:  # noqa: ANN401 - an untyped library
    """Return Dask's ``distributed``; raises ExtraMissingError if it is not installed."""
    return load_extra("distributed", "a cluster needs Dask", "cluster")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterAddress:
    """Where a scheduler is, and who we are to it.

    Whoever reaches a scheduler can have any program run by its workers, so nobody does without a certificate of the
    authority, not even on the same machine.
    """

    host: str
    port: int
    tls: TlsFiles

    @classmethod
    def parse(cls, text: str, tls: TlsFiles) -> Self:
        """Return what ``tls://HOST:PORT`` names; raises ConfigError if it is anything else, or a file is missing."""
        try:
            parts = urlsplit(text)
            host, port = parts.hostname, parts.port
        except ValueError as exc:
            raise ConfigError(f"{text} is not an address of a scheduler: {exc}") from exc
        if parts.scheme != SCHEME:
            raise ConfigError(
                f"{text}: a scheduler is reached by {SCHEME}:// only, because its workers run what they are sent"
            )
        if not host or parts.username or parts.path.strip("/") or parts.query:
            raise ConfigError(f"{text} is not an address of a scheduler, which is {SCHEME}://HOST:PORT")
        check_identity(tls)
        return cls(host=host, port=port or DEFAULT_PORT, tls=tls)

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{SCHEME}://{host}:{self.port}"

    def check(self) -> None:
        """Connect and hang up again.

        Raises StoreError if nobody is there, ConfigError if the one who is there is not who the authority vouches for,
        or does not take us.
        """
        try:
            context = self.tls.context()
            with (
                socket.create_connection((self.host, self.port), CONNECT_TIMEOUT_S) as plain,
                context.wrap_socket(plain, server_hostname=self.host) as secure,
            ):
                secure.recv(1)  # with TLS 1.3 a refused certificate is heard of only here
        except AddressError as exc:
            raise ConfigError(str(exc)) from exc
        except ssl.SSLError as exc:
            raise ConfigError(f"{self.url} is not trusted, or does not trust us: {exc.reason or exc}") from exc
        except OSError as exc:
            raise StoreError(f"no scheduler at {self.url}: {exc.strerror or exc}") from exc


def check_identity(tls: TlsFiles) -> None:
    """Raise ConfigError unless there are an authority, a certificate and its key, and all of them can be used."""
    if tls.authority is None or tls.certificate is None or tls.key is None:
        raise ConfigError("a cluster needs --ca, --cert and --key: fleet-certificates makes them")
    try:
        tls.context()
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc


def security(tls: TlsFiles) -> Any:  # noqa: ANN401 - an untyped library
    """Return the same for Dask, for whatever part it plays: only TLS, both sides with a certificate."""
    certificate, key = str(tls.certificate), str(tls.key)
    return load_distributed().Security(
        require_encryption=True,
        tls_ca_file=str(tls.authority),
        **{f"tls_{part}_cert": certificate for part in ("client", "scheduler", "worker")},
        **{f"tls_{part}_key": key for part in ("client", "scheduler", "worker")},
    )


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
