"""How a table is written: its encoding, and what stands between its cells."""

import csv
from collections.abc import Sequence
from typing import Final

SEPARATORS: Final = "\t;,|"
PROBE_ROWS: Final = 100


def lines_in(text: bytes) -> list[str]:
    """Return the lines of a text in UTF-8 or, where it is not that, in the code page of Windows."""
    try:
        decoded = text.decode("utf-8-sig")
    except UnicodeDecodeError:
        decoded = text.decode("cp1252", "replace")
    return decoded.replace("\r\n", "\n").removesuffix("\n").split("\n")


def cells_of(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a row without blanks around them and without empty ones at its end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)
