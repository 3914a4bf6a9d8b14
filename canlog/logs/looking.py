"""What files are taken for by their first bytes, those inside archives, too."""

from contextlib import closing
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

from canlog.errors import SourceError
from canlog.files import open_plain_file
from canlog.logs.archives import has_members
from canlog.logs.detection import Detected, LogFormat
from canlog.logs.reading import read_log
from canlog.logs.unpacking import looks_inside


def is_log(path: Path) -> bool:
    """Return whether a file is a log of a known format, by its first bytes; False if it cannot be read."""
    return not why_no_log(path)


def is_folder(path: Path) -> bool:
    """Return whether a path stands for several logs: a folder, or an archive that holds more than one."""
    try:
        with BufferedReader(open_plain_file(path)) as stream:
            is_archive = has_members(stream)
    except OSError:
        return path.is_dir()
    return is_archive and sum(not one.reason for one in looked_at(path)) > 1


def why_no_log(path: Path, columns: str = "") -> str:
    """Return why a file is no log of a known format, by its first bytes; empty if it is one."""
    return next((one.reason for one in looked_at(path, columns)), "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """What a file, or one inside an archive, was taken for, or why for nothing."""

    path: Path
    format: LogFormat | None = None
    evidence: str = ""
    reason: str = ""  # why it is no log; empty if it is one


def looked_at(path: Path, columns: str = "") -> list[Looked]:
    """Return what a file is taken for by its first bytes; of an archive, what each file inside it is taken for."""
    try:
        with BufferedReader(open_plain_file(path)) as stream:
            inside = list(looks_inside(stream, columns)) if has_members(stream) else []
    except (OSError, SourceError):
        inside = []
    return [_looked_inside(path / member.name, found, columns) for member, found in inside] or [
        _looked_at(path, columns)
    ]


def _looked_inside(path: Path, found: Detected | SourceError, columns: str) -> Looked:
    if isinstance(found, SourceError):
        return Looked(path=path, reason=str(found))
    if found.format is LogFormat.SQLITE:  # may be a database of anything
        return _looked_at(path, columns)
    return Looked(path=path, format=found.format, evidence=found.evidence)


def _looked_at(path: Path, columns: str) -> Looked:
    try:
        with closing(read_log(path, columns=columns)) as reader:
            return Looked(path=path, format=reader.format, evidence=reader.evidence)
    except SourceError as exc:
        return Looked(path=path, reason=str(exc).removeprefix(f"{path}: "))
