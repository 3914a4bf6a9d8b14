"""Files of programs: private modes, locks, writing whole or not at all, files touched as signs of life."""

import errno
import logging
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

MAX_FILE_BYTES: Final = 4 * 2**20  # far above any certificate or description of a controller
PRIVATE_MODE: Final = 0o600
# What a system does not know it does without: Windows has no O_CLOEXEC, POSIX no O_BINARY.
OPEN_FLAGS: Final = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_OTHERS: Final = 0o077  # permission bits of group and world
_COMPANIONS: Final = ("", "-wal", "-shm", "-journal")  # what SQLite puts beside a database
_LOG: Final = logging.getLogger(__name__)


def check_plain_file(path: Path, most_bytes: int = MAX_FILE_BYTES) -> None:
    """Raise OSError with a legible ``strerror`` if a file is missing, too large to read whole, or no plain file."""
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode) and not path.samefile(os.devnull):
        raise OSError(errno.EINVAL, "it is a pipe, a socket or a device, not a plain file", str(path))
    if status.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it is too large (more than {most_bytes / 2**20:g} MiB)", str(path))


def create_private(path: Path) -> None:
    """Make an empty file for its owner only, unless there is one; SQLite gives its mode to what it puts beside it."""
    with suppress(FileExistsError):
        os.close(os.open(path, OPEN_FLAGS | os.O_EXCL, PRIVATE_MODE))


def keep_private(path: Path) -> None:
    """Remove the permissions of others on a file and on SQLite's files beside it; warn of what was open, or stays so.

    A file that its owner made read-only is left as it is: nobody keeps results in it.
    """
    if os.name == "nt":  # there the mode of a file says nothing of others
        return
    warnings: list[str] = []
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
            warnings.append(f"{file} can be read by other users (mode {mode:03o}): {exc.strerror}")
        else:
            warnings.append(f"{file} could be read by other users (mode {mode:03o}) and is closed to them now")
    if warnings:
        _LOG.warning("%s", warnings[0])


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed, where the system is POSIX.

    Raises BlockingIOError if another process has it, OSError else.
    """
    with suppress(ImportError):
        import fcntl  # noqa: PLC0415 - of POSIX

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def until_whole(path: Path) -> Iterator[Path]:
    """Yield the path to write to: an existing file is replaced when the new one is complete, an incomplete one removed.

    A device, a pipe or a link is written itself.
    """
    is_new, is_replaced = not path.exists(), path.is_file() and not path.is_symlink()
    place = path.with_name(f".{path.name}.{os.getpid()}.part") if is_replaced else path
    try:
        yield place
        if is_replaced:
            place.replace(path)
    except BaseException:
        if is_new or is_replaced:
            with suppress(OSError):
                place.unlink(missing_ok=True)
        raise


def make_sign(path: Path) -> None:
    """Create the file with a time of change in 1970, which means that nothing was done yet; raises OSError."""
    path.touch()
    os.utime(path, (0.0, 0.0))


def give_sign(path: Path) -> None:
    """Set the file's time of change to now."""
    with suppress(OSError):  # a file that cannot be touched any more grows old, which says enough
        path.touch()
