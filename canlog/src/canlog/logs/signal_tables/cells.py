"""Cells of a table: numbers, blanks, words, and what is neither."""

import math
import re
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

LEAST_ROWS: Final = 3
MOST_VALUE: Final = 1e30  # beyond, a cell is no measurement, in any unit
BLANKS: Final = frozenset({"", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none"})
WORDS: Final = {"true": 1.0, "on": 1.0, "yes": 1.0, "false": 0.0, "off": 0.0, "no": 0.0}
UNIT_IN_BRACKETS: Final = re.compile(r"\s*[\[(](?P<unit>(?!\d+[\])])[^\[\]()]*)[\])]\s*$")  # a number is an index
GROUPED: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?")  # 1,195
NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?")
WORD: Final = re.compile(r"[^\W\d_]+(?: [^\W\d_]+)*")
PAYLOAD: Final = re.compile(r"(?:0x)?(?:[0-9A-Fa-f]{2}[\s:._-]?){1,64}")
STATUS: Final = re.compile(r"0x(?:[0-9A-Fa-f]{2}){1,2}|[0-9A-Fa-f]{2}")  # bits of a device, or the word AC
LETTERS: Final = re.compile(r"[A-Fa-f]")


def number_in(cell: str) -> float:
    """Return the number in a cell, NaN for a blank one, infinity for anything that is no measurement."""
    text = cell.strip()
    if NUMBER.fullmatch(text):
        value = float(text.replace(",", "."))
        return value if abs(value) < MOST_VALUE else np.inf
    folded = text.casefold()
    return np.nan if folded in BLANKS else WORDS.get(folded, np.inf)


def ungrouped(cells: Iterable[str]) -> list[str]:
    return [cell.replace(",", "") if "," in cell and GROUPED.fullmatch(cell.strip()) else cell for cell in cells]


def words_for_blanks(cells: Sequence[str]) -> list[str] | None:
    """Return the words that a column has beside numbers, as a gear has N; None if words are most of what it has."""
    found = [(cell, number_in(cell)) for cell in cells]
    words, count = [cell for cell, one in found if math.isinf(one)], sum(math.isfinite(one) for _, one in found)
    if min(len(words), count) >= LEAST_ROWS and all(map(WORD.fullmatch, words)):
        return sorted(set(words))
    return [] if len(words) <= count else None


def is_payload(cells: Sequence[str]) -> bool:
    """Return whether a column holds bytes of frames, some of them with letters as digits."""
    filled = [cell for cell in cells if cell]
    of_bytes = [cell for cell in filled if PAYLOAD.fullmatch(cell)]
    has_letters = any(LETTERS.search(cell.removeprefix("0x")) and not NUMBER.fullmatch(cell) for cell in of_bytes)
    return has_letters and len(of_bytes) > len(filled) / 2
