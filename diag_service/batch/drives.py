"""Which drives are meant by files and folders."""

import errno
import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from canlog.errors import SourceError
from canlog.files import is_folder
from canlog.logs import looked_at
from diag_service.errors import ConfigError
from diag_service.settings.config import check_vehicle
from fleet_contract import JsonObject


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveLogs:
    """The logs of one drive, as they were when they were found."""

    paths: tuple[Path, ...]
    size_bytes: int
    modified_ns: int
    vehicle: str | None = None  # None: that of the run

    @property
    def name(self) -> str:
        """The drive for people: its log, or the first of them."""
        more = f" and {len(self.paths) - 1} more" if len(self.paths) > 1 else ""
        return f"{self.paths[0]}{more}"

    @property
    def key(self) -> str:
        """What tells this drive from any other, and from an earlier state of its files."""
        files = (str(path.resolve()) for path in self.paths)
        vehicle = () if self.vehicle is None else (self.vehicle,)
        parts = (*files, str(self.size_bytes), str(self.modified_ns), *vehicle)
        return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A file in a folder that is no drive, and why."""

    path: Path
    reason: str


LEFT_OUT_SCHEMA = "clutchdiag/left-out/v1"


def left_out_record(left: LeftOut) -> JsonObject:
    """Return what is told to programs of a file that is no drive."""
    return {"schema": LEFT_OUT_SCHEMA, "path": str(left.path), "reason": left.reason}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognisedLog:
    """A log in a folder, and why it was taken for one."""

    path: Path
    format: str
    evidence: str


def find_drives(
    paths: Sequence[Path], *, has_vehicles: bool = False, columns: str = ""
) -> tuple[list[DriveLogs], list[LeftOut]]:
    """Return the drives that files and folders stand for, and what else is there.

    The files together are one drive, every log in a folder is one.

    With ``has_vehicles`` a log is of the vehicle by which the folder below the named one is called; a log that lies in
    the named one itself is of the vehicle of that name.

    Raises ConfigError if a folder holds no log or bears no name of a vehicle, or a log is named twice.
    Raises SourceError if a path is not there or cannot be read.
    """
    folders = [path for path in paths if is_folder(path)]
    named = [path for path in paths if path not in folders]
    drives, left_out = [drive_of(named)] if named else [], list[LeftOut]()
    for folder in folders:
        logs, others = split_folder(folder, columns)
        if not logs:
            first = f", for one {others[0].path.name}: {others[0].reason}" if others else ""
            raise ConfigError(f"{folder} holds no log that can be read{first}")
        left_out += others
        drives += [drive_of([log.path], vehicle_by_folder(log.path, folder) if has_vehicles else None) for log in logs]
    counts = Counter(path.resolve() for drive in drives for path in drive.paths)
    if twice := sorted(str(path) for path, count in counts.items() if count > 1):
        raise ConfigError(f"named twice: {', '.join(twice)}")
    return drives, left_out


def drive_of(paths: Iterable[Path], vehicle: str | None = None) -> DriveLogs:
    """Return the drive that some files are; raises SourceError if one is not there."""
    files = tuple(paths)
    try:
        stats = [path.stat() for path in files]
    except OSError as exc:
        raise SourceError(f"{exc.filename}: {exc.strerror}") from exc
    return DriveLogs(
        paths=files,
        size_bytes=sum(stat.st_size for stat in stats),
        modified_ns=max(stat.st_mtime_ns for stat in stats),
        vehicle=vehicle,
    )


def vehicle_by_folder(log: Path, folder: Path) -> str:
    """Return the vehicle that the folders of a log speak of; raises ConfigError if that is no name for one."""
    below = log.relative_to(folder).parts[:-1]
    try:
        return check_vehicle(below[0] if below else folder.resolve().name)
    except ConfigError as exc:
        raise ConfigError(f"{log}: {exc}") from exc


def split_folder(folder: Path, columns: str = "") -> tuple[list[RecognisedLog], list[LeftOut]]:
    """Return the logs in a folder and below, by name, and what else is there, each with why it is that.

    Raises SourceError if this user may not look into it.
    """
    if not os.access(folder, os.R_OK | os.X_OK):
        raise SourceError(f"{folder}: {os.strerror(errno.EACCES)}")
    logs, others, read = list[RecognisedLog](), list[LeftOut](), dict[Path, Path]()
    inside = list(folder.rglob("*"))
    for path in sorted(filter(Path.exists, inside), key=lambda path: (path.is_symlink(), path)):
        read.setdefault(path.resolve(), path)  # files come before links to them
    for path in sorted(inside):
        if path.is_dir():
            if not os.access(path, os.R_OK | os.X_OK):
                others.append(LeftOut(path=path, reason="a folder without permission to read it"))
            continue
        if not path.exists():
            others.append(LeftOut(path=path, reason="a broken link"))
            continue
        if (first := read[path.resolve()]) != path:
            others.append(LeftOut(path=path, reason=f"a link to {first}, which is read already"))
            continue
        look = looked_at(path, columns)
        if look.format is None:
            others.append(LeftOut(path=path, reason=look.reason))
        else:
            logs.append(RecognisedLog(path=path, format=look.format.value, evidence=look.evidence))
    return logs, others
