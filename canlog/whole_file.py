"""Files that are written whole or not at all: under another name until they are complete."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Final

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
        Makes the error that is raised in place of an OSError, from what is to be told.
    """
    part = path.parent / f".{path.name[:_LONGEST_NAME]}.{os.getpid()}-{next(_NUMBERS)}.part"
    try:
        yield part
    except OSError as exc:
        raise error(f"cannot write {path}: {exc.strerror or exc}") from exc
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
