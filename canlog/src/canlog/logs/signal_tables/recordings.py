"""Recordings one behind the other in a file: headers that come again, other headers, and clocks that begin again."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.clock import time_places
from canlog.logs.signal_tables.dialect import is_comment, stripped
from canlog.logs.signal_tables.header import is_header_row
from canlog.logs.signal_tables.table import PROBE_BYTES, TableHeader, table_header

BEGINS_WITH_WORD: Final = re.compile(r"[\s\"';,|#]*[^\W\d]")  # of lines, all that may be headers
LINES_OF_PROBE: Final = 400
MOST_HEADER_LINES: Final = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class LaterHeader:
    """A header between rows, and where the cells of the first one are behind it."""

    order: tuple[int | None, ...] | None = None  # None: where they were
    is_unknown: bool = False  # it has no times, or none of the columns
    new_names: frozenset[str] = frozenset()  # that the first header has not

    def in_order(self, cells: Sequence[str]) -> Sequence[str]:
        """Return the cells of a row behind it in the order of the first header."""
        if self.order is None:
            return cells
        return ["" if place is None else "".join(cells[place : place + 1]) for place in self.order]


AS_BEFORE = LaterHeader()


def later_header(cells: Sequence[str], header: TableHeader) -> LaterHeader | None:
    """Return what a row between those of values says if it is a header: the first one again, or another one."""
    time = "".join(cells[header.time_place : header.time_place + 1]).strip()
    if time[:1].isdigit():  # of nearly all rows, and of no header
        return None
    if stripped(cells) in header.repeated:
        return AS_BEFORE
    if time not in header.clock_words:
        return None
    places = {name.strip(): place for place, name in reversed(list(enumerate(cells)))}
    order = tuple(places.get(name.strip()) for name in header.names)
    has_columns = any(order[place] is not None for place in header.places)
    return LaterHeader(
        order=order,
        is_unknown=order[header.time_place] is None or not has_columns,
        new_names=frozenset(places.keys() - {name.strip() for name in header.names} - {""}),
    )


def is_other_header(rows: Sequence[Sequence[str]], before: TableHeader) -> bool:
    """Return whether rows begin with words that are not all those of the header before."""
    if before.name_place is not None or not rows or is_comment(rows[0]) or not is_header_row(rows[0]):
        return False
    filled = [cells for row in rows if (cells := stripped(row))]
    stop = next((number for number, row in enumerate(filled) if not is_header_row(row)), len(filled))
    return not all(row in before.repeated for row in filled[:stop])


def other_header(lines: Sequence[str], before: TableHeader, known: Mapping[str, SignalColumn]) -> TableHeader | None:
    """Return the header of a recording of other columns or units; None if these lines do not begin with one.

    Parameters
    ----------
    lines
        The first of them is the first row of that header; its lines are counted from there.
    before
        What the rows until here are.
    known
        All columns until here, by their names. One that has another unit now is another column, and told.
    """
    text = "\n".join(lines[:LINES_OF_PROBE])
    found = table_header(f"{text}\n".encode()[:PROBE_BYTES])
    rows = [before.dialect.cells(line) for line in lines[:MOST_HEADER_LINES]]
    if found is None or found.name_place is not None or found.lines > len(rows):
        return None
    clock = found.names[found.time_place]
    is_named = bool(time_places([clock])) or clock == before.names[before.time_place]
    if not is_named or any(_has_value(row, before) for row in rows[: found.lines]):
        return None
    columns, notes = list[SignalColumn](), list[str]()
    for column in found.columns:
        former = known.get(column.name)
        if former is None or former.unit == column.unit or not (former.unit and column.unit):
            columns.append(column)
            continue
        columns.append(SignalColumn(f"{column.name} ({column.unit})", column.unit))
        notes.append(
            f"{column.name!r} is in {column.unit} in a later recording, not in {former.unit}: there it is"
            f" {columns[-1].name!r}"
        )
    return replace(found, columns=tuple(columns), notes=(*found.notes, *notes))


def _has_value(row: Sequence[str], header: TableHeader) -> bool:
    """Return whether a row is one of values, as far as its time tells."""
    return len(row) == header.width and row[header.time_place].strip()[:1].isdigit()


def first_rows(clocks: Sequence[FloatArray], behind_header: Sequence[int]) -> list[int]:
    """Return the rows with which recordings begin: the first one, those behind a header, and where all clocks fall.

    Parameters
    ----------
    clocks
        The times of each clock [us], (n,) arrays, NaN where there is none.
    behind_header
        The rows behind a header.
    """
    count = len(clocks[0])
    falls: BoolArray = np.zeros(count, np.bool_)
    if len(clocks) > 1:
        told, fallen = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for time_us in clocks:
            rows = np.flatnonzero(np.isfinite(time_us))
            told[rows[1:]] += 1
            fallen[rows[1:]] += np.diff(time_us[rows]) < 0.0
        falls = (told > 0) & (fallen == told)
    return sorted({0, *np.flatnonzero(falls).tolist(), *(row for row in behind_header if row < count)})
