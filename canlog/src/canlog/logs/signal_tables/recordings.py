"""Recordings one behind the other in a file: headers that come again, and clocks that begin again."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canlog.arrays import BoolArray, FloatArray
from canlog.logs.signal_tables.dialect import stripped
from canlog.logs.signal_tables.table import TableHeader


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
