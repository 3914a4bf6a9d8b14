"""Standard output: a reader who hangs up, as ``head`` does, is no error; a full disk is one. Loads next to nothing."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def standard_output() -> Iterator[None]:
    """End in peace when nobody reads on, and have all written when the block ends.

    What the encoding does not have, a part of a file's name perhaps, is written as an escape.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        yield
        _write_out()
    except BrokenPipeError:
        discard()
    except OSError:
        with suppress(OSError):
            _write_out()
        raise


def discard() -> None:
    """Send to nowhere what is still buffered; the interpreter would complain of it when it ends."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _write_out() -> None:
    try:
        if sys.stdout is not None:  # as it is where it was closed from outside
            sys.stdout.flush()
    except OSError:
        discard()
        raise
