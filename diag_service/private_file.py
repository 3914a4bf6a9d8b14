"""Files that hold results: for the eyes of their owner only."""

import logging
import os
from pathlib import Path
from typing import Final

PRIVATE_MODE: Final = 0o600
_OTHERS: Final = 0o077  # permission bits of group and world
_COMPANIONS: Final = ("", "-wal", "-shm", "-journal")  # what SQLite puts beside a database
_LOG: Final = logging.getLogger(__name__)


def create_private(path: Path) -> None:
    """Make an empty file for its owner only, unless there is one; SQLite gives its mode to what it puts beside it."""
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, PRIVATE_MODE))


def keep_private(path: Path) -> None:
    """Close a file, and what SQLite put beside it, to others, and say so; where that is not ours to do, warn."""
    for file in (path.with_name(path.name + suffix) for suffix in _COMPANIONS):
        try:
            mode = file.stat().st_mode & 0o777
        except OSError:
            continue
        if not mode & _OTHERS:
            continue
        try:
            file.chmod(PRIVATE_MODE)
        except OSError as exc:
            _LOG.warning("%s can be read by other users (mode %03o): %s", file, mode, exc.strerror)
        else:
            _LOG.warning("%s could be read by other users (mode %03o) and is closed to them now", file, mode)
