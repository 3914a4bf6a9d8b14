"""What all programs do about themselves: one thread for numpy, standard output to its end, an error in one line.

Loads next to nothing.
"""

import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from clutchdiag_io.files import legible

_THREAD_VARIABLES: Final = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
EXIT_UNEXPECTED: Final = 1
Kinds = type[Exception] | tuple[type[Exception], ...]


def reckon_in_one_thread() -> None:
    """Have numpy reckon in one thread, in this process and those it starts, unless the environment says otherwise.

    Its matrices are so small here that threads only wait for each other. It is of use only before numpy is imported.
    Results are the same bit by bit; on a machine with many cores, or with several processes at work, threads take
    processor time and gain none.
    """
    for name in _THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


@contextmanager
def standard_output() -> Iterator[None]:
    """End in peace when nobody reads on, as behind ``head``; have all written when the block ends, or raise OSError.

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


def complain(
    program: str,
    exc: Exception,
    statuses: Sequence[tuple[Kinds, int]],
    *,
    is_verbose: bool = False,
    hint: str = "",
) -> int:
    """Write one line about an error, if asked for also where it came from, and return the exit status.

    Parameters
    ----------
    statuses :
        The errors that may be expected, each with its status; the first that fits holds.
    hint :
        How the user learns more of an unexpected error.
    """
    status = next((code for kinds, code in statuses if isinstance(exc, kinds)), EXIT_UNEXPECTED)
    text = legible(" ".join(str(exc).split()))
    if status == EXIT_UNEXPECTED:
        text = f"unexpected {type(exc).__name__}: {text}{'' if is_verbose else hint}"
    if is_verbose:
        import traceback  # noqa: PLC0415 - needed here only

        traceback.print_exception(exc)
    sys.stderr.write(f"{program}: error: {text}\n")
    return status
