"""Files that are there already: nothing is written over them unless that was asked for."""

from pathlib import Path
from typing import Final

from clutchdiag_io.command_line import Option

FORCE: Final = Option("--force", "write over a file that is there already")


def refusal(*paths: Path | None, is_forced: bool) -> str:
    """Return why these files must not be written; empty if they may be, as devices and pipes always may."""
    there = next((path for path in paths if path is not None and not is_forced and path.is_file()), None)
    return "" if there is None else f"{there} is there already; --force writes over it"


def replacement_refusal(path: Path, *, is_forced: bool) -> str:
    """Return why a new file must not take the place of this one; a device or a pipe would be gone for all others."""
    if path.exists() and not path.is_file():
        return f"{path} is not a plain file and cannot be replaced"
    return refusal(path, is_forced=is_forced)
