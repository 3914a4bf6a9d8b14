"""Files of another user, and programs for whom they are just that, also where the tests run as root."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

IS_ROOT: Final = os.geteuid() == 0
# Without these capabilities root is a user as any other: what others keep to themselves is closed to him.
WRAPPER: Final = ("setpriv", "--bounding-set", "-dac_override,-dac_read_search") if IS_ROOT else ()
_OTHER_USER: Final = 65534


def give_away(path: Path, mode: int) -> None:
    """Let a file or a folder belong to another user, with this mode; others have what the mode gives them.

    Where the tests do not run as root it stays their own, and they get no more than others.
    """
    if IS_ROOT:
        os.chown(path, _OTHER_USER, _OTHER_USER)
    path.chmod(mode if IS_ROOT else (mode & 0o7) * 0o111)


@contextmanager
def given_away(path: Path, mode: int) -> Iterator[Path]:
    """Give a file or a folder away for as long as the block takes."""
    before = path.stat()
    give_away(path, mode)
    try:
        yield path
    finally:
        if IS_ROOT:
            os.chown(path, before.st_uid, before.st_gid)
        path.chmod(before.st_mode & 0o7777)
