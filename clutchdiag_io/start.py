"""How all programs start and end. This module is light: nobody can heed Ctrl-C before it is loaded."""

import gc
import os
import signal
import sys
from collections.abc import Collection
from importlib import import_module
from typing import Final

# Objects made before it is looked for garbage among them: loading makes hundreds of thousands, and none of it is.
UNCOLLECTED: Final = 50_000
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
    gc.set_threshold(UNCOLLECTED)
    # Loading takes a while, in which Ctrl-C must already be heeded.
    from click import Abort  # noqa: PLC0415 - see above

    from clutchdiag_io.program import choose_kernel_cache  # noqa: PLC0415 - see above

    choose_kernel_cache()
    program = import_module(module)
    try:
        if not is_service:
            signal.signal(signal.SIGINT, before)
        return int(program.main())
    except (KeyboardInterrupt, Abort):
        return STATUS_INTERRUPTED
    finally:
        for number in numbers:  # a signal that comes while the interpreter winds down must not change the status
            signal.signal(number, signal.SIG_IGN)
        gc.freeze()  # or the interpreter looks through all there is, a fifth of the time of a short program
