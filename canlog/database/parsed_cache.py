"""What came of parsing databases, kept for the next start: the parsing takes a process, a fifth of that start.

Kept are the pickles that ``database_child`` wrote, in the user's cache beside the machine code of kernels, which is
trusted alike. They are used only from a folder that nobody else can write to.
"""

import os
import stat
import sys
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final

import cantools

from canlog.files import replacing

MOST_KEPT: Final = 32
MOST_BYTES: Final = 16 * 2**20  # of one; the largest public databases come to some more
_DIGEST_BYTES: Final = 32
_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


def key_of(text: str, database_format: str, mode: str) -> str:
    """Return what a parsed text is known by: the text, how it is parsed, and all that parses it."""
    digest = sha256(f"{_maker()}\0{database_format}\0{mode}\0".encode())
    digest.update(text.encode(errors="replace"))
    return digest.hexdigest()


def kept(key: str) -> bytes | None:
    """Return what was kept under a key, None if nothing was or if it cannot be trusted."""
    folder = _folder()
    if folder is None:
        return None
    try:
        content = (folder / key).read_bytes()
        if sha256(content[_DIGEST_BYTES:]).digest() != content[:_DIGEST_BYTES]:
            return None
        os.utime(folder / key)  # the oldest are forgotten first
    except OSError:
        return None
    return content[_DIGEST_BYTES:]


def keep(key: str, content: bytes) -> None:
    """Keep what came of a text; where that is not possible, the next start parses it again."""
    folder = _folder()
    if folder is None or len(content) > MOST_BYTES:
        return
    with suppress(OSError), replacing(folder / key, OSError) as part:
        part.write_bytes(sha256(content).digest() + content)
        part.replace(folder / key)
        newest_first = sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime_ns)
        for path in newest_first[MOST_KEPT:]:
            path.unlink(missing_ok=True)


def _folder() -> Path | None:
    """Return the folder, made if need be; None where there is none that is this user's alone."""
    if not hasattr(os, "geteuid"):
        return None
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clutchdiag" / "databases"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except (OSError, RuntimeError):  # no home, no rights, something else in the way
        return None
    is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & _OTHERS_WRITE
    return folder if is_own else None


@cache
def _maker() -> str:
    """Return what parses: our modules, cantools, Python."""
    digest = sha256()
    for module in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(module.read_bytes())
    return f"{digest.hexdigest()} {cantools.__version__} {sys.version}"
