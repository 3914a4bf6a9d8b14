"""Runs the service's command line in this process, where a process of its own would add nothing."""

import contextlib
import io
import logging
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pytest

import diag_service.batch.worker
from diag_service.cli import command_line, main
from diag_service.commands.options import PROGRAM
from diag_service.console import LOGGERS
from diag_service.stopping import Controls, Trigger
from tests.support.service import Ended


def ended(*words: str | Path) -> Ended:
    """Run a command to its end and return what it left."""
    out, err = io.StringIO(), io.StringIO()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    try:
        with never_a_program(), workers_here(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main([str(word) for word in words])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return Ended(status=status, out=out.getvalue(), err=err.getvalue())


class Here(Executor):
    """In place of a pool of processes: this one does a task as soon as it is handed over."""

    def __init__(
        self, _width: int, _context: object, begin: Callable[..., None], arguments: tuple[object, ...]
    ) -> None:
        diag_service.batch.worker._ANALYSTS.clear()  # of the pool before
        begin(*arguments)

    def submit(self, work: Callable[..., Any], /, *tasks: object, **words: object) -> Future[Any]:
        done = Future[Any]()
        try:
            done.set_result(work(*tasks, **words))
        except Exception as exc:  # noqa: BLE001 - whatever it is, it is raised where the result is asked for
            done.set_exception(exc)
        return done


@contextlib.contextmanager
def workers_here() -> Iterator[None]:
    """Let no pool start a process; tests of killed ones run the program as one."""
    worker = diag_service.batch.worker
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "ProcessPoolExecutor", Here)
        patch.setattr(worker, "leave_to_parent", lambda _: None)
        yield


def command(*words: str | Path, stop: Trigger | None = None) -> None:
    """Run a command in this process; what it raises passes, what it prints is the test's."""
    with never_a_program():
        controls = Controls(stop=stop or Trigger())
        command_line.main([str(word) for word in words], PROGRAM, standalone_mode=False, obj=controls)


@contextlib.contextmanager
def never_a_program() -> Iterator[None]:
    """Let our loggers be as in a process in which no command line has run."""
    loggers = [logging.getLogger(name) for name in ("", "can", *LOGGERS, *(f"{name}.compiling" for name in LOGGERS))]
    before = [(logger.handlers, logger.level, logger.propagate) for logger in loggers]
    for logger in loggers[1:]:
        logger.handlers, logger.propagate = [], True
        logger.setLevel(logging.NOTSET)
    try:
        yield
    finally:
        for logger, (handlers, level, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate
            logger.setLevel(level)
        if sys.modules.get("asammdf", ...) is None:  # what the program keeps from itself, other tests may want
            del sys.modules["asammdf"]
