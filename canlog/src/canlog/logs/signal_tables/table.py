"""Which of the many ways a table is written in, and what its columns are: one stage after the other says so.

dialect -> header -> marks of numbers -> clock -> columns
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.cells import (
    LEAST_ROWS,
    NUMBER,
    STATUS,
    Marks,
    is_payload,
    marks_of,
    unit_behind,
    without_unit,
)
from canlog.logs.signal_tables.clock import NoRowClock, TimeReading, clock_of, stated_clock
from canlog.logs.signal_tables.columns import plan_of_columns, plan_of_values
from canlog.logs.signal_tables.dialect import PROBE_ROWS, Dialect, dialect_of, is_comment, lines_in, stripped
from canlog.logs.signal_tables.header import HeaderRows, is_header_row, signal_columns, with_units_of_names
from canlog.logs.signal_tables.layouts import LAYOUTS, Sheet, Stated

PROBE_BYTES: Final = 64 * 1024  # as many as detection sees
RAGGED: Final = 0.1  # of all rows: if so many are short, their empty cells were left out; fewer are damage
TROUBLE_CODE: Final = re.compile(r"[PCBU][0-3][0-9A-F]{3}(?:[-:][0-9A-F]{2})?")
LEAST_CODES: Final = 0.5  # of the rows of a list of them


@dataclass(frozen=True, slots=True, kw_only=True)
class TableHeader:
    """How a table is written, and what its columns are."""

    dialect: Dialect
    marks: Marks
    lines: int  # before the first row of values
    width: int  # cells of a row
    is_ragged: bool  # rows end with their last filled cell
    time_place: int
    clocks: Mapping[int, TimeReading]  # how the times in a place are read
    date_place: int | None  # of the days, where times of day have a column of their own
    is_month_first: bool  # in it
    base_us: float  # what times count from
    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]  # of the columns in a row; where a row has one value: that of the values
    clock_places: tuple[int, ...]  # of the times of each column
    worded: frozenset[int]  # those where words are no values
    units_behind: Mapping[int, str]  # the numbers in these places
    notes: tuple[str, ...]
    reasons: tuple[str, ...]  # what each stage decided
    repeated: frozenset[tuple[str, ...]]  # rows of words before the values, which may stand again between them
    clock_words: frozenset[str]  # those of the header in the place of times
    names: tuple[str, ...]  # the cells that name the columns
    name_place: int | None  # of the name of the signal, where a row has one value

    def row(self, cells: list[str]) -> list[str]:
        """Return the cells of a row without surplus empty ones, and with those that it left out if rows do so."""
        while len(cells) > self.width and not cells[-1]:
            cells.pop()
        is_short = self.is_ragged and 1 < len(cells) < self.width
        return [*cells, *[""] * (self.width - len(cells))] if is_short else cells


@dataclass(frozen=True, slots=True, kw_only=True)
class NoTable:
    """Why a text is no table of signals; empty if it does not even look like one."""

    why: str = ""
    is_list: bool = False  # of trouble codes or of other things: whatever its columns are, it is no log


def table_header(text: bytes) -> TableHeader | None:
    """Return what the beginning of a text says of the table that it is; None if it is none."""
    table = table_of(text)
    return table if isinstance(table, TableHeader) else None


def table_of(text: bytes) -> TableHeader | NoTable:
    """Return what the beginning of a text says of the table that it is, or why it is none.

    A header names two columns or more, one of them holds times that rise, and most cells of others are numbers. Whole
    lines of a probe tell it, or all of a shorter text, so that whoever detects a table and whoever reads it find the
    same columns.
    """
    is_all = len(text) < PROBE_BYTES
    return _table_in(text if is_all else text[: text.rfind(b"\n", 0, PROBE_BYTES) + 1], is_all=is_all)


@lru_cache(maxsize=4)  # whoever detects a table, lists its columns and reads it asks for the same
def _table_in(text: bytes, *, is_all: bool) -> TableHeader | NoTable:
    lines = lines_in(text)
    dialect = dialect_of(lines)
    rows = [dialect.cells(line) for line in lines]
    if codes := _trouble_codes(rows):
        return NoTable(why=f"it lists trouble codes ({codes}, ...): no log", is_list=True)
    is_cut = is_all and not text.endswith(b"\n")
    sheet = Sheet(lines=lines, rows=_without_cut_cell(rows, is_cut=is_cut), dialect=dialect)
    refused = list[NoTable]()
    for layout in LAYOUTS:
        for stated in layout(sheet):
            table = _table_below(sheet, stated, is_cut=is_cut)
            if isinstance(table, TableHeader):
                return table
            refused.append(table)
    if not refused and _are_values(rows):
        return NoTable(why="no line names the columns: put one with their names before the rows, such as Time,RPM")
    return next((refusal for refusal in refused if refusal.is_list or refusal.why), NoTable())


def _are_values(rows: Sequence[Sequence[str]]) -> bool:
    """Return whether the first rows hold numbers alone, and more than one each."""
    filled = [cells for row in rows[:PROBE_ROWS] if (cells := stripped(row))]
    return len(filled) >= LEAST_ROWS and all(len(row) > 1 and all(map(NUMBER.fullmatch, row)) for row in filled)


def _trouble_codes(rows: Sequence[Sequence[str]]) -> str:
    """Return the first trouble codes of a list of them; empty if a text is none."""
    listed = [cells for row in rows[:PROBE_ROWS] if len(cells := stripped(row)) > 1]
    codes = [cell for cells in listed for cell in cells[:3] if TROUBLE_CODE.fullmatch(cell)]
    is_list = len(codes) >= LEAST_CODES * (len(listed) - 1) and 2 * len(set(codes)) > len(codes)
    return ", ".join(codes[:2]) if codes and is_list else ""


class _Body(NamedTuple):
    """The first rows of values: the cells of each column, and what they say of the rows."""

    cells: list[list[str]]
    is_ragged: bool
    notes: tuple[str, ...] = ()


def _table_below(sheet: Sheet, stated: Stated, *, is_cut: bool) -> TableHeader | NoTable:
    """Return the table whose header this is, or why it is none."""
    header = stated.header
    rows = sheet.rows
    if header.dialect != sheet.dialect:
        rows = _without_cut_cell([header.dialect.cells(line) for line in sheet.lines], is_cut=is_cut)
    body = _body_of(rows, header)
    if isinstance(body, NoTable):
        return body
    columns, notes = signal_columns(header.names, header.units)
    behind = {place: unit for place, column in enumerate(body.cells) if (unit := unit_behind(column))}
    cells = [
        [without_unit(cell, behind[place]) for cell in column] if place in behind else column
        for place, column in enumerate(body.cells)
    ]
    columns = [SignalColumn(column.name, column.unit or behind.get(place, "")) for place, column in enumerate(columns)]
    columns = with_units_of_names(columns)
    marks = marks_of(cells, [f"{column.name} {column.unit}" for column in columns], header.dialect.separator)
    payloads = [place for place, column in enumerate(cells) if is_payload(column)]
    if places := header.clock_places:
        clock = stated_clock(places, stated.reading, columns, cells, marks)
    else:
        clock = clock_of(columns, cells, marks, payloads)
    is_list = isinstance(clock, NoRowClock) and clock.is_list
    of_frames = (not STATUS.fullmatch(cell) for place in payloads for cell in cells[place] if cell)
    if not is_list and (len(payloads) > 1 or any(of_frames)):
        return NoTable(why=f"{columns[payloads[0]].name!r} holds bytes of frames")
    if isinstance(clock, NoRowClock):
        return NoTable(why=clock.why, is_list=is_list)
    plan = plan_of_values(header.names, cells, clock, marks)
    if plan is None:
        plan = plan_of_columns(columns, cells, clock, payloads, header.clock_places, marks)
    if not plan.columns:
        return NoTable(why="no column but that of times holds numbers")
    place, words = clock.place, rows[header.place : header.first]
    return TableHeader(
        dialect=header.dialect, marks=marks, lines=header.first, width=len(header.names), is_ragged=body.is_ragged,
        time_place=place, clocks=plan.clocks, date_place=clock.date_place, is_month_first=clock.is_month_first,
        base_us=stated.base_us, columns=plan.columns, places=plan.places, clock_places=plan.clock_places,
        worded=plan.worded, units_behind=behind, name_place=plan.name_place, names=header.names,
        notes=(*header.notes, *marks.notes, *body.notes, *clock.notes, *notes, *plan.notes),
        reasons=(header.dialect.why, header.why, marks.why, clock.why),
        repeated=frozenset(stripped(row) for row in rows[: header.first] if _has_words(row)),
        clock_words=frozenset(row[place].strip() for row in words if len(row) > place) - {""},
    )  # fmt: skip


def _without_cut_cell(rows: Sequence[Sequence[str]], *, is_cut: bool) -> Sequence[Sequence[str]]:
    """Return rows without the last cell if the text ends in it: some of it may be missing."""
    return [*rows[:-1], [*rows[-1][:-1], ""]] if is_cut and rows[-1] else rows


def _has_words(row: Sequence[str]) -> bool:
    cells = stripped(row)
    return len(cells) > 1 and not any(NUMBER.fullmatch(cell) for cell in cells)


def _body_of(rows: Sequence[Sequence[str]], header: HeaderRows) -> _Body | NoTable:
    """Return the first rows of values, up to another header of the same recorder."""
    width = len(header.names)
    repeated = frozenset(map(stripped, rows[header.place : header.first]))
    called, filled = {name.strip() for name in header.names} - {""}, list[Sequence[str]]()
    for row in rows[header.first :]:
        if any(row) and stripped(row) not in repeated and not is_comment(row):
            is_same = 2 * len(called.intersection(stripped(row))) >= max(len(called), 2)
            if is_same or (len(filled) >= LEAST_ROWS and is_header_row(row)):
                break  # another header
            filled.append(row)
    whole = [row[:width] for row in filled if len(row) >= width and not any(row[width:])]
    short = [[*row, *[""] * (width - len(row))] for row in filled if 1 < len(row) < width]
    is_ragged = len(short) >= max(LEAST_ROWS, RAGGED * len(filled)) and bool(whole)
    notes = (f"{len(short)} of the first {len(filled)} rows end before their last cells, which are empty",) * is_ragged
    body = [row for row in (_padded(row, width) for row in filled) if row] if is_ragged else whole
    if len(body) < LEAST_ROWS or len(body) < len(filled) / 2:
        counts = sorted({len(row) for row in filled})
        why = f"line {header.place + 1} names {width} columns, and rows have {', '.join(map(str, counts[:3]))} cells"
        return NoTable(why=why if len(filled) >= LEAST_ROWS else "")
    return _Body([[row[place].strip() for row in body] for place in range(width)], is_ragged, notes)


def _padded(row: Sequence[str], width: int) -> list[str]:
    """Return a row with its empty cells at the end; an empty one if it has too many, or no cells at all."""
    if len(row) < 2 or any(row[width:]):
        return []
    return [*row, *[""] * (width - len(row))][:width]
