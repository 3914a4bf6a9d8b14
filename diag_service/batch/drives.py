"""Which drives are meant by files and folders."""

import hashlib
import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from diag_service.errors import ConfigError, SourceError
from diag_service.sources import is_log

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The logs of one drive, as they were when they were found."""

    paths: tuple[Path, ...]
    size_bytes: int
    modified_ns: int

    @property
    def name(self) -> str:
        """The drive for people: its log, or the first of them."""
        more = f" and {len(self.paths) - 1} more" if len(self.paths) > 1 else ""
        return f"{self.paths[0]}{more}"

    @property
    def key(self) -> str:
        """What tells this drive from any other, and from an earlier state of its files."""
        parts = (*(str(path.resolve()) for path in self.paths), str(self.size_bytes), str(self.modified_ns))
        return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()


def find_drives(paths: Sequence[Path]) -> list[Drive]:
    """Return the drives that files and folders stand for: the files together one, every log in a folder one.

    Raises
    ------
    ConfigError
        If a folder holds no log, or a log is named twice.
    SourceError
        If a path is not there or cannot be read.
    """
    named = [path for path in paths if not path.is_dir()]
    drives = [drive_of(named)] if named else []
    for folder in paths:
        if folder.is_dir():
            logs = list(_logs_in(folder))
            if not logs:
                raise ConfigError(f"{folder} holds no log that can be read")
            drives += [drive_of([log]) for log in logs]
    files = [path.resolve() for drive in drives for path in drive.paths]
    if twice := {str(path) for path in files if files.count(path) > 1}:
        raise ConfigError(f"named twice: {', '.join(sorted(twice))}")
    return drives


def drive_of(paths: Iterable[Path]) -> Drive:
    """Return the drive that some files are.

    Raises
    ------
    SourceError
        If one is not there.
    """
    files = tuple(paths)
    try:
        stats = [path.stat() for path in files]
    except OSError as exc:
        raise SourceError(f"{exc.filename}: {exc.strerror}") from exc
    return Drive(
        paths=files,
        size_bytes=sum(stat.st_size for stat in stats),
        modified_ns=max(stat.st_mtime_ns for stat in stats),
    )


def _logs_in(folder: Path) -> Iterator[Path]:
    """Yield the logs in a folder and below, by name; other files are left alone."""
    others = 0
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            if is_log(path):
                yield path
            else:
                others += 1
    if others:
        _LOG.info("%s: %d files are no logs", folder, others)
