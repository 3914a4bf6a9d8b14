"""Files that programs keep: for their owner only, locked, whole or as they were, touched as signs of life."""

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
    """Raise OSError, ``strerror`` in words, of what is not to be read whole: missing, too large, or no plain file."""
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


@contextmanager
def until_whole(path: Path) -> Iterator[Path]:
    """Give the place where a file is written: one that is there stays until the new one is whole, half a one goes.

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
    """Make the file, from 1970: nothing has been done yet; raises OSError."""
    path.touch()
    os.utime(path, (0.0, 0.0))


def give_sign(path: Path) -> None:
    """Touch the file: something was done just now."""
    with suppress(OSError):  # a file that cannot be touched any more grows old, which says enough
        path.touch()
