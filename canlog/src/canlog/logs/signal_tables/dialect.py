"""How a table is written: its encoding, and what stands between its cells."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

SEPARATORS: Final = "\t;,|"
NAMES_OF_SEPARATORS: Final = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "blanks"}
PROBE_ROWS: Final = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """What stands between the cells of a row, and why that is thought."""

    separator: str
    why: str = ""

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if self.separator == " ":
            return line.split()
        if '"' not in line:
            return line.split(self.separator)
        try:
            return next(csv.reader([line], delimiter=self.separator), [])
        except csv.Error:
            return []


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Return how the cells of a table are separated: by what most of its first lines have."""
    probe = lines[:PROBE_ROWS]
    separator = max(SEPARATORS, key=lambda mark: sum(mark in line for line in probe))
    count = sum(separator in line for line in probe)
    return Dialect(separator=separator, why=f"{NAMES_OF_SEPARATORS[separator]} in {count} of {len(probe)} lines")


def lines_in(text: bytes) -> list[str]:
    """Return the lines of a text in UTF-8 or, where it is not that, in the code page of Windows."""
    try:
        decoded = text.decode("utf-8-sig")
    except UnicodeDecodeError:
        decoded = text.decode("cp1252", "replace")
    return decoded.replace("\r\n", "\n").removesuffix("\n").split("\n")


def stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a row without blanks around them and without empty ones at its end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)
