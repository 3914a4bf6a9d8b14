"""Texts and tables before people: no word is broken, no text is taken for markup, a pipe gets a line per record."""

import re
from collections.abc import Container, Iterable, Iterator
from typing import Any, Final

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from clutchdiag_io.program import legible

INDENT: Final = "    "  # of what goes on in the next line
_WORD: Final = re.compile(r"\S+")


class PeopleConsole(Console):
    """A console that breaks no word, prints markup as it stands and raises BrokenPipeError when the reader is gone."""

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

    def print_all(self, lines: Iterable[str | Text | Table]) -> None:
        for line in lines:
            self.print(line)

    def _lines(self, what: str | Text | Table, style: str) -> Iterator[Text]:
        """Yield what is to be printed as lines, a table as wide as its columns are."""
        if isinstance(what, Table):
            width = Measurement.get(self, self.options.update(max_width=10_000), what).maximum
            for segments in self.render_lines(what, self.options.update(width=width, max_width=width), pad=False):
                yield _text_of(segments)
            return
        text = what if isinstance(what, Text) else Text(_shown(legible(what)), style)
        yield from text.split("\n", allow_blank=True) if text.plain else [text]


def plain_table(columns: Iterable[str], left: Container[str] = (), title: str | None = None) -> Table:
    """Return a table without a frame; of its columns those named ``left`` begin at the left, the others end there."""
    table = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0)
    )
    for name in columns:
        table.add_column(name, justify="left" if name in left else "right", no_wrap=True)
    return table


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
