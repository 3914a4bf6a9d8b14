"""What stands on the page of a report: sections of texts, tables and figures; how it looks is the template's matter."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from markupsafe import Markup

from canlog.arrays import FloatArray

NONE: Final = "–"


@dataclass(frozen=True, slots=True, kw_only=True)
class Number:
    """A number as people read it, and all of its digits for programs."""

    value: float
    text: str


Cell = str | Number


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table; the first cell of each row is its name."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """What a line of a picture stands for."""

    style: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A picture with what its lines stand for, and the same in numbers."""

    picture: Markup
    caption: str
    keys: tuple[Key, ...]
    table: Table


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of the page under a title; what is empty is left out."""

    name: str  # of its anchor
    title: str
    texts: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """The sentence on one clutch, and the word of its verdict."""

    condition: str  # style of its badge
    word: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A whole report."""

    title: str
    subtitle: str
    advice: tuple[Advice, ...]
    sections: tuple[Section, ...]
    record: object  # the same for programs, as JSON has it


def number(value: float | None, form: str = "{:.4f}") -> Cell:
    """Return a number for people and programs; a dash where there is none."""
    if value is None or not np.isfinite(value):
        return NONE
    return Number(value=float(value), text=form.format(value).replace("%", " %"))


def spread(values: FloatArray | Sequence[float], most: int) -> list[int]:
    """Return at most ``most`` places of a sequence, evenly spread, the first and the last among them."""
    count = len(values)
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []
