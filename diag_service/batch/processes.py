"""Work that is shared out among processes, which do not outlive their parent."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from diag_service.errors import ConfigError
from diag_service.service.stopping import Trigger, ignore

POLL_S: Final = 0.2  # how soon a request to stop is heard
WAITING_PER_JOB: Final = 2  # tasks handed out ahead: a worker never waits, a stop never takes long
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

    Each process calls ``begin`` with ``arguments`` before its first task.
    """
    if not tasks:
        return
    waiting, running = list(reversed(tasks)), dict[Future[Result], Task]()
    context = get_context("spawn")  # threads and compiled code do not survive a fork
    with ProcessPoolExecutor(min(jobs, len(tasks)), context, begin, arguments) as pool:
        while running or (waiting and not stop.is_set):
            while waiting and not stop.is_set and len(running) < WAITING_PER_JOB * jobs:
                task = waiting.pop()
                running[pool.submit(work, task)] = task
            if stop.is_set:
                running = {future: task for future, task in running.items() if not future.cancel()}
            finished, _ = wait(running, POLL_S, FIRST_COMPLETED)
            for future in finished:
                task = running.pop(future)
                if stop.is_set and isinstance(future.exception(), BrokenProcessPool):
                    continue  # the signal went to the whole group: the task is not done, nothing else is wrong
                yield task, future


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
