"""The logs that a table is made of: read as often as is needed, merged by time, and what each of them held besides."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import numpy as np

from canlog.arrays import Int64Array
from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.logs import STANDARD_INPUT, LogCounts, LogReader, merged_by_time, read_log, shown_name
from canlog.logs.piped import kept, never, open_standard_input
from canlog.logs.reading import Watch
from canlog.logs.source_marks import MOST_SOURCES, SourceMarks

_FIRST: Final = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Origins:
    """Where frames of several logs come from, by the mark that stands for their channel; changes as they are read."""

    names: tuple[str, ...]  # of the logs
    log: Int64Array = field(default_factory=lambda: np.zeros(MOST_SOURCES, np.int64))  # place in ``names``
    channel: Int64Array = field(default_factory=lambda: np.arange(MOST_SOURCES))

    def begin(self, number: int, channel: int, mark: int) -> None:
        """Let a mark stand for a channel of a log from now on."""
        self.log[mark], self.channel[mark] = number, channel


class LogSet:
    """Some logs as one stream of frames. Standard input that is to be read twice is kept in a file while it is open.

    Parameters
    ----------
    paths :
        The logs; with several of them ``origins`` tells where a frame came from.
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
        self.origins = Origins(names=tuple(map(_as_text, paths))) if len(paths) > 1 else None
        self._is_stopped = is_stopped
        self._watch = watch
        self._columns = columns
        self._is_kept = is_read_twice and STANDARD_INPUT in paths
        self._kept_path = STANDARD_INPUT
        self._opened = ExitStack()

    def __enter__(self) -> Self:
        if self._is_kept:
            try:
                file = self._opened.enter_context(kept(open_standard_input(self._is_stopped), self._is_stopped))
            except OSError as exc:
                raise SourceError(f"{shown_name(STANDARD_INPUT)}: {exc.strerror or exc}") from exc
            except SourceError as exc:
                raise type(exc)(f"{shown_name(STANDARD_INPUT)}: {exc}") from exc
            self._kept_path = Path(str(file.name))
        return self

    def __exit__(self, *_: object) -> None:
        self._close_readers()
        self._opened.close()

    def frames(self) -> Iterator[FrameBatch]:
        """Yield all frames from the first; raises SourceError."""
        self._close_readers()
        for path in self.paths:
            self.readers.append(self._open(path))
        origins = self.origins
        if origins is None:
            yield from self.readers[_FIRST]
            return
        marks = SourceMarks(origins.names, origins.begin)
        yield from merged_by_time([self._of(number, marks) for number in range(len(self.readers))], marks.marked)

    @property
    def counts(self) -> LogCounts:
        """What the logs held, those of several added up."""
        if self.origins is None:
            return self.readers[_FIRST].counts
        total = LogCounts()
        for reader in self.readers:
            total.add(_with_name(reader.counts, reader.name))
        return total

    def _open(self, path: Path) -> LogReader:
        if path != STANDARD_INPUT:
            return read_log(path, watch=self._watch, columns=self._columns)
        name, columns = shown_name(path), self._columns
        return read_log(self._kept_path, is_stopped=self._is_stopped, watch=self._watch, name=name, columns=columns)

    def _of(self, number: int, marks: SourceMarks) -> Iterator[FrameBatch]:
        yield from self.readers[number]
        marks.release(number)

    def _close_readers(self) -> None:
        for reader in self.readers:
            reader.close()
        self.readers.clear()


def _with_name(counts: LogCounts, name: str) -> LogCounts:
    """Return the counts of one of several logs, with its name before what is for people."""
    for place in ("first_rejected", "first_jump"):
        if text := getattr(counts, place):
            setattr(counts, place, f"{name}: {text}")
    counts.notes = tuple(f"{name}: {note}" for note in counts.notes)
    return counts


def _as_text(path: Path) -> str:
    """Return the name of a log as a text; bytes that are none become escapes."""
    return shown_name(path).encode(errors="surrogateescape").decode(errors="backslashreplace")


def log_paths(path: Path | str | Sequence[Path | str]) -> list[Path]:
    """Return one log or several as a list; raises SourceError if there is none."""
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(one) for one in path]
    if not paths:
        raise SourceError("no log is named")
    return paths
