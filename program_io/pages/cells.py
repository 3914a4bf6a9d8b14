"""Rows of tables as HTML: pages have thousands of cells, for which templates take several times as long."""

from collections.abc import Iterable

from markupsafe import Markup, escape

from program_io.pages.content import Badge, Cell, Link, Moment, Number


def rows_markup(rows: Iterable[Iterable[Cell]]) -> Markup:
    """Return the rows of a table, a line each; the first cell of each is its head. Every text is escaped."""
    lines = []
    for row in rows:
        head, *others = map(_cell, row)
        lines.append(f'<tr><th scope="row">{head}</th>{"".join(f"<td>{one}</td>" for one in others)}</tr>\n')
    return Markup("".join(lines))  # noqa: S704 - of escaped parts


def _cell(one: Cell) -> str:
    if isinstance(one, str):
        return escape(one.strip())
    if isinstance(one, Number):
        return f'<data value="{escape(one.value)}">{escape(one.text)}</data>'
    if isinstance(one, Link):
        return f'<a href="{escape(one.href)}">{escape(one.text)}</a>'
    if isinstance(one, Moment):
        return f'<time datetime="{escape(one.iso)}">{escape(one.text)}</time>'
    badge: Badge = one
    return f'<span class="{escape(badge.style)}"><strong class="badge">{escape(badge.text)}</strong></span>'
