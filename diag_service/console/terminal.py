"""What people read: lines on standard output, broken between words on a terminal, and how far a reading is."""

import re
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Self, TextIO

from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from canlog.logs import LogReader
from clutchdiag_io.files import legible

INDENT: Final = "    "  # of what goes on in the next line
CLEAR: Final = "\r\x1b[K"  # takes away what stands on the last line
PATIENCE_S: Final = 2.0  # so long nobody asks
PERIOD_S: Final = 0.2
_LONGEST_NAME: Final = 40
_WORD: Final = re.compile(r"\S+")


class PeopleConsole(Console):
    """A console that breaks no word, takes no text for markup and lets its owner know of a broken pipe."""

    def on_broken_pipe(self) -> None:
        """Tell the caller, instead of ending the process."""
        raise BrokenPipeError

    def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401 - as rich has it
        """Print texts and tables line by line; whatever else there is, as rich does."""
        if len(objects) != 1 or not isinstance(objects[0], str | Text | Table):
            super().print(*objects, **options)
            return
        for line in self._lines(objects[0], str(options.get("style") or "")):
            for piece in folded(line, self.width) if self.is_terminal else [line]:
                super().print(piece, soft_wrap=True)

    def _lines(self, what: str | Text | Table, style: str) -> Iterator[Text]:
        """Yield what is to be printed as lines, a table as wide as its columns are."""
        if isinstance(what, Table):
            width = Measurement.get(self, self.options.update(max_width=10_000), what).maximum
            for segments in self.render_lines(what, self.options.update(width=width, max_width=width), pad=False):
                yield _text_of(segments)
            return
        text = what if isinstance(what, Text) else Text(_shown(legible(what)), style)
        yield from text.split("\n", allow_blank=True) if text.plain else [text]


def folded(line: Text, width: int) -> list[Text]:
    """Return a line as one or more, none longer than ``width`` unless a single word is."""
    if cell_len(line.plain) <= width:
        return [line]
    breaks, begin, room = list[int](), 0, width
    for word in _WORD.finditer(line.plain):
        is_first = not line.plain[begin : word.start()].strip()
        if not is_first and cell_len(line.plain[begin : word.end()]) > room:
            breaks.append(word.start())
            begin, room = word.start(), width - len(INDENT)
    first, *others = line.divide(breaks)
    for part in (first, *others):
        part.rstrip()
    return [first, *(Text(INDENT).append_text(other) for other in others)]


def _text_of(segments: list[Segment]) -> Text:
    text = Text()
    for segment in segments:
        text.append(segment.text, segment.style)
    text.rstrip()
    return text


def _shown(text: str) -> str:
    """Return a text as it may stand before a terminal, which would act on some characters."""
    return "".join(char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in text)


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
