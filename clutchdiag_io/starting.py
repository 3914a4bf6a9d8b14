"""The first and last moments of a program: a signal ends it without a word."""

import os
import signal
import sys
from collections.abc import Collection
from importlib import import_module
from typing import Final

from clutchdiag_io.kernel_cache import choose_kernel_cache

STATUS_STOPPED: Final = 0
STATUS_INTERRUPTED: Final = 130


def run_program(module: str, services: Collection[str] = ()) -> int:
    """Load the command line of a program, run its ``main`` and return the exit status.

    Parameters
    ----------
    services :
        First words of commands whose usual end is a signal: SIGINT and SIGTERM end them with 0, at once before and
        after they heed signals themselves.
    """
    is_service = not {*sys.argv[1:2]}.isdisjoint(services)
    status = STATUS_STOPPED if is_service else STATUS_INTERRUPTED
    numbers = (signal.SIGINT, signal.SIGTERM) if is_service else (signal.SIGINT,)
    before, *_ = [signal.signal(number, lambda *_: os._exit(status)) for number in numbers]
    choose_kernel_cache()
    program = import_module(module)
    if not is_service:
        signal.signal(signal.SIGINT, before)
    from click import Abort  # noqa: PLC0415 - loading it takes a while, in which Ctrl-C must already be heeded

    try:
        return int(program.main())
    except (KeyboardInterrupt, Abort):
        return STATUS_INTERRUPTED
    finally:  # one that comes while the interpreter winds down must not change the status
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)
