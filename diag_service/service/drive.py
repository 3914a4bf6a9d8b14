"""The logs of one drive: opened, put in order, read as one stream, and what is wrong with each of them."""

import hashlib
import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs import LogReader, read_log
from canlog.plain_files import open_plain_file
from diag_service.diagnosis.contributions import Contributions
from diag_service.diagnosis.summary import Gap, gaps_line
from diag_service.errors import ConfigError, IncompleteError, StoppedError

_BLOCK_BYTES = 1 << 20
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLog:
    """A log whose first frames have been read."""

    path: Path
    reader: LogReader
    first: FrameBatch


def open_drive(paths: Iterable[Path], *, is_strict: bool = False) -> list[OpenLog]:
    """Open the logs of a drive; the one with the earliest first frame comes first.

    Raises
    ------
    ConfigError
        If a log is named twice, or two hold the same.
    SourceError
        If a log cannot be read or holds no frame; of a strict one also if anything is wrong with it.
    """
    paths = list(paths)
    _check_distinct(paths)
    logs: list[OpenLog] = []
    for path in paths:
        reader = read_log(path, is_strict=is_strict)
        first = next(reader, None)
        if first is None or not len(first):
            raise SourceError(f"{path} holds no frame that can be read")
        logs.append(OpenLog(path=path, reader=reader, first=first))
    return sorted(logs, key=lambda log: int(log.first.t_ns[0]))


def _check_distinct(paths: Sequence[Path]) -> None:
    """Raise ``ConfigError`` where a recording is there twice; what is no file, its reader complains of."""
    files = [path for path in paths if path.is_file()]
    for number, path in enumerate(files):
        for other in files[:number]:
            if path.samefile(other):
                raise ConfigError(f"{path} is given twice")
            if path.stat().st_size == other.stat().st_size and stream_of([path]) == stream_of([other]):
                raise ConfigError(f"{path} and {other} are the same recording")


def stream_of(paths: Iterable[Path]) -> str:
    """Return the name of a recorded stream: the sha256 of its files, one after the other."""
    digest = hashlib.sha256()
    for path in paths:
        try:
            with open_plain_file(path) as file:
                while block := file.read(_BLOCK_BYTES):
                    digest.update(block)
        except OSError as exc:
            raise SourceError(f"cannot read {path}: {exc.strerror or exc}") from exc
    return digest.hexdigest()


def gaps_in(logs: Sequence[OpenLog], *, was_stopped: bool) -> tuple[Gap, ...]:
    """Return why what was read of a drive is a part of it; nothing if it is the whole.

    A log that was merely not closed shows nothing that is missing: many recorders leave every file so.
    """
    found = {
        Gap.STOPPED: was_stopped,
        Gap.LOG_CUT: any(log.reader.counts.truncated for log in logs),
    }
    return tuple(gap for gap, is_there in found.items() if is_there)


def insist_on_the_whole(gaps: tuple[Gap, ...]) -> None:
    """End a run that has told what it found in a part of a drive.

    Raises
    ------
    StoppedError
        If it was stopped.
    IncompleteError
        If a log broke off.
    """
    if Gap.STOPPED in gaps:
        raise StoppedError(gaps_line(gaps))
    if gaps:
        raise IncompleteError(gaps_line(gaps))


def insist_on_every_source(contributions: Contributions) -> None:
    """End a strict run that has told what it found, if a log or a channel gave nothing to it.

    Raises
    ------
    IncompleteError
        If one did; the first is named.
    """
    if idle := contributions.idle:
        more = f"; and {len(idle) - 1} more" if len(idle) > 1 else ""
        raise IncompleteError(f"{idle[0]}{more}")


def warn_of_idle(contributions: Contributions) -> None:
    """Warn of logs and channels that gave nothing."""
    for text in contributions.idle:
        _LOG.warning("%s", text)


def warn_of_damage(logs: Sequence[OpenLog]) -> None:
    """Warn of logs with holes."""
    for log in logs:
        counts = log.reader.counts
        _LOG.info("%s: taken for %s: %s", log.path, log.reader.format, log.reader.evidence)
        for note in counts.notes:
            _LOG.warning("%s: %s", log.path, note)
        if counts.first_rejected:
            total = sum(counts.rejected.values())
            _LOG.warning("%s: %d pieces are no frames, the first: %s", log.path, total, counts.first_rejected)
        if counts.first_jump:
            jumps = counts.jumps_back + counts.jumps_ahead
            _LOG.warning("%s: %d jumps of time, %d of them back, the first: %s", log.path, jumps, counts.jumps_back,
                         counts.first_jump)  # fmt: skip
        if counts.repeated:
            _LOG.warning("%s: %d frames are there twice", log.path, counts.repeated)
        if counts.truncated:
            _LOG.warning("%s ends before its own end", log.path)
        elif counts.unfinished:
            _LOG.warning("%s was not closed by its writer; what is missing at its end cannot be told", log.path)
