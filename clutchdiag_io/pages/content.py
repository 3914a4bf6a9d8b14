"""What pages are made of: texts, tables, figures and sections; how they look is up to templates and style sheet."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A text that leads to another page."""

    text: str
    href: str
    iso: str = ""  # of a text that is a moment


@dataclass(frozen=True, slots=True, kw_only=True)
class Badge:
    """The word of a verdict or state; its style adds a sign and a colour."""

    style: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeCell:
    """A moment as people read it, and all of it for programs."""

    iso: str
    text: str


Cell = str | Number | Link | Badge | TimeCell


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table; the first cell of each row is its name."""

    caption: str
    head: tuple[str | Link, ...]  # a link sorts by its column
    sorted_by: tuple[int, str] | None = None  # place of a column, and ascending or descending
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


def number(value: float | None, form: str = "{:.4f}", *, scale: float = 1.0) -> Cell:
    """Return a number for people and programs, a dash where there is none; people read it times ``scale``."""
    if value is None or not np.isfinite(value):
        return NONE
    text = form.format(value * scale).replace("%", " %")
    return Number(value=float(value), text=text if any(digit in text for digit in "123456789") else text.lstrip("-"))


def moment(value: datetime | None, form: str = "%Y-%m-%d %H:%M") -> Cell:
    """Return an aware moment for people and programs, in UTC; a dash where there is none."""
    if value is None:
        return NONE
    utc = value.astimezone(UTC)
    return TimeCell(iso=utc.isoformat(), text=utc.strftime(form))


def spread(values: FloatArray | Sequence[object], most: int) -> list[int]:
    """Return at most ``most`` places of a sequence, evenly spread, the first and the last among them."""
    count = len(values)
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []
