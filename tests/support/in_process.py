"""Runs the service's command line in this process, where a process of its own would add nothing."""

import contextlib
import io
import signal
from pathlib import Path

from diag_service.cli import main
from tests.support.service import Ended


def ended(*words: str | Path) -> Ended:
    """Run a command to its end and return what it left."""
    out, err = io.StringIO(), io.StringIO()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main([str(word) for word in words])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return Ended(status=status, out=out.getvalue(), err=err.getvalue())
