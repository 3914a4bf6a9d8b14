"""The first moments of a program: Ctrl-C while it is still loading ends it without a word."""

import os
import signal
from importlib import import_module
from typing import Final

STATUS_INTERRUPTED: Final = 130


def run_program(module: str) -> int:
    """Load the command line of a program, run its ``main`` and return the exit status."""
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(STATUS_INTERRUPTED))
    program = import_module(module)
    signal.signal(signal.SIGINT, before)
    from click import Abort  # noqa: PLC0415 - loading it takes a while, in which Ctrl-C must already be heeded

    try:
        return int(program.main())
    except (KeyboardInterrupt, Abort):
        return STATUS_INTERRUPTED
    finally:  # one that comes while the interpreter winds down must not change the status
        signal.signal(signal.SIGINT, signal.SIG_IGN)
