"""How a table is written: its encoding, and what stands between its cells."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

SEPARATORS: Final = "\t;,|"
NAMES_OF_SEPARATORS: Final = {
    "\t": "tabs",
    ";": "semicolons",
    ",": "commas",
    "|": "bars",
    " ": "blanks",
    "  ": "columns of blanks",
}
PROBE_ROWS: Final = 100
LEAST_QUOTED: Final = 0.5  # of the lines that begin and end with a mark: it quotes cells
LEAST_OF_BLANKS: Final = 0.5  # of the lines that hold numbers alone: what stands between these separates cells
SEVERAL_BLANKS: Final = re.compile(r"\s{2,}")
VALUE_BETWEEN_BLANKS: Final = re.compile(r"[-+\d][-+\d.,:eE]*|-|nan", re.IGNORECASE)
COMMENTS: Final = ("#", "//", "%")
FAULTS_OF_SPREADSHEETS: Final = re.compile(r"#(?:N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)", re.IGNORECASE)
BYTE_ORDER_MARK: Final = "\ufeff"  # also where files were joined


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """What stands between the cells of a row, what quotes them, and why that is thought."""

    separator: str
    quote: str = '"'
    why: str = ""

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line; some programs quote a line as a whole."""
        if self.separator == " ":
            return line.split()
        if self.separator == "  ":
            return SEVERAL_BLANKS.split(line.strip())
        if self.quote not in line:
            return line.split(self.separator)
        cells = self._unquoted(line)
        return self._unquoted(cells[0]) if len(cells) == 1 and self.separator in cells[0] else cells

    def _unquoted(self, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self.separator, quotechar=self.quote), [])
        except csv.Error:
            return []


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Return how the cells of a table are separated: by what most of its first lines have, at worst by blanks."""
    probe = lines[:PROBE_ROWS]
    separator = max(SEPARATORS, key=lambda mark: sum(mark in line for line in probe))
    count = sum(separator in line for line in probe)
    if 2 * count < len(probe) and (blanks := _blanks_between(probe)):
        separator, count = blanks, len(probe)
    quoted = sum(len(line) > 1 and line.startswith("'") and line.endswith("'") for line in probe)
    return Dialect(
        separator=separator,
        quote="'" if quoted > LEAST_QUOTED * len(probe) else '"',
        why=f"{NAMES_OF_SEPARATORS[separator]} in {count} of {len(probe)} lines",
    )


def _blanks_between(lines: Sequence[str]) -> str:
    """Return which blanks separate the cells of lines that hold numbers alone; empty where few lines do."""
    filled = [line.strip() for line in lines if line.strip()]
    numbers = [line for line in filled if len(parts := line.split()) > 1 and all(map(_is_between_blanks, parts))]
    if len(numbers) < LEAST_OF_BLANKS * len(filled):
        return ""
    has_several = all(len(SEVERAL_BLANKS.split(line)) == len(line.split()) for line in numbers)
    return "  " if numbers and has_several else " "


def _is_between_blanks(part: str) -> bool:
    return VALUE_BETWEEN_BLANKS.fullmatch(part) is not None


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a row between those of values is a remark."""
    first = cells[0].lstrip() if cells else ""
    return first.startswith(COMMENTS) and FAULTS_OF_SPREADSHEETS.match(first) is None


def lines_in(text: bytes) -> list[str]:
    """Return the lines of a text in UTF-8 or, where it is not that, in the code page of Windows."""
    try:
        decoded = text.decode()
    except UnicodeDecodeError:
        decoded = text.removeprefix(BYTE_ORDER_MARK.encode()).decode("cp1252", "replace")
    return decoded.replace(BYTE_ORDER_MARK, "").replace("\r\n", "\n").removesuffix("\n").split("\n")


def stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a row without blanks around them and without empty ones at its end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)
