"""The frames that tables are made of: of one log or several, in groups."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self, cast

import numpy as np

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join
from canlog.logs import STANDARD_INPUT, LogCounts, LogReader, merged_by_time, read_log, shown_name
from canlog.logs.reading import Watch, named_error
from canlog.logs.streams import never, open_standard_input, temporary_log

if TYPE_CHECKING:
    from canlog.arrays import UInt8Array

LOG_SHIFT: Final = 8  # of the channels of several logs: above them stands the place of the log


class LogSet:
    """Some logs as one stream of frames. Standard input that is to be read twice is kept in a file while it is open.

    Parameters
    ----------
    paths :
        The logs; with several of them ``names`` are theirs, and channels say of which one, too (``LOG_SHIFT``).
    is_stopped :
        Whether to wait no longer for standard input.
    watch :
        Called after each batch of a log, and at its end, with its reader.
    is_read_twice :
        Whether the frames are asked for more than once.
    columns :
        Which column of a text is which, as ``read_log`` takes it.

    Raises
    ------
    SourceError
        When it is entered, if standard input cannot be read.
    """

    def __init__(
        self,
        paths: Sequence[Path],
        is_stopped: Callable[[], bool] = never,
        *,
        is_read_twice: bool = False,
        watch: Watch | None = None,
        columns: str = "",
    ) -> None:
        self.paths = tuple(paths)
        self.readers: list[LogReader] = []  # of the last reading
        # Bytes that are no text become escapes.
        names = (shown_name(path).encode(errors="surrogateescape").decode(errors="backslashreplace") for path in paths)
        self.names = tuple(names) if len(paths) > 1 else ()
        self._is_stopped = is_stopped
        self._watch = watch
        self._columns = columns
        self._is_kept = is_read_twice and STANDARD_INPUT in paths
        self._kept_path = STANDARD_INPUT
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        if self._is_kept:
            try:
                pieces = open_standard_input(self._is_stopped).pieces(self._is_stopped)
                file = self._opened.enter_context(temporary_log(pieces))
            except (OSError, SourceError) as exc:
                raise named_error(shown_name(STANDARD_INPUT), exc) from exc
            self._kept_path = Path(str(file.name))
        return self

    def __exit__(self, *_: object) -> None:
        self._close_readers()
        self._opened.close()

    def frames(self) -> Iterator[FrameBatch]:
        """Yield all frames from the first; raises SourceError."""
        self._close_readers()
        is_stopped, watch, columns = self._is_stopped, self._watch, self._columns
        for path in self.paths:
            source, name = self._kept_path if path == STANDARD_INPUT else path, shown_name(path)
            self.readers.append(read_log(source, is_stopped=is_stopped, watch=watch, name=name, columns=columns))
        if self.names:
            yield from merged_by_time(map(_with_place, count(), self.readers))
        else:
            yield from self.readers[0]

    @property
    def counts(self) -> LogCounts:
        """What the logs held, those of several added up."""
        if not self.names:
            return self.readers[0].counts
        total = LogCounts()
        for reader in self.readers:
            total.add(_with_name(reader.counts, reader.name))
        return total

    def _close_readers(self) -> None:
        for reader in self.readers:
            reader.close()
        self.readers.clear()


def _with_place(place: int, reader: LogReader) -> Iterator[FrameBatch]:
    """Yield the frames of one of several logs, with its place above their channels."""
    for batch in reader:
        channel = batch.channel.astype(np.int64) | place << LOG_SHIFT
        yield replace(batch, channel=cast("UInt8Array", channel))  # wider than elsewhere; layouts take it apart


def _with_name(counts: LogCounts, name: str) -> LogCounts:
    """Return the counts of one of several logs, with its name before what is for people."""
    for place in ("first_rejected", "first_jump"):
        if text := getattr(counts, place):
            setattr(counts, place, f"{name}: {text}")
    counts.notes = tuple(f"{name}: {note}" for note in counts.notes)
    return counts


def log_paths(path: Path | str | Sequence[Path | str]) -> list[Path]:
    """Return one log or several as a list; raises SourceError if there is none."""
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(name) for name in path]
    if not paths:
        raise SourceError("no log is named")
    return paths


def grouped(batches: Iterable[FrameBatch], most_frames: int, *, is_live: bool = False) -> Iterator[FrameBatch]:
    """Yield frames in larger batches, of no more than so many frames; ``is_live``: what comes together is a batch."""
    waiting, size = list[FrameBatch](), 0
    for batch in batches:
        for start in range(0, len(batch), most_frames):
            part = batch[start : start + most_frames]
            if size + len(part) > most_frames or (is_live and waiting):
                yield join(waiting)
                waiting, size = [], 0
            waiting.append(part)
            size += len(part)
        if is_live and waiting:
            yield join(waiting)
            waiting, size = [], 0
    if waiting:
        yield join(waiting)
