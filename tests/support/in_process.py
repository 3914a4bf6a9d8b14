"""Runs the service's command line in this process, where a process of its own would add nothing."""

import contextlib
import io
import logging
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from diag_service.cli import main
from diag_service.console import OWN
from tests.support.service import Ended


def ended(*words: str | Path) -> Ended:
    """Run a command to its end and return what it left."""
    out, err = io.StringIO(), io.StringIO()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    try:
        with never_a_program(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main([str(word) for word in words])
    except SystemExit as exc:  # argparse's way to end: --version, a word it does not know
        status = int(exc.code or 0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if sys.modules.get("asammdf", ...) is None:  # what the program keeps from itself, other tests may want
            del sys.modules["asammdf"]
    return Ended(status=status, out=out.getvalue(), err=err.getvalue())


@contextlib.contextmanager
def never_a_program() -> Iterator[None]:
    """Let our loggers be as in a process in which no command line has run."""
    loggers = [logging.getLogger(name) for name in ("", "can", *OWN, *(f"{name}.compiling" for name in OWN))]
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
