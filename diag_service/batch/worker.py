"""Work that is shared out among processes, which do not outlive their parent; theirs is one drive at a time."""

import hashlib
import logging
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from canlog.errors import SourceError
from clutch_results.records import ShiftResult, shift_record
from diag_service.batch.drives import DriveLogs
from diag_service.batch.tables import Entry
from diag_service.console import collected_notices, set_up_notices
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.summary import summary_record, unjudged, with_revisions
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import Interpretation
from diag_service.service.drive import stream_of
from diag_service.service.recorded import RecordedRun, run_recorded
from diag_service.service.session import versions_for
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.options import as_proposed
from diag_service.stopping import Trigger, ignore
from fleet_contract import JsonObject

POLL_S: Final = 0.2  # how soon a request to stop is heard
WAITING_PER_JOB: Final = 2  # tasks handed out ahead: a worker never waits, a stop never takes long
DEADLY: Final = "its process died, also with nothing beside it: out of memory?"
Task = TypeVar("Task")
Result = TypeVar("Result")


def progress_bar(*, is_shown: bool) -> Progress:
    """Return a bar on standard error: drives, bytes per second, time left; nothing where nobody watches."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[done]}/{task.fields[of]} drives"),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not is_shown or not console.is_terminal,
    )


def job_count(asked: int | None) -> int:
    """Return how many processes shall work at a time, by default one per core; raises ConfigError below 1."""
    if asked is not None and asked < 1:
        raise ConfigError(f"--jobs must be at least 1, got {asked}")
    return asked or os.cpu_count() or 1


def leave_to_parent(is_shown: bool) -> None:  # noqa: FBT001 - a pool hands arguments over by place
    """Prepare a process: it ignores Ctrl-C, ends with its parent, and shows warnings if ``is_shown``."""
    ignore(signal.SIGINT)
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    if is_shown:
        set_up_notices(0)
    logging.getLogger("diag_service").setLevel(logging.WARNING)  # what is only notable the parent has said


def run_in_processes(
    work: Callable[[Task], Result], tasks: Sequence[Task], jobs: int, stop: Trigger, *, is_shown: bool
) -> Iterator[tuple[Task, Future[Result]]]:
    """Yield tasks as they are done, in no order; when told to stop, those that were begun.

    A task whose process died is done again alone: a future has BrokenProcessPool only if it ended that process, too.
    ``is_shown``: processes show what they warn of.
    """
    waiting, suspects = deque(tasks), deque[Task]()
    context = get_context("spawn")  # threads and compiled code do not survive a fork
    while (waiting or suspects) and not stop.is_set:
        is_alone = not waiting
        source, width = (suspects, 1) if is_alone else (waiting, min(jobs, len(waiting)))
        most = 1 if is_alone else WAITING_PER_JOB * width
        with ProcessPoolExecutor(width, context, leave_to_parent, (is_shown,)) as pool:
            for task, future in run_in_pool(pool, work, source, most, stop):
                if not isinstance(future.exception(), BrokenProcessPool) or (is_alone and not stop.is_set):
                    yield task, future
                elif not stop.is_set:  # else the signal went to the whole group: the task is not done
                    suspects.append(task)


def run_in_pool(
    pool: Executor, work: Callable[[Task], Result], waiting: deque[Task], most: int, stop: Trigger
) -> Iterator[tuple[Task, Future[Result]]]:
    """Yield tasks that a pool has done, with at most so many at it, until it breaks or is told to stop."""
    running, is_broken = dict[Future[Result], Task](), False
    while running or (waiting and not is_broken and not stop.is_set):
        while waiting and not is_broken and not stop.is_set and len(running) < most:
            try:
                running[pool.submit(work, waiting[0])] = waiting[0]
                waiting.popleft()
            except BrokenProcessPool:
                is_broken = True
        if stop.is_set:
            running = {future: task for future, task in running.items() if not future.cancel()}
        for future in wait(running, POLL_S, FIRST_COMPLETED).done:
            is_broken |= not future.cancelled() and isinstance(future.exception(), BrokenProcessPool)
            yield running.pop(future), future


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


ACCOUNT_VERSION = "4"  # of what a journal keeps of a drive; entries of an older one are made anew
DRIVE_SCHEMA = "clutchdiag/drive/v1"


@dataclass(frozen=True)
class Analyst:
    """Analyses drives by one configuration; database and profile are read once."""

    config: DiagnosisConfig

    @cached_property
    def _meaning(self) -> Interpretation:
        return self.config.interpretation()

    def analyse(self, drive: DriveLogs, stop: Trigger | None = None) -> Entry:
        """Return the account of a drive and its shifts; a log that cannot be read gives the reason instead.

        Whoever sets ``stop`` ends it early, and the account says so.
        """
        config = replace(self.config, vehicle=drive.vehicle or self.config.vehicle)
        reporter, stop = MemoryReporter(), stop or Trigger()
        try:
            with collected_notices() as notices:
                with suppress(StoppedError):  # the run ends at once, and its account says so
                    config = as_proposed(config, drive.paths, lambda: stop.is_set)
                meaning = self._meaning if config.profile is self.config.profile else config.interpretation()
                run = run_recorded(config, drive.paths, None, reporter, stop, meaning=meaning)
        except SourceError as exc:
            return failed_entry(drive, str(exc))
        return drive_entry(drive.key, drive.paths, run, reporter.results, notices)


def drive_entry(
    key: str, paths: Iterable[Path], run: RecordedRun, results: Iterable[ShiftResult], notices: Sequence[str]
) -> Entry:
    """Return what a drive said, as journals and files of results keep it."""
    judged = (unjudged(result, run.summary.gaps) for result in results)  # the last one is taken for the drive's
    shifts = map(shift_record, with_revisions(judged))
    return _entry(key, paths, shifts, stream=run.stream, summary=summary_record(run.summary), notices=list(notices))


def failed_entry(drive: DriveLogs, error: str) -> Entry:
    """Return the account of a drive that could not be analysed."""
    return _entry(drive.key, drive.paths, error=error)


def _entry(key: str, paths: Iterable[Path], shifts: Iterable[JsonObject] = (), **known: object) -> Entry:
    unknown: JsonObject = {"stream": None, "error": None, "summary": None, "notices": []}
    drive = {"schema": DRIVE_SCHEMA, "paths": [str(path) for path in paths], **unknown, **known}
    return Entry(key=key, drive=drive, shifts=tuple(shifts))


def settings_digest(config: DiagnosisConfig) -> str:
    """Return a digest of all that decides about results besides the logs: their files and the versions."""
    versions = versions_for(config.calibration)
    files = stream_of(config.interpretation().files)
    parts = [config.vehicle, versions.algorithm, versions.calibration, files, str(config.is_strict), ACCOUNT_VERSION]
    parts += [config.columns] if config.columns else []
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


_ANALYSTS: list[Analyst] = []  # of this process: one, made with its first drive


def analyse_drive(config: DiagnosisConfig, drive: DriveLogs) -> Entry:
    if not _ANALYSTS:
        _ANALYSTS.append(Analyst(config))
    return _ANALYSTS[0].analyse(drive)
