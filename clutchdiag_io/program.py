"""What all programs do about themselves: threads, standard output, errors in one line, what attaches to them."""

import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final

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


def refusal(*paths: Path | None, is_forced: bool) -> str:
    """Return why these files must not be written; empty if they may be, as devices and pipes always may."""
    given = [path.absolute() for path in paths if path is not None]
    for path in given:
        if given.count(path) > 1 and (path.is_file() or not path.exists()):
            return f"two outputs cannot both be {path}"
    there = next((path for path in paths if path is not None and not is_forced and path.is_file()), None)
    return "" if there is None else f"{there} is there already; --force writes over it"


def replacement_refusal(path: Path, *, is_forced: bool) -> str:
    """Return why a new file must not take the place of this one; a device or a pipe would be gone for all others."""
    if path.exists() and not path.is_file():
        return f"{path} is not a plain file and cannot be replaced"
    return refusal(path, is_forced=is_forced)


def legible(text: str) -> str:
    r"""Return a text with its undecodable bytes as escapes, such as ``log\xe9.log``."""
    try:
        return text.encode(errors="surrogateescape").decode(errors="backslashreplace")
    except UnicodeEncodeError:  # a lone surrogate that stands for no byte
        return text.encode(errors="backslashreplace").decode()


def legible_record(value: object) -> object:
    """Return a record of mappings and lists in which every text is legible."""
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, Mapping):
        return {legible_record(key): legible_record(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [legible_record(one) for one in value]
    return value


def attached(group: str) -> dict[str, Any]:
    """Return what other distributions attach to a group by their entry points, by name."""
    return {entry.name: entry.load() for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)}
