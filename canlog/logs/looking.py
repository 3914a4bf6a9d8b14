"""What files are taken for by their first bytes, those inside archives, too."""

from contextlib import closing
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

from canlog.errors import SourceError
from canlog.logs.archives import is_archive, members_of
from canlog.logs.detection import LogFormat
from canlog.logs.reading import read_log
from canlog.plain_files import open_plain_file


def is_log(path: Path) -> bool:
    """Return whether a file is a log of a known format, by its first bytes; False if it cannot be read."""
    return not why_no_log(path)


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
    inside = _members(path)
    return [_looked_at(one, columns) for one in inside] if inside else [_looked_at(path, columns)]


def _members(path: Path) -> list[Path]:
    """Return the paths of the files in an archive; none if it is no archive, or one that cannot be read."""
    try:
        with BufferedReader(open_plain_file(path)) as stream:
            return [path / member.name for member in members_of(stream)] if is_archive(stream.peek(4)) else []
    except (OSError, SourceError):
        return []


def _looked_at(path: Path, columns: str) -> Looked:
    try:
        with closing(read_log(path, columns=columns)) as reader:
            return Looked(path=path, format=reader.format, evidence=reader.evidence)
    except SourceError as exc:
        return Looked(path=path, reason=str(exc).removeprefix(f"{path}: "))
