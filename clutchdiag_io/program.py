"""What all programs do about themselves: standard output, errors, files for their owner, what attaches to them."""

import io
import logging
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
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


PRIVATE_MODE: Final = 0o600
# What a system does not know it does without: Windows has no O_CLOEXEC, POSIX no O_BINARY.
OPEN_FLAGS: Final = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_OTHERS: Final = 0o077  # permission bits of group and world
_COMPANIONS: Final = ("", "-wal", "-shm", "-journal")  # what SQLite puts beside a database
_LOG: Final = logging.getLogger(__name__)


def create_private(path: Path) -> None:
    """Make an empty file for its owner only, unless there is one; SQLite gives its mode to what it puts beside it."""
    with suppress(FileExistsError):
        os.close(os.open(path, OPEN_FLAGS | os.O_EXCL, PRIVATE_MODE))


def keep_private(path: Path) -> None:
    """Close a file, and what SQLite put beside it, to others, and say so once; where that is not ours to do, warn.

    A file that its owner made read-only is left as it is: nobody keeps results in it.
    """
    if os.name == "nt":  # there the mode of a file says nothing of others
        return
    told: list[str] = []
    for file in (path.with_name(path.name + suffix) for suffix in _COMPANIONS):
        try:
            mode = file.stat().st_mode & 0o777
        except OSError:
            continue
        if not mode & _OTHERS or not mode & stat.S_IWUSR:
            continue
        try:
            file.chmod(mode & ~_OTHERS)
        except OSError as exc:
            told.append(f"{file} can be read by other users (mode {mode:03o}): {exc.strerror}")
        else:
            told.append(f"{file} could be read by other users (mode {mode:03o}) and is closed to them now")
    if told:
        _LOG.warning("%s", told[0])


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed; raises BlockingIOError if another process has it, OSError else."""
    try:
        import fcntl  # noqa: PLC0415 - of POSIX
    except ImportError:
        _lock_first_byte(descriptor)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _lock_first_byte(descriptor: int) -> None:
    try:
        import msvcrt  # noqa: PLC0415 - of Windows
    except ImportError:  # neither of both: files cannot be locked here
        return
    os.lseek(descriptor, 0, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]  # where it exists
    except OSError as exc:
        raise BlockingIOError(exc.errno, exc.strerror) from exc


def refusal(*paths: Path | None, is_forced: bool) -> str:
    """Return why these files must not be written; empty if they may be, as devices and pipes always may."""
    there = next((path for path in paths if path is not None and not is_forced and path.is_file()), None)
    return "" if there is None else f"{there} is there already; --force writes over it"


def replacement_refusal(path: Path, *, is_forced: bool) -> str:
    """Return why a new file must not take the place of this one; a device or a pipe would be gone for all others."""
    if path.exists() and not path.is_file():
        return f"{path} is not a plain file and cannot be replaced"
    return refusal(path, is_forced=is_forced)


def make_sign(path: Path) -> None:
    """Make the file, from 1970: nothing has been done yet; raises OSError."""
    path.touch()
    os.utime(path, (0.0, 0.0))


def give_sign(path: Path) -> None:
    """Touch the file: something was done just now."""
    with suppress(OSError):  # a file that cannot be touched any more grows old, which says enough
        path.touch()


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


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    return {one.name: one for one in sorted(entry_points(group=group), key=lambda one: one.name)}


def attached(group: str) -> list[Any]:
    """Return all that attaches to a group, in order of name."""
    return [one.load() for one in _found(group).values()]


def is_attached(group: str, name: str) -> bool:
    return name in _found(group)


def part(group: str, name: str) -> Any:  # noqa: ANN401 - whatever is attached there
    """Return what attaches to a group by this name; raises LookupError if nothing does."""
    if not is_attached(group, name):
        raise LookupError(f"no installed package provides {name} for {group}: install clutchdiag anew")
    return _found(group)[name].load()
