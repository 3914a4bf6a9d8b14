"""Cells of a table: numbers in the marks of their country, units behind them, blanks, words, and what is neither."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.arrays import FloatArray

LEAST_ROWS: Final = 3
MOST_VALUE: Final = 1e30  # beyond, a cell is no measurement, in any unit
LEAST_OF_UNIT: Final = 0.6  # of the cells with a number behind which the same unit stands
BLANKS: Final = frozenset({"", "-", "--", "---", "----", "?", "nan", "na", "n/a", "n.a.", "#n/a", "null", "none"})
MINUS: Final = "\u2212"  # as spreadsheets of some countries write it
WORDS: Final = {"true": 1.0, "on": 1.0, "yes": 1.0, "false": 0.0, "off": 0.0, "no": 0.0}
UNIT_IN_BRACKETS: Final = re.compile(
    r"\s*[\[({<](?P<unit>(?!\d+[\])}>])(?:[^\[\](){}<>]|\([^\[\](){}<>]*\))*)[\])}>]\s*$"
)  # a number is an index
NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?")
GROUPED: Final = {
    mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+(?:\{other}\d*)?") for mark, other in (",.", ".,")
}
"""Numbers whose thousands are grouped by a mark, such as 1,195 or 1.195,5."""
SPACED: Final = re.compile(r"[+-]?\d{1,3}(?:[ '’\u00a0\u202f]\d{3})+(?:[.,]\d*)?")  # 1 195: no mark of decimals
SPACES: Final = re.compile(r"[ '’\u00a0\u202f]")
WITH_UNIT: Final = re.compile(
    r"(?P<number>[+-]?[\d.,]+(?:[ '’\u00a0\u202f]\d{3})*(?:[.,]\d+)?)(?P<blank>\s*)"
    r"(?P<unit>(?:[^\W\d_]|[°%℃℉/])[^\s\d]{0,11}[23²³]?)"
)
WORD: Final = re.compile(r"[^\W\d_]+(?: [^\W\d_]+)*")
PAYLOAD: Final = re.compile(r"(?:0x)?(?:[0-9A-Fa-f]{2}[\s:._-]?){1,64}")
STATUS: Final = re.compile(r"0x(?:[0-9A-Fa-f]{2}){1,2}|[0-9A-Fa-f]{2}")  # bits of a device, or the word AC
LETTERS: Final = re.compile(r"[A-Fa-f]")
REVOLUTIONS: Final = re.compile(r"rpm|drehzahl|1/min|min-1|tr/min|u/min|\bspeed\b.*shaft", re.IGNORECASE)
MOST_REVOLUTIONS: Final = 25_000.0  # a minute, of anything in a car; a shaft that turns a thousandth of it stands


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """Which mark stands before decimals, which one groups thousands, and why that is thought."""

    decimal: str = "."
    grouping: str = ","
    why: str = "points stand before decimals"
    notes: tuple[str, ...] = ()


PLAIN: Final = Marks()


def marks_of(cells: Sequence[Sequence[str]], names: Sequence[str] = (), separator: str = ";") -> Marks:
    """Return what points and commas in numbers mean, by all cells of each column.

    One mark that is followed by other than three digits stands before decimals, in the whole table. One that groups
    shows it by coming twice in a number, beside the other mark, or in a column whose numbers below 1000 have none.
    Where commas separate cells, nobody writes decimals with them unless a number shows it.
    """
    comma, point = (_evidence([[_plain_minus(cell) for cell in column] for column in cells], mark) for mark in ",.")
    if comma.decimals:
        groups = point.grouped and not point.decimals
        note = f"points group thousands: {point.example} has three digits behind it, and commas stand before decimals"
        return Marks(decimal=",", grouping="." if groups else "", why=comma.decimals, notes=(note,) * groups)
    if comma.groups or (comma.grouped and (point.decimals or separator == ",")):
        behind = point.decimals or "commas separate cells"
        return Marks(why=comma.groups or f"commas group thousands, as in {comma.example}: {behind}")
    if point.groups and not point.decimals:
        return Marks(decimal=",", grouping=".", why=point.groups)
    return _likelier(cells, names, comma, point)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Evidence:
    """What the cells of a table say of one mark; empty where they say nothing."""

    decimals: str  # why it stands before decimals
    groups: str  # why it groups thousands
    grouped: bool  # whether numbers have it that may be grouped
    example: str


def _likelier(cells: Sequence[Sequence[str]], names: Sequence[str], comma: "_Evidence", point: "_Evidence") -> Marks:
    """Return what points and commas probably mean where no number shows it."""
    for mark, other, evidence in ((",", ".", comma), (".", ",", point)):
        if evidence.grouped and not evidence.decimals and _are_revolutions(cells, names, mark):
            why = f"{evidence.example} is taken as grouped by thousands: no shaft turns so slowly throughout"
            return Marks(decimal=other, grouping=mark, why=why, notes=(why,))
    if not comma.grouped:
        return PLAIN
    shown = f"{comma.example} is read as {comma.example.replace(',', '.')}"
    note = f"{shown}: nothing shows whether its comma groups thousands"
    return Marks(decimal=",", grouping="", why=note, notes=(note,))


def _evidence(cells: Sequence[Sequence[str]], mark: str) -> _Evidence:
    decimals, groups, example = "", "", ""
    other, word = ("." if mark == "," else ","), "commas" if mark == "," else "points"
    for column in cells:
        marked = [cell for cell in column if mark in cell and cell[0] in "+-.,0123456789"]
        if not marked:
            continue
        grouped = [cell for cell in marked if GROUPED[mark].fullmatch(cell)]
        odd = next((cell for cell in marked if _is_decimal(cell, mark)), "")
        several = next((cell for cell in grouped if cell.count(mark) > 1 or other in cell), "")
        plain = {cell.lstrip("+-") for cell in column if cell.lstrip("+-").isdigit()} - {"0"}
        is_mixed = grouped and not odd and len(plain) > 1 and all(len(cell) <= 3 for cell in plain)
        decimals = decimals or (f"{word} stand before decimals, as in {odd}" if odd else "")
        example = example or (grouped[0] if grouped else "")
        if several or is_mixed:
            behind = "" if several else f", in a column where {max(plain, key=int)} has none"
            groups = groups or f"{word} group thousands, as in {several or grouped[0]}{behind}"
    return _Evidence(decimals=decimals, groups=groups, grouped=bool(example), example=example)


def _is_decimal(cell: str, mark: str) -> bool:
    """Return whether the mark in a number stands before decimals."""
    other = "." if mark == "," else ","
    if other in cell:
        return cell.count(mark) == 1 and GROUPED[other].fullmatch(cell) is not None
    return NUMBER.fullmatch(cell) is not None and GROUPED[mark].fullmatch(cell) is None


def _are_revolutions(cells: Sequence[Sequence[str]], names: Sequence[str], mark: str) -> bool:
    """Return whether a mark is in revolutions a minute alone, and no shaft would turn if it stood before decimals."""
    marked = [
        (name, [float(cell.replace(mark, "")) for cell in column if mark in cell and GROUPED[mark].fullmatch(cell)])
        for name, column in zip(names, cells, strict=False)
    ]
    shown = [(name, values) for name, values in marked if values]
    return bool(shown) and all(REVOLUTIONS.search(name) and max(values) < MOST_REVOLUTIONS for name, values in shown)


def number_in(cell: str, marks: Marks = PLAIN) -> float:
    """Return the number in a cell, NaN for a blank one, infinity for anything that is no measurement."""
    text = cell.strip()
    if text.startswith(MINUS):
        text = _plain_minus(text)
    if marks.grouping and marks.grouping in text and GROUPED[marks.grouping].fullmatch(text):
        text = text.replace(marks.grouping, "")
    elif SPACED.fullmatch(text):
        text = SPACES.sub("", text)
    if NUMBER.fullmatch(text):
        value = float(text.replace(",", "."))
        return value if abs(value) < MOST_VALUE else np.inf
    folded = text.casefold()
    return np.nan if folded in BLANKS else WORDS.get(folded, np.inf)


def _plain_minus(cell: str) -> str:
    return f"-{cell[1:]}" if cell.startswith(MINUS) else cell


def numbers_in(cells: Sequence[str], marks: Marks = PLAIN) -> FloatArray:
    """Return the numbers in cells as `number_in` does, plain ones much faster."""
    together = "".join(cells)
    is_plain = "," not in together and (marks.decimal == "." or "." not in together)
    if is_plain or (marks.decimal == "," and "." not in together):
        plain = cells if is_plain else [cell.replace(",", ".") for cell in cells]
        try:
            values = np.array(plain, np.str_).astype(np.float64) if cells else np.empty(0)
        except ValueError:
            values = np.empty(0)
        if len(values) == len(cells) and np.all(np.abs(values) < MOST_VALUE):
            return values
    return np.array([number_in(cell, marks) for cell in cells], np.float64)


def unit_behind(cells: Iterable[str]) -> str:
    """Return the unit behind most numbers of a column, as in ``12.5 V``; empty if there is none."""
    filled = [cell for cell in cells if cell.casefold() not in BLANKS]
    units = Counter[str]()
    for cell in filled:
        if (behind := WITH_UNIT.fullmatch(cell)) and (behind["blank"] or set(behind["unit"]) - set("ABCDEFabcdefx")):
            units[behind["unit"]] += 1
    unit, count = units.most_common(1)[0] if units else ("", 0)
    return unit if count >= max(LEAST_ROWS, LEAST_OF_UNIT * len(filled)) else ""


def without_unit(cell: str, unit: str) -> str:
    """Return a cell without the unit behind its number."""
    text = cell.strip()
    return text[: -len(unit)].rstrip() if unit and text.endswith(unit) else cell


def words_for_blanks(cells: Sequence[str], marks: Marks = PLAIN) -> list[str] | None:
    """Return the words that a column has beside numbers, as a gear has N; None if words are most of what it has."""
    found = [(cell, number_in(cell, marks)) for cell in cells]
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
