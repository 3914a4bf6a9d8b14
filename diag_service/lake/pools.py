"""Who works: processes of this machine or of a cluster; either hands rows back and tells which logs were lost."""

from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Protocol

from diag_service.batch.worker import leave_to_parent
from diag_service.errors import StoreError
from diag_service.lake.manifest import LogRow
from diag_service.lake.work import Job, LakeLog, make_in_worker


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
        """How many logs are worked at beside each other."""
        return self._jobs

    def close(self) -> None:
        """End the processes when they have done what they began."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def submit(self, log: LakeLog, attempts: int) -> None:
        """Hand out a log."""
        try:
            future = self._executor.submit(make_in_worker, self._job, log, attempts)
        except BrokenProcessPool:
            self._executor = self._started()  # what was lost is told by its own futures
            future = self._executor.submit(make_in_worker, self._job, log, attempts)
        self._running[future] = log

    def finished(self, timeout_s: float) -> Sequence[Outcome]:
        """Return what was finished since the last time, after at most this time [s]."""
        done, _ = wait(self._running, timeout_s, FIRST_COMPLETED)
        return list(self._outcomes(done))

    def withdraw(self) -> Sequence[LakeLog]:
        """Take back what nobody has begun."""
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
