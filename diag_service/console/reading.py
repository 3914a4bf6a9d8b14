"""How far the reading of logs is, for whoever waits at a terminal: one line on standard error, gone when it is done."""

import sys
import time
from collections.abc import Callable
from typing import Final, Self, TextIO

from canlog.logs import LogReader
from clutchdiag_io.legible import legible
from diag_service.console.terminal import CLEAR

PATIENCE_S: Final = 2.0  # so long nobody asks
PERIOD_S: Final = 0.2
_LONGEST_NAME: Final = 40


class ReadingLine:
    """A line that tells how far a reading is, while this is entered; nothing where nobody watches.

    Parameters
    ----------
    stream :
        Where people look; None: standard error.
    now_s :
        The clock [s].
    """

    def __init__(self, stream: TextIO | None = None, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._now_s = now_s
        self._due_s = now_s() + PATIENCE_S
        self._is_shown = False
        self._is_watched = self._stream is not None and self._stream.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def watch(self, reader: LogReader) -> None:
        """Tell how far a log has been read; called after each of its batches, and at its end."""
        if reader.has_ended:
            self.clear()
        elif self._is_due():
            self.show(reading_text(reader))

    def tell(self, text: str) -> None:
        """Show a text if somebody may ask by now, and not more often than can be read."""
        if self._is_due():
            self.show(text)

    def report(self, news: object) -> None:
        """Make room for what is told otherwise: a reporter of the run."""
        del news
        self.clear()

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        if self._is_watched:
            self._stream.write(f"{CLEAR}{text}")
            self._stream.flush()
            self._is_shown = True
            self._due_s = self._now_s() + PERIOD_S

    def clear(self) -> None:
        """Take the line away."""
        if self._is_shown:
            self._stream.write(CLEAR)
            self._stream.flush()
            self._is_shown = False

    def _is_due(self) -> bool:
        return self._is_watched and self._now_s() >= self._due_s


def reading_text(reader: LogReader) -> str:
    """Return how far a log has been read: its share where its size is known, and the frames in any case."""
    name = legible(reader.name)
    short = name if len(name) <= _LONGEST_NAME else f"...{name[3 - _LONGEST_NAME :]}"
    share = f"{min(99, 100 * reader.read_bytes // reader.size_bytes)} %, " if reader.size_bytes else ""
    return f"reading {short}: {share}{reader.counts.frames} frames"
