"""Standard output: a reader who hangs up, as ``head`` does, is no error; a full disk is one."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def standard_output() -> Iterator[None]:
    """End in peace when nobody reads on, and have all written when the block ends.

    What the encoding does not have is written as an escape instead of ending the program.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        yield
        _write_out()
    except BrokenPipeError:
        _discard()
    except OSError:
        with suppress(OSError):
            _write_out()
        raise


def _write_out() -> None:
    try:
        if sys.stdout is not None:  # as it is where it was closed from outside
            sys.stdout.flush()
    except OSError:
        _discard()
        raise


def _discard() -> None:
    """Send to nowhere what is still buffered; the interpreter would complain of it when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
