"""Logs through the pipeline: the frames of one drive, as fast as they can be read."""

import asyncio
import hashlib
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

from clutch_model.plain_files import open_plain_file
from diag_service.errors import ConfigError, SourceError
from diag_service.events import ShiftEvent
from diag_service.frames import FrameBatch
from diag_service.publishers import Outbox
from diag_service.runs.session import Session
from diag_service.runs.stages import Stages
from diag_service.runs.two_senders import SenderWatch
from diag_service.sources import LogReader, merged_by_time, read_log
from diag_service.stopping import Trigger
from diag_service.summary import FrameCounts, Summary
from diag_service.tasks import first_error

_BLOCK_BYTES = 1 << 20
NS_PER_MS = 1_000_000
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


async def run_logs(logs: Sequence[OpenLog], session: Session, *, stop: Trigger, outbox: Outbox | None) -> Summary:
    """Diagnose the logs of a drive, as ``open_drive`` put them; return the numbers.

    ``stop`` ends the analysis between two shifts; the shift that was open is not reported, so that a later analysis
    of the same logs takes it up.
    """
    loop = asyncio.get_running_loop()

    def tell_outbox() -> None:
        if outbox is not None:
            loop.call_soon_threadsafe(outbox.nudge)

    unpublished_count: int | None = None
    try:
        async with asyncio.TaskGroup() as tasks:
            sender = None if outbox is None else tasks.create_task(outbox.run(), name="outbox")
            await asyncio.to_thread(_analyse, logs, session, stop, tell_outbox)
            if outbox is not None and sender is not None:
                unpublished_count = await outbox.close(sender)
    except BaseExceptionGroup as group:
        raise first_error(group) from group
    warn_of_damage(logs)
    warn_of_slow_messages(session.stages)
    frames = frame_counts(logs, session.stages, is_whole=not stop.is_set)
    if (text := SenderWatch().look(frames)) is not None:
        _LOG.warning("%s", text)
    session.finish(frames, unpublished_count)
    return session.summary(frames, unpublished_count)


def _analyse(logs: Sequence[OpenLog], session: Session, stop: Trigger, tell_outbox: Callable[[], None]) -> None:
    for event in events(logs, session.stages, stop):
        session.settle(event)
        tell_outbox()
        if stop.is_set:
            return


def events(logs: Sequence[OpenLog], stages: Stages, stop: Trigger) -> Iterator[ShiftEvent]:
    """Yield the shifts of a drive, until it is told to stop; logs that overlap are merged by time."""
    for batch in merged_by_time([chain((log.first,), log.reader) for log in logs]):
        if stop.is_set:
            return
        yield from stages.segment(batch)
    yield from stages.flush()


def frame_counts(logs: Sequence[OpenLog], stages: Stages, *, is_whole: bool) -> FrameCounts:
    """Return what became of the frames; of an analysis that was stopped those read ahead do not count."""
    unreadable: Counter[str] = Counter()
    for log in logs:
        unreadable.update({reason.value: count for reason, count in log.reader.counts.rejected.items()})
    counts = stages.frame_counts()
    read = sum(log.reader.counts.frames for log in logs) if is_whole else counts.on_bus
    return replace(counts, on_bus=read, unreadable=dict(unreadable))


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


def warn_of_slow_messages(stages: Stages) -> None:
    """Warn of messages that come less often than the database says; they are held against their own cycle."""
    by_cycles: dict[tuple[int, int], list[str]] = {}
    for name, (own_ns, nominal_ns) in stages.slow_messages.items():
        by_cycles.setdefault((round(own_ns / NS_PER_MS), round(nominal_ns / NS_PER_MS)), []).append(name)
    for (own_ms, nominal_ms), names in sorted(by_cycles.items()):
        _LOG.warning("frames every %d ms instead of %d ms: %s", own_ms, nominal_ms, ", ".join(names))
