"""Work that is shared out among processes, which do not outlive their parent."""

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from diag_service.errors import ConfigError
from diag_service.service.stopping import Trigger, ignore

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


def follow_parent() -> None:
    """Prepare a process for work: it leaves Ctrl-C to its parent and does not outlive it."""
    ignore(signal.SIGINT)
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()


def shared_out(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int,
    stop: Trigger,
    begin: Callable[..., None],
    arguments: tuple[object, ...],
) -> Iterator[tuple[Task, Future[Result]]]:
    """Yield tasks as they are done, in no order; when told to stop, those that were begun.

    Each process calls ``begin`` with ``arguments`` before its first task. What died with a process is done again alone;
    a future has BrokenProcessPool only if its task ended that process, too.
    """
    waiting, suspects = deque(tasks), deque[Task]()
    context = get_context("spawn")  # threads and compiled code do not survive a fork
    while (waiting or suspects) and not stop.is_set:
        is_alone = not waiting
        source, width = (suspects, 1) if is_alone else (waiting, min(jobs, len(waiting)))
        most = 1 if is_alone else WAITING_PER_JOB * width
        with ProcessPoolExecutor(width, context, begin, arguments) as pool:
            for task, future in handed_out(pool, work, source, most, stop):
                if not isinstance(future.exception(), BrokenProcessPool) or (is_alone and not stop.is_set):
                    yield task, future
                elif not stop.is_set:  # else the signal went to the whole group: the task is not done
                    suspects.append(task)


def handed_out(
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
