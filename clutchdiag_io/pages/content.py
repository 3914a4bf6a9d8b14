"""What pages are made of: texts, tables and sections; how they look is up to templates and style sheet."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Final

import numpy as np
import numpy.typing as npt
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from clutchdiag_io.people import digits

FloatArray = npt.NDArray[np.float64]
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
class Section:
    """A part of the page under a title; what is empty is left out."""

    name: str  # of its anchor
    title: str
    texts: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()


def number(value: float | None, form: str = "{:.4f}", *, scale: float = 1.0) -> Cell:
    """Return a number for people and programs, a dash where there is none; people read it times ``scale``.

    Without a form it has the digits that tell something.
    """
    if value is None or not np.isfinite(value):
        return NONE
    text = form.format(value * scale).replace("%", " %").replace("100.0 %", "100 %") if form else digits(value * scale)
    return Number(value=float(value), text=text if any(digit in text for digit in "123456789") else text.lstrip("-"))


def spread(values: FloatArray | Sequence[object], most: int) -> list[int]:
    """Return at most ``most`` places of a sequence, evenly spread, the first and the last among them."""
    count = len(values)
    return sorted(set(np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist())) if count else []


_OWN: Final = "clutchdiag_io.pages"  # brings style.css and parts.html
LONG: Final = 30  # letters: what has more gets a line of its own on a narrow screen


def rows_markup(rows: Iterable[Sequence[Cell]], head: Sequence[str] = ()) -> Markup:
    """Return the rows of a table, a line each; the first cell of each is its head. Every text is escaped.

    With ``head`` each cell carries the name of its column, which a narrow screen shows beside it.
    """
    names = [f' data-name="{escape(one)}"' for one in head]
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
    return f'<data value="{escape(one.value)}">{escape(one.text)}</data>'


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
    made.filters["number"] = lambda value, form="{:.4f}", scale=1.0: Markup(_cell(number(value, form, scale=scale)))  # noqa: S704 - escaped
    return made
