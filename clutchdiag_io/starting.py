"""The first moments of a program: Ctrl-C while it is loading ends it without a word, a lost library with one."""

import os
import signal
import sys
from importlib import import_module
from typing import Final

STATUS_INTERRUPTED: Final = 130
STATUS_ERROR: Final = 1
PUT_BACK: Final = "pip install --force-reinstall --no-deps clutchdiag"


def run_program(module: str) -> int:
    """Load the command line of a program, run its ``main`` and return the exit status."""
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(STATUS_INTERRUPTED))
    try:
        program = import_module(module)
    except ModuleNotFoundError as exc:
        if (exc.name or "").partition(".")[0] != "canlog":
            raise
        # A wheel of canlog alone, once installed beside this program, took the files of both when it was removed.
        sys.stderr.write(f"error: the library canlog is gone; put it back: {PUT_BACK}\n")
        return STATUS_ERROR
    signal.signal(signal.SIGINT, before)
    from click import Abort  # noqa: PLC0415 - loading it takes a while, in which Ctrl-C must already be heeded

    try:
        return int(program.main())
    except (KeyboardInterrupt, Abort):
        return STATUS_INTERRUPTED
    finally:  # one that comes while the interpreter winds down must not change the status
        signal.signal(signal.SIGINT, signal.SIG_IGN)
