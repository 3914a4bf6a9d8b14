"""Which of the many ways a table is written in, and what its columns are."""

import math
import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.cells import GROUPED, LEAST_ROWS, NUMBER, STATUS, is_payload, ungrouped, words_for_blanks
from canlog.logs.signal_tables.clock import (
    MOST_PACE,
    TIME_OF_DAY,
    clock_us,
    clocks_of_groups,
    moment_us,
    pace,
    rises,
    time_places,
)
from canlog.logs.signal_tables.dialect import PROBE_ROWS, SEPARATORS, cells_of, lines_in, stripped
from canlog.logs.signal_tables.header import (
    HALTECH,
    HALTECH_UNITS,
    MOST_COLUMNS,
    PREAMBLE_ROWS,
    are_units,
    names_of,
    signal_columns,
    stacked,
)

PROBE_BYTES: Final = 64 * 1024  # as many as detection sees
LONG_NAMES: Final = frozenset({"pid", "pidname", "name", "signal", "signalname", "channel", "parameter", "sensor"})
LONG_VALUES, LONG_UNITS = frozenset({"value", "wert"}), frozenset({"unit", "units", "einheit"})


@dataclass(frozen=True, slots=True, kw_only=True)
class TableHeader:
    """How a table is written, and what its columns are."""

    separator: str
    lines: int  # before the first row of values
    width: int  # cells of a row
    time_place: int
    clocks: Mapping[int, float | None]  # microseconds per unit of the times in a place; None: times of day or dates
    has_decimal_comma: bool
    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]  # of the columns in a row; where a row has one value: that of the values
    clock_places: tuple[int, ...]  # of the times of each column
    worded: frozenset[int]  # those where words are no values
    notes: tuple[str, ...]
    repeated: frozenset[tuple[str, ...]]  # its cells, and units, which may stand again between rows
    clock_words: frozenset[str]  # those of them in the place of times
    names: tuple[str, ...] = ()  # the cells that name the columns
    name_place: int | None = None  # of the name of the signal, where a row has one value
    base_us: float = 0.0  # what times of day count from


def table_header(text: bytes) -> TableHeader | None:
    """Return what the beginning of a text says of the table that it is; None if it is none.

    A header names two columns or more, one of them holds times that rise, and most cells of others are numbers. Whole
    lines of a probe tell it, or all of a shorter text, so that whoever detects a table and whoever reads it find the
    same columns.
    """
    is_all = len(text) < PROBE_BYTES
    lines = lines_in(text if is_all else text[: text.rfind(b"\n", 0, PROBE_BYTES) + 1])
    separator = max(SEPARATORS, key=lambda one: sum(one in line for line in lines[:PROBE_ROWS]))
    rows = [cells_of(line, separator) for line in lines]
    if is_all and rows[-1] and not text.endswith(b"\n"):
        rows[-1][-1] = ""  # may be cut off
    if lines[0].strip() == HALTECH:
        return _haltech_header(lines, rows)
    for place in range(min(PREAMBLE_ROWS, len(rows))):
        if len(rows[place]) > 1 and (header := _header_at(rows, place, separator)) is not None:
            return header
    return None


def _header_at(rows: Sequence[Sequence[str]], place: int, separator: str) -> TableHeader | None:
    """Return the header that a row is, with the row of units that may follow it; None if it is none."""
    names, units, first = stacked(rows, place) or (names_of(rows, place, separator), (), place + 1)
    width = len(names)
    if not 1 < width <= MOST_COLUMNS or any(NUMBER.fullmatch(name.strip()) for name in names):
        return None
    if not units:
        while len(rows) > first and are_units(rows[first], width):  # the last: types may stand before it
            units, first = rows[first], first + 1
            if any(len(units[clock]) > 1 for clock in time_places(units, ())) and not time_places(names, ()):
                return None  # that is the header, and this a line before it
    return _header_of(rows, names, units, place, first, separator)


def _haltech_header(lines: Sequence[str], rows: Sequence[Sequence[str]]) -> TableHeader | None:
    """Return the header of an export of Haltech's NSP: lines of keys, then rows that begin with a time of day."""
    first = next((n for n, row in enumerate(rows) if row and TIME_OF_DAY.fullmatch(row[0].strip())), len(rows))
    names, units, day_us = ["Time"], [""], 0.0
    for line in lines[:first]:
        key, _, value = (part.strip() for part in line.partition(" : "))
        if key == "Channel":
            names.append(value)
            units.append("")
        elif key == "Type":
            units[-1] = HALTECH_UNITS.get(value, "")
        elif key == "Log" and (day := re.match(r"(\d{4})(\d\d)(\d\d)\b", value)):
            midnight_us, _ = moment_us(f"{'-'.join(day.groups())} 00:00:00")
            day_us = midnight_us if math.isfinite(midnight_us) else 0.0
    cells = [line.split(",") for line in lines]
    header = _header_of(cells, names, units, first, first, ",") if len(names) > 1 else None
    return None if header is None else replace(header, base_us=day_us)


def _header_of(
    rows: Sequence[Sequence[str]], names: Sequence[str], units: Sequence[str], place: int, first: int, separator: str
) -> TableHeader | None:
    """Return the header whose names and units are these, in rows up to the first of values; None if it is none."""
    width = len(names)
    repeated = frozenset(map(stripped, rows[place:first]))
    called, filled = {name.strip() for name in names} - {""}, list[Sequence[str]]()
    for row in rows[first:]:
        if any(row) and stripped(row) not in repeated:
            if 2 * len(called.intersection(stripped(row))) >= max(len(called), 2):
                break  # another header of the same recorder
            filled.append(row)
    body = [row[:width] for row in filled if len(row) >= width and not any(row[width:])]
    if len(body) < LEAST_ROWS or len(body) < len(filled) / 2:
        return None
    cells = [[row[index].strip() for row in body] for index in range(width)]
    commas = [cell for column in cells for cell in column if "," in cell and NUMBER.fullmatch(cell)]
    has_comma = any(separator != "," or not GROUPED.fullmatch(cell) for cell in commas)
    if separator == "," and not has_comma:
        cells = [ungrouped(column) for column in cells]
    payloads = [index for index in range(width) if is_payload(cells[index])]
    is_traffic = len(payloads) > 1 or any(
        not STATUS.fullmatch(cell) for index in payloads for cell in cells[index] if cell
    )
    clock = next((index for index in time_places(names) if rises(cells[index])), None)
    if is_traffic or clock is None:
        return None
    columns, notes = signal_columns(names, units)
    time_us, unit, time_notes = clock_us(cells[clock], columns[clock])
    plan = _plan_of_values(names, cells, clock, unit)
    if plan is None:
        plan = _plan_of_columns(columns, cells, (clock, unit, time_us), payloads)
    if not plan.columns:
        return None
    return TableHeader(
        separator=separator, lines=first, width=width, time_place=clock, clocks=plan.clocks, columns=plan.columns,
        has_decimal_comma=has_comma, places=plan.places, clock_places=plan.clock_places, worded=plan.worded,
        name_place=plan.name_place, names=tuple(names), notes=(*time_notes, *notes, *plan.notes), repeated=repeated,
        clock_words=frozenset("".join(row[clock : clock + 1]).strip() for row in rows[place:first]) - {""},
    )  # fmt: skip


class _Plan(NamedTuple):
    """Which cells of a row are values of what, and where their times are; as in `TableHeader`."""

    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]
    clocks: Mapping[int, float | None]
    clock_places: tuple[int, ...]
    worded: frozenset[int] = frozenset()
    name_place: int | None = None
    notes: tuple[str, ...] = ()


def place_of(names: Sequence[str], words: Container[str]) -> int | None:
    plain = [re.sub(r"[\W_]+", "", name.casefold()) for name in names]
    return next((place for place, name in enumerate(plain) if name in words), None)


def _plan_of_values(
    names: Sequence[str], cells: Sequence[Sequence[str]], clock: int, unit: float | None
) -> _Plan | None:
    """Return the plan of a table with a row for each value, as Car Scanner writes; None if it is another one."""
    name_place, value_place, unit_place = (place_of(names, words) for words in (LONG_NAMES, LONG_VALUES, LONG_UNITS))
    if name_place is None or value_place is None or clock in {name_place, value_place}:
        return None
    signals = cells[name_place]
    is_named = len(set(signals)) < len(signals) and not any(NUMBER.fullmatch(name) for name in signals)
    if not is_named or words_for_blanks(cells[value_place]) is None:
        return None
    units = [""] * len(signals) if unit_place is None else cells[unit_place]
    columns = {
        name: SignalColumn(name, unit) for name, unit in reversed(list(zip(signals, units, strict=True))) if name
    }
    named = tuple(columns[name] for name in dict.fromkeys(signals) if name)
    return _Plan(named, (value_place,), {clock: unit}, (clock,), frozenset({value_place}), name_place)


def _plan_of_columns(
    columns: Sequence[SignalColumn],
    cells: Sequence[Sequence[str]],
    row_clock: tuple[int, float | None, FloatArray],
    payloads: Sequence[int],
) -> _Plan:
    """Return the plan of a table with a column for each signal, and perhaps a clock for each group of them.

    A clock of the same name as that of the row begins a group if it begins when that does. Signals behind another
    clock keep the row's time if both run equally fast, and are left out if not.
    """
    clock, unit, time_us = row_clock
    others = [place for place in range(len(columns)) if columns[place].name and place not in {clock, *payloads}]
    blanks = {place: words for place in others if (words := words_for_blanks(cells[place])) is not None}
    left_out = [
        columns[place].name for place in range(len(columns)) if place not in {clock, *blanks} and any(cells[place])
    ]
    notes = [f"columns of words are left out: {', '.join(left_out)}"] * bool(left_out)
    names = [column.name for column in columns]
    paces = {place: pace(cells[place], columns[place], time_us) for place in time_places(names, ()) if place != clock}
    clocks = {clock: unit, **clocks_of_groups(columns, cells, clock, time_us)}
    for other in clocks:
        blanks.pop(other, None)
        paces.pop(other, None)
    begins = sorted([*clocks, *(place for place, ratio in paces.items() if ratio)])
    for other in (place for place in begins if place in paces and not 1.0 / MOST_PACE <= paces[place] <= MOST_PACE):
        stop = next((place for place in begins if place > other), len(columns))
        behind = ", ".join(columns[place].name for place in range(other, stop) if blanks.pop(place, None) is not None)
        notes.append(f"{columns[other].name!r} is another clock than that of the rows; left out are {behind}")
    notes += [f"{columns[place].name!r} has no value at {', '.join(words)}" for place, words in blanks.items() if words]
    return _Plan(
        columns=tuple(columns[place] for place in blanks),
        places=tuple(blanks),
        clocks=clocks,
        clock_places=tuple(max((begin for begin in clocks if begin < place), default=clock) for place in blanks),
        worded=frozenset(place for place, words in blanks.items() if words),
        notes=tuple(notes),
    )
