"""One process at a time owns a file: by POSIX's locks, or those of Windows."""

import os


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
