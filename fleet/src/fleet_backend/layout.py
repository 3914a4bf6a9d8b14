"""How a table is laid out: no word is broken and no row loses whom it is about, whatever the width.

Without a width, in a pipe, every record is one line. Where a table is too wide for a terminal, texts are wrapped
between words; then columns that can be done without go, and are named; in the end each record is a block with a value
per line, as psql's expanded display has it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from types import MappingProxyType
from typing import Final

from rich.cells import cell_len
from rich.text import Text

_GAP: Final = 2  # spaces between columns; inside a text there is never more than one
_NARROW_GAP: Final = 1
_RULE: Final = "─"
NONE: Final = "-"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """What is to be shown: texts in rows."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    dispensable: Sequence[str] = ()  # columns that go where there is no room, in this order
    remarks: Sequence[tuple[str, str]] | None = None  # of each row: whom it is about, what is told of it
    styles: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))  # of a text that is a whole cell


@dataclass(frozen=True, slots=True)
class _Grid:
    """Rows, their head first, and how wide each column is."""

    rows: Sequence[Sequence[str]]
    widths: Sequence[int]
    gap: int


def lines_of(sheet: Sheet, width: int | None) -> Iterator[Text]:
    """Yield the lines of a sheet, none longer than ``width`` unless a single word is; None: a line per record."""
    rows = [list(sheet.columns), *([plain(text) for text in row] for row in sheet.rows)]
    remarks = [(whom, plain(text)) for whom, text in sheet.remarks or ()]
    if width is None:
        if sheet.remarks is not None:
            last = ["reason", *(text or NONE for _, text in remarks)]
            rows = [[*row, text] for row, text in zip(rows, last, strict=True)]
        yield Text(plain(sheet.title))
        widths = _natural(rows)
        yield from (Text(_joined(row, widths, _GAP)) for row in rows)
        return
    yield from (Text(line) for line in wrapped(sheet.title, width))
    kept, gone = _enough_columns(sheet, rows, width)
    if kept is None:
        yield from _blocks(rows, remarks, sheet.styles, width)
        return
    yield from _table(kept, sheet.styles)
    if gone:
        told = f"Hidden at this width: {', '.join(gone)}. A wider terminal, a pipe or --json shows all."
        yield from (Text(line, "dim") for line in wrapped(told, width))
    for whom, text in dict.fromkeys(remarks):  # clutches of one vehicle have one order
        if text:
            yield from (Text(line, "italic") for line in wrapped(f"{whom}: {text}", width))


def plain(text: str) -> str:
    """Return a text on one line that no terminal takes for more than a text."""
    shown = "".join(char if char.isprintable() or char.isspace() else ascii(char)[1:-1] for char in text)
    return " ".join(shown.split())


def wrapped(text: str, width: int) -> list[str]:
    """Return the lines of a text, broken between words only."""
    lines: list[str] = []
    for word in text.split():
        if lines and cell_len(lines[-1]) + 1 + cell_len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines or [""]


def _enough_columns(sheet: Sheet, rows: Sequence[Sequence[str]], width: int) -> tuple[_Grid | None, Sequence[str]]:
    """Return the table with as many columns as fit, and the names of the others; None where too few fit."""
    for count in range(len(sheet.dispensable) + 1):
        gone = sheet.dispensable[:count]
        kept = [[text for name, text in zip(sheet.columns, row, strict=True) if name not in gone] for row in rows]
        for gap in (_GAP, _NARROW_GAP):
            widths = _wrapped_widths(kept, width - gap * (len(kept[0]) - 1))
            if widths is not None:
                return _Grid(kept, widths, gap), gone
    return None, ()


def _wrapped_widths(rows: Sequence[Sequence[str]], room: int) -> list[int] | None:
    """Return the widths of columns that are wrapped as little as is needed; None if they do not fit."""
    widths = _natural(rows)
    least = [
        max(cell_len(word) for text in column for word in text.split() or [""]) for column in zip(*rows, strict=True)
    ]
    if sum(least) > room:
        return None
    while sum(widths) > room:
        slack = [have - need for have, need in zip(widths, least, strict=True)]
        widths[slack.index(max(slack))] -= 1
    return widths


def _natural(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(cell_len(text) for text in column) for column in zip(*rows, strict=True)]


def _joined(texts: Sequence[str], widths: Sequence[int], gap: int) -> str:
    cells = (text + " " * (width - cell_len(text)) for text, width in zip(texts, widths, strict=True))
    return (" " * gap).join(cells).rstrip()


def _table(grid: _Grid, styles: Mapping[str, str]) -> Iterator[Text]:
    head, *rows = grid.rows
    for line in _row_lines(grid, head, {}):
        line.stylize("bold")
        yield line
    yield Text(_RULE * (sum(grid.widths) + grid.gap * (len(grid.widths) - 1)))
    for row in rows:
        yield from _row_lines(grid, row, styles)


def _row_lines(grid: _Grid, row: Sequence[str], styles: Mapping[str, str]) -> Iterator[Text]:
    """Yield the lines of one record, its texts wrapped to their columns."""
    columns = [wrapped(text, width) for text, width in zip(row, grid.widths, strict=True)]
    for parts in zip_longest(*columns, fillvalue=""):
        line, begin = Text(_joined(parts, grid.widths, grid.gap)), 0
        for text, part, width in zip(row, parts, grid.widths, strict=True):
            if style := styles.get(text):
                line.stylize(style, begin, begin + len(part))
            begin += len(part) + width - cell_len(part) + grid.gap
        yield line


def _blocks(
    rows: Sequence[Sequence[str]], remarks: Sequence[tuple[str, str]], styles: Mapping[str, str], width: int
) -> Iterator[Text]:
    """Yield every record as a block: a name and a value per line."""
    names, *records = rows
    indent = max(cell_len(name) for name in (*names, "reason")) + _GAP
    for record, (_, remark) in zip_longest(records, remarks, fillvalue=("", "")):
        yield Text("")
        pairs = [*zip(names, record, strict=True), *([("reason", remark)] if remark else [])]
        for name, text in pairs:
            first, *others = wrapped(text, max(1, width - indent))
            line = Text(name + " " * (indent - cell_len(name)) + first)
            line.stylize(styles.get(text, ""), indent)
            yield line
            yield from (Text(" " * indent + other) for other in others)
