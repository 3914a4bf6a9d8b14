"""A file whose age tells whether a program gets its work done: what a container's health check can look at."""

import os
from contextlib import suppress
from pathlib import Path


def make_sign(path: Path) -> None:
    """Make the file, from 1970: nothing has been done yet; raises OSError."""
    path.touch()
    os.utime(path, (0.0, 0.0))


def give_sign(path: Path) -> None:
    """Touch the file: something was done just now."""
    with suppress(OSError):  # a file that cannot be touched any more grows old, which says enough
        path.touch()
