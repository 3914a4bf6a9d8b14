"""What pages are made of: texts, tables, figures and sections; how they look is up to templates and style sheet."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import zip_longest
from typing import Final

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from canlog.arrays import FloatArray
from clutchdiag_io.people import digits, moment_words

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
    """Return a number for people and programs, a dash where there is none; people read it times ``scale``.

    Without a form it has the digits that tell something.
    """
    if value is None or not np.isfinite(value):
        return NONE
    text = form.format(value * scale).replace("%", " %").replace("100.0 %", "100 %") if form else digits(value * scale)
    return Number(value=float(value), text=text if any(digit in text for digit in "123456789") else text.lstrip("-"))


def moment(value: datetime | None, form: str = "%Y-%m-%d %H:%M") -> Cell:
    """Return an aware moment for people and programs, in UTC; a dash where there is none."""
    if value is None:
        return NONE
    return TimeCell(iso=value.astimezone(UTC).isoformat(), text=moment_words(value, form))


def spread(values: FloatArray | Sequence[object], most: int) -> list[int]:
    """Return at most ``most`` places of a sequence, evenly spread, the first and the last among them."""
    count = len(values)
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []


_OWN: Final = "clutchdiag_io.pages"  # brings style.css and parts.html
LONG: Final = 30  # letters: what has more gets a line of its own on a narrow screen
_POLICY: Final = "; ".join(
    (
        *("default-src 'none'", "style-src 'self'", "script-src 'self'", "connect-src 'self'", "img-src 'self'"),
        *("form-action 'self'", "base-uri 'none'", "frame-ancestors 'none'"),
    )
)
SAFE_HEADERS: Final = (
    ("content-security-policy", _POLICY),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "same-origin"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    ("permissions-policy", "camera=(), geolocation=(), microphone=()"),
)


def host_of(header: str) -> str:
    """Return the name, without a port, by which a request calls the server: what its header ``Host`` says."""
    host = header.casefold()
    if host.startswith("["):
        return host.partition("]")[0] + "]"
    return host.rpartition(":")[0] if ":" in host else host


def rows_markup(rows: Iterable[Sequence[Cell]], head: Sequence[str | Link] = ()) -> Markup:
    """Return the rows of a table, a line each; the first cell of each is its head. Every text is escaped.

    With ``head`` each cell carries the name of its column, which a narrow screen shows beside it.
    """
    names = [f' data-name="{escape(one.text if isinstance(one, Link) else one)}"' for one in head]
    lines = []
    for row in rows:
        wide = [' class="wide"' if names and isinstance(one, str) and len(one) > LONG else "" for one in row]
        cells = zip_longest(names[: len(row)], wide, map(_cell, row), fillvalue="")
        first, *others = (f"{name}{width}>{text}" for name, width, text in cells)
        lines.append(f'<tr><th scope="row"{first}</th>{"".join(f"<td{one}</td>" for one in others)}</tr>\n')
    return Markup("".join(lines))  # noqa: S704 - of escaped parts


def _cell(one: Cell) -> str:
    if isinstance(one, str):
        return escape(one.strip())
    if isinstance(one, Number):
        return f'<data value="{escape(one.value)}">{escape(one.text)}</data>'
    if isinstance(one, Link):
        text = f'<time datetime="{escape(one.iso)}">{escape(one.text)}</time>' if one.iso else escape(one.text)
        return f'<a href="{escape(one.href)}">{text}</a>'
    if isinstance(one, TimeCell):
        return f'<time datetime="{escape(one.iso)}">{escape(one.text)}</time>'
    badge: Badge = one
    return f'<span class="{escape(badge.style)}"><strong class="badge">{escape(badge.text)}</strong></span>'


def templates_of(package: str) -> Environment:
    """Return the templates of a package's folder ``templates``, and behind them those that all pages share."""
    made = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(_OWN)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["rows"] = rows_markup
    return made
