"""Files: opened without waiting for a writer, written whole or not at all; how much waits in a pipe."""

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from io import BufferedReader, FileIO
from itertools import count
from pathlib import Path
from typing import Final

# Opens a named pipe without waiting for its writer (POSIX).
_AT_ONCE: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
MAX_FILE_BYTES: Final = 4 * 2**20  # far above any description of a bus, settings file or scenario


def read_small_file(path: Path, most_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Return what a plain file, or one that a link leads to, holds.

    Raises OSError if it is missing, unreadable, too large or of another kind; ``strerror`` says so in words.
    """
    with BufferedReader(open_plain_file(path)) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it is too large (more than {most_bytes / 2**20:g} MiB)", str(path))
    return content


def open_plain_file(path: Path) -> FileIO:
    """Return a plain file, opened for reading; raises as ``read_small_file``, and never waits, whatever the name is."""
    try:
        file = FileIO(str(path), "rb", opener=lambda name, flags: os.open(name, flags | _AT_ONCE))
    except OSError as error:
        if error.errno == errno.ENXIO:  # a socket, or a device without anything behind it
            _check_kind(path, path.stat())
        raise
    try:
        _check_kind(path, os.fstat(file.fileno()))
    except OSError:
        file.close()
        raise
    return file


def is_folder(path: Path) -> bool:
    """Return whether there is a folder; what this user may not look at is none: whoever opens it hears why."""
    return stat.S_ISDIR(_mode_of(path))


def is_plain_file(path: Path) -> bool:
    """Return whether there is a plain file, as ``is_folder`` does."""
    return stat.S_ISREG(_mode_of(path))


def is_there(path: Path) -> bool:
    """Return whether there is something, as ``is_folder`` does."""
    return bool(_mode_of(path))


def _mode_of(path: Path) -> int:
    try:
        return path.stat().st_mode
    except (OSError, ValueError):  # a name that no file can have
        return 0


def _check_kind(path: Path, status: os.stat_result) -> None:
    mode = status.st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    is_null = stat.S_ISCHR(mode) and status.st_rdev == _null_device()  # an empty file, by custom
    if stat.S_ISREG(mode) or is_null:
        return
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"
    raise OSError(errno.EINVAL, f"it is {kind}, not a plain file", str(path))


@cache
def _null_device() -> int:
    """Return the number of the null device, which systems choose for themselves."""
    try:
        return Path(os.devnull).stat().st_rdev
    except OSError:
        return -1


_LONGEST_NAME: Final = 50  # characters of up to four bytes; the name of a file has 255 bytes at most
_NUMBERS: Final = count(1)  # threads may write the same file at the same time


@contextmanager
def replacing(path: Path, error: Callable[[str], Exception]) -> Iterator[Path]:
    """Give the name under which a file is written until it is complete; at the end nothing of that name is left.

    Whoever has written all of it lets it take its place: ``part.replace(path)``. Until then the file that was there
    stays as it is.

    Parameters
    ----------
    path
        The file.
    error
        Makes the error that is raised in place of an OSError, from its text.
    """
    part = path.parent / f".{path.name[:_LONGEST_NAME]}.{os.getpid()}-{next(_NUMBERS)}.part"
    try:
        yield part
    except OSError as exc:
        raise error(f"cannot write {path}: {exc.strerror or exc}") from exc
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


WIDE_BYTES: Final = 1024 * 1024  # as a rule a system lets a pipe grow so far


def widen(descriptor: int) -> None:
    """Let a pipe hold `WIDE_BYTES`, where the system is Linux, so that its ends hand over less often."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl  # noqa: PLC0415 - of POSIX

        fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, WIDE_BYTES)
