"""The logs of one drive: opened, put in order, read as one stream, and what is wrong with each of them."""

import hashlib
import logging
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from canlog.e2e.protection_check import FrameReason, LinkMonitor
from canlog.errors import SourceError
from canlog.files import is_plain_file, open_plain_file
from canlog.frames import FrameBatch
from canlog.logs import STANDARD_INPUT, LogReader, merged_by_time, read_log
from canlog.logs.log_counts import assumed_texts, lost_texts, odd_texts
from canlog.logs.reading import Watch
from canlog.logs.streams import never
from diag_service.diagnosis.summary import ChannelShare, Contributions, Gap, LogShare, gaps_line, idle_lines
from diag_service.errors import ConfigError, IncompleteError, StoppedError

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLog:
    """A log whose first frames have been read."""

    path: Path
    reader: LogReader
    first: FrameBatch


@contextmanager
def open_drive(
    paths: Iterable[Path],
    *,
    is_strict: bool = False,
    is_stopped: Callable[[], bool] = never,
    watch: Watch | None = None,
    columns: str = "",
) -> Iterator[list[OpenLog]]:
    """Open the logs of a drive while entered, ``-`` being standard input; the one with the earliest frame comes first.

    Raises ConfigError if a log is named twice, or two hold the same. Raises SourceError if a log cannot be read or
    holds no frame; of a strict one also if anything is wrong with it.
    """
    paths = list(paths)
    check_distinct(paths)
    with ExitStack() as opened:
        logs: list[OpenLog] = []
        for path in paths:
            reader = read_log(path, is_strict=is_strict, is_stopped=is_stopped, watch=watch, columns=columns)
            opened.callback(reader.close)
            logs.append(OpenLog(path=path, reader=reader, first=next(reader)))  # a log without frames is an error
        yield sorted(logs, key=lambda log: int(log.first.t_ns[0]))


def check_distinct(paths: Sequence[Path]) -> None:
    """Raise ``ConfigError`` where a recording is there twice; what is no file, its reader complains of."""
    if paths.count(STANDARD_INPUT) > 1:
        raise ConfigError("standard input is given twice")
    files = [path for path in paths if path != STANDARD_INPUT and is_plain_file(path)]
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
                hashlib.file_digest(file, lambda: digest)
        except OSError as exc:
            raise SourceError(f"cannot read {path}: {exc.strerror or exc}") from exc
    return digest.hexdigest()


def stream_of_drive(logs: Iterable[Path], files: Iterable[Path]) -> str:
    """Return the name of the stream that some logs are, read in the light of some files.

    A pipe has no name by which it would be known again: each gets a new one.
    """
    logs = list(logs)
    return str(uuid.uuid4()) if STANDARD_INPUT in logs else stream_of([*logs, *files])


def gaps_in(logs: Sequence[OpenLog], *, was_stopped: bool) -> tuple[Gap, ...]:
    """Return why what was read of a drive is a part of it; nothing if it is the whole.

    A log that was merely not closed shows nothing that is missing: many recorders leave every file so.
    """
    gaps = {Gap.STOPPED: was_stopped, Gap.LOG_CUT: any(log.reader.counts.truncated for log in logs)}
    return tuple(gap for gap, is_there in gaps.items() if is_there)


def check_complete(gaps: Sequence[Gap], contributions: Contributions, *, is_strict: bool) -> None:
    """End a run whose results are reported.

    Raises StoppedError or IncompleteError if it was a part of the drive only; of a strict run also if a log or a
    channel gave nothing: the first is named.
    """
    if gaps:
        raise (StoppedError if Gap.STOPPED in gaps else IncompleteError)(gaps_line(tuple(gaps)))
    idle = contributions.idle
    if is_strict and idle:
        more = f"; and {len(idle) - 1} more" if len(idle) > 1 else ""
        raise IncompleteError(f"{idle[0]}{more}")


def warn_of_faults(logs: Sequence[OpenLog], contributions: Contributions) -> None:
    """Warn of logs with holes, and of logs and channels that gave nothing."""
    for log in logs:
        counts, name = log.reader.counts, log.reader.name
        _LOG.info("%s: taken for %s: %s", name, log.reader.format, log.reader.evidence)
        for text in (*assumed_texts(counts), *lost_texts(counts), *odd_texts(counts)):
            _LOG.warning("%s: %s", name, text)
    for text in contributions.idle:
        _LOG.warning("%s", text)


MOST_SOURCES: Final = 256
_UNKNOWN: Final = -1  # the mark of a channel of which no frame came yet


class DriveFrames:
    """The frames of the logs of a drive, once, merged by time; ``channel`` of a frame is the mark of its source.

    A source is a channel of one of the logs: two logs of one time may be two buses with one number, or one bus with
    two. Its mark is the number of the channel in its log, or a free one if another source has that. The monitor follows
    each message from one source, and counts what became of the frames of each.
    """

    def __init__(self, logs: Sequence[OpenLog], monitor: LinkMonitor) -> None:
        self.logs = tuple(logs)
        self._monitor = monitor
        self._marks = [np.full(MOST_SOURCES, _UNKNOWN, np.int64) for _ in logs]  # by channel
        self._free = set(range(MOST_SOURCES))
        self._ended: dict[int, LogShare] = {}

    def __iter__(self) -> Iterator[FrameBatch]:
        return merged_by_time([self._frames(number) for number in range(len(self.logs))], self._marked)

    def contributions(self, named_channel: int | None, *, is_whole: bool = True) -> Contributions:
        """Return what each log gave until now; of a part of a drive nobody knows what gives nothing."""
        numbers = range(len(self.logs))
        shares = tuple(self._ended.get(number) or self._share(number) for number in numbers)
        return Contributions(logs=shares, idle=tuple(idle_lines(shares, named_channel)) if is_whole else ())

    def _frames(self, number: int) -> Iterator[FrameBatch]:
        log = self.logs[number]
        yield from chain((log.first,), log.reader)
        # All of its frames were taken: the merger asks for more only then.
        self._ended[number] = self._share(number)
        for source in self._sources(number).values():
            self._monitor.end_source(source)
            self._free.add(source)

    def _marked(self, number: int, batch: FrameBatch) -> FrameBatch:
        """Return frames of a log with the marks of their sources; raises SourceError if there are too many."""
        marks = self._marks[number]
        present = np.flatnonzero(np.bincount(batch.channel, minlength=MOST_SOURCES))
        for channel in present[marks[present] == _UNKNOWN].tolist():
            if not self._free:
                name = self.logs[number].reader.name
                raise SourceError(f"{name}: more than {MOST_SOURCES} channels of logs at the same time")
            marks[channel] = mark = channel if channel in self._free else min(self._free)
            self._free.remove(mark)
            self._monitor.begin_source(mark, channel)
        if np.array_equal(marks[present], present):
            return batch
        return replace(batch, channel=marks[batch.channel].astype(np.uint8))

    def _sources(self, number: int) -> dict[int, int]:
        """Return the marks of the channels of a log."""
        marks = self._marks[number]
        return {channel: int(marks[channel]) for channel in np.flatnonzero(marks != _UNKNOWN).tolist()}

    def _share(self, number: int) -> LogShare:
        channels, used = list[ChannelShare](), {FrameReason.OK, FrameReason.UNKNOWN_ID}
        for channel, source in self._sources(number).items():
            counts = self._monitor.source_counts(source)
            share = ChannelShare(
                channel=channel,
                frames=sum(counts.values()),
                decoded=counts.get(FrameReason.OK, 0),
                ignored=counts.get(FrameReason.UNKNOWN_ID, 0),
                rejected={reason.name.lower(): count for reason, count in counts.items() if reason not in used},
            )
            channels.append(share)
        return LogShare.of(str(self.logs[number].path), tuple(channels))
