"""Templates become text: everything in them is escaped, and a name that is not there is an error."""

from collections.abc import Iterable, Sequence
from itertools import zip_longest
from typing import Final

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from clutchdiag_io.pages.content import Badge, Cell, Link, Number, TimeCell

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
