"""Who works: processes here or a cluster of Dask; either hands rows back and tells which logs were lost."""

import asyncio
import itertools
import logging
import socket
import ssl
import time
import uuid
from collections.abc import Awaitable, Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Final, Protocol, Self
from urllib.parse import urlsplit

from canlog.extras import load_extra
from diag_service.batch.worker import leave_to_parent
from diag_service.errors import ConfigError, StoreError
from diag_service.lake.parts import LogRow
from diag_service.lake.work import Job, LakeLog, make_in_worker
from diag_service.service.stopping import Trigger
from fleet_link import AddressError, TlsFiles

SCHEME: Final = "tls"
DEFAULT_PORT: Final = 8786
FREE_PORT: Final = "127.0.0.1", 0
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
        raise ConfigError("a cluster needs --ca, --cert and --key (docs/mqtt.md tells how to make them)")
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

    def started() -> Any:  # noqa: ANN401 - an untyped library
        return distributed.Scheduler(
            host=host,
            port=port,
            protocol=SCHEME,
            security=security(tls),
            dashboard_address="{}:{}".format(*(page or FREE_PORT)),
            allowed_failures=ALLOWED_FAILURES,
        )

    _run([started], stop)


def run_workers(address: ClusterAddress, host: str, jobs: int, memory_limit_mib: int | None, stop: Trigger) -> None:
    """Run workers, each a process that a guardian starts again when it dies, until told to stop.

    A process that takes more than its part of the memory is ended by its guardian.

    Raises ConfigError if a file cannot be used or the scheduler is not to be trusted, StoreError if there is none.
    """
    address.check()
    distributed = load_distributed()

    def started() -> Any:  # noqa: ANN401 - an untyped library
        return distributed.Nanny(
            address.url,
            nthreads=1,
            host=host,
            protocol=SCHEME,
            security=security(address.tls),
            dashboard_address="{}:{}".format(*FREE_PORT),
            silence_logs=logging.WARNING,
            memory_limit="auto" if memory_limit_mib is None else memory_limit_mib * MIB,
        )

    _run([started] * jobs, stop)


def _run(makers: list[Callable[[], Any]], stop: Trigger) -> None:
    load_extra("dask.config", "a cluster needs Dask", "cluster").set(QUIET)
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


POLL_S: Final = 0.05  # every process has its next log already
COUNT_EVERY_S: Final = 1.0  # workers come and go slowly, and asking takes the scheduler as long as a log takes it
ANSWER_TIMEOUT_S: Final = 30.0
PATIENCE_S: Final = 120.0  # how long a scheduler, or all workers, may be gone
CLOSE_TIMEOUT_S: Final = 5.0
CONNECT_S: Final = 10.0
RETRY_S: Final = 0.5
_PENDING, _FINISHED, _ERROR = "pending", "finished", "error"  # how Dask calls the states of a future
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a log that was handed out; with neither row, blame nor error the connection was lost."""

    log: LakeLog
    row: LogRow | None = None
    is_blamed: bool = False  # its process died while it, or one beside it, was made
    error: StoreError | None = None  # the lake, or where the log is, did not do what was asked


class Pool(Protocol):
    """Workers that analyse logs, each one log at a time."""

    @property
    def width(self) -> int:
        """How many logs are worked at beside each other; at least 1."""

    def submit(self, log: LakeLog, attempts: int) -> None:
        """Hand out a log."""

    def finished(self, timeout_s: float) -> Sequence[Outcome]:
        """Return what was finished since the last time, after at most this time [s].

        Raises what ``Maker.make`` raises, and StoreError if there are no workers any more.
        """

    def withdraw(self) -> Sequence[LakeLog]:
        """Take back what nobody has begun."""

    def close(self) -> None:
        """Let the workers go."""


class LocalPool:
    """Processes of this machine."""

    def __init__(self, job: Job, jobs: int, *, is_shown: bool) -> None:
        self._job = job
        self._jobs = jobs
        self._is_shown = is_shown
        self._executor = self._started()
        self._running: dict[Future[LogRow], LakeLog] = {}

    @property
    def width(self) -> int:
        return self._jobs

    def close(self) -> None:
        """End the processes when they have done what they began."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def submit(self, log: LakeLog, attempts: int) -> None:
        try:
            future = self._executor.submit(make_in_worker, self._job, log, attempts)
        except BrokenProcessPool:
            self._executor = self._started()  # what was lost is told by its own futures
            future = self._executor.submit(make_in_worker, self._job, log, attempts)
        self._running[future] = log

    def finished(self, timeout_s: float) -> Sequence[Outcome]:
        done, _ = wait(self._running, timeout_s, FIRST_COMPLETED)
        return list(self._outcomes(done))

    def withdraw(self) -> Sequence[LakeLog]:
        taken = [future for future in self._running if future.cancel()]
        return [self._running.pop(future) for future in taken]

    def _outcomes(self, done: set[Future[LogRow]]) -> Iterator[Outcome]:
        for future in done:
            log = self._running.pop(future)
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                yield Outcome(log=log, is_blamed=True)
            elif isinstance(error, StoreError):
                yield Outcome(log=log, error=error)
            else:
                yield Outcome(log=log, row=future.result())

    def _started(self) -> ProcessPoolExecutor:
        context = get_context("spawn")  # threads and compiled code do not survive a fork
        return ProcessPoolExecutor(self._jobs, context, leave_to_parent, (self._is_shown,))


class ClusterPool:
    """The workers of a scheduler.

    Raises
    ------
    StoreError
        If there is no scheduler, or none that has workers, for ``patience_s``.
    ConfigError
        If it is not to be trusted.
    """

    def __init__(self, job: Job, address: ClusterAddress, *, patience_s: float = PATIENCE_S) -> None:
        self._job = job
        self._address = address
        self._patience_s = patience_s
        self._distributed = load_distributed()
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what a run needs to know of it is told by us
        self._running: dict[Any, LakeLog] = {}
        self._names = (f"log-{uuid.uuid4().hex}-{number}" for number in itertools.count())
        self._seen_s = time.monotonic()
        self._worker_count = 0
        self._count_due_s = self._seen_s
        self._client = self._connected()

    @property
    def width(self) -> int:
        """How many logs are worked at beside each other: one per process."""
        self._look_for_workers()
        return max(1, self._worker_count)

    def close(self) -> None:
        """Leave the cluster; what nobody waits for any more it forgets."""
        with suppress(OSError, TimeoutError):  # from a scheduler that is gone there is nothing to take leave of
            self._client.close(timeout=CLOSE_TIMEOUT_S)

    def submit(self, log: LakeLog, attempts: int) -> None:
        future = self._client.submit(make_in_worker, self._job, log, attempts, key=next(self._names), pure=False)
        self._running[future] = log

    def finished(self, timeout_s: float) -> Sequence[Outcome]:
        """Return what was finished since the last time, after at most this time [s]; all is lost with a scheduler."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            if self._client.status != "running":
                return self._begun_anew()
            if done := [future for future in self._running if future.status != _PENDING]:
                return [self._outcome(future) for future in done]
            if time.monotonic() >= deadline_s:
                self._look_for_workers()
                return []
            time.sleep(POLL_S)

    def withdraw(self) -> Sequence[LakeLog]:
        """Take everything back: what is being worked at makes parts that are made again later, under the same names."""
        with suppress(OSError, TimeoutError):
            self._client.cancel(list(self._running), force=True)
        logs = list(self._running.values())
        self._running.clear()
        return logs

    def _outcome(self, future: Any) -> Outcome:  # noqa: ANN401 - an untyped library
        log = self._running.pop(future)
        distributed = self._distributed
        if future.status == _FINISHED:
            try:
                return Outcome(log=log, row=future.result(timeout=ANSWER_TIMEOUT_S))
            except (OSError, TimeoutError, distributed.client.FutureCancelledError):
                return Outcome(log=log)  # it was at a worker or a scheduler that is gone
        if future.status != _ERROR:
            return Outcome(log=log)
        error = future.exception(timeout=ANSWER_TIMEOUT_S)
        if isinstance(error, distributed.KilledWorker):
            return Outcome(log=log, is_blamed=True)
        if isinstance(error, StoreError):
            return Outcome(log=log, error=error)
        if isinstance(error, ConfigError):
            raise error
        raise ConfigError(f"a worker cannot do this work: {type(error).__name__}: {error}")

    def _begun_anew(self) -> Sequence[Outcome]:
        """Return everything that was handed out as lost, once there is a scheduler again."""
        _LOG.warning("the scheduler is gone; waiting for it")
        lost = [Outcome(log=log) for log in self._running.values()]
        self._running.clear()
        self.close()
        self._client = self._connected()
        return lost

    def _connected(self) -> Any:  # noqa: ANN401 - an untyped library
        deadline_s = time.monotonic() + self._patience_s
        while True:
            try:
                self._address.check()
                return self._distributed.Client(
                    self._address.url, security=security(self._address.tls), set_as_default=False, timeout=CONNECT_S
                )
            except (OSError, StoreError) as exc:
                if time.monotonic() >= deadline_s:
                    raise StoreError(f"{exc}; run the same command again to continue") from exc
                time.sleep(RETRY_S)

    def _look_for_workers(self) -> None:
        """Count the workers, not too often; raises StoreError if there has been none for long."""
        if self._worker_count and time.monotonic() < self._count_due_s:
            return
        self._count_due_s = time.monotonic() + COUNT_EVERY_S
        with suppress(OSError, TimeoutError):  # the state of the client tells of a scheduler that is gone
            self._worker_count = len(self._client.nthreads())
        if self._worker_count:
            self._seen_s = time.monotonic()
        elif time.monotonic() - self._seen_s > self._patience_s:
            raise StoreError(f"{self._address.url} has no worker; run the same command again when it has one")
