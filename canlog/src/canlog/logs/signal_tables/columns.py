"""Columns of a table: which of its cells are values of what, and whose times are theirs."""

import re
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.cells import NUMBER, PLAIN, Marks, words_for_blanks
from canlog.logs.signal_tables.clock import (
    MOST_PACE,
    RowClock,
    TimeReading,
    clocks_of_groups,
    pace_of,
    time_places,
)

LONG_NAMES: Final = frozenset({"pid", "pidname", "name", "signal", "signalname", "channel", "parameter", "sensor"})
LONG_VALUES: Final = frozenset({"value", "wert"})
LONG_UNITS: Final = frozenset({"unit", "units", "einheit"})


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnPlan:
    """Which cells of a row are values of what, and where their times are."""

    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]  # of the columns in a row; where a row has one value: that of the values
    clocks: Mapping[int, TimeReading]
    clock_places: tuple[int, ...]  # of the times of each column
    worded: frozenset[int] = frozenset()  # those where words are no values
    units_behind: Mapping[int, str] = field(default_factory=dict)  # their numbers, in these places
    name_place: int | None = None  # of the name of the signal, where a row has one value
    notes: tuple[str, ...] = ()


def plan_of_values(
    names: Sequence[str], cells: Sequence[Sequence[str]], clock: RowClock, marks: Marks = PLAIN
) -> ColumnPlan | None:
    """Return the plan of a table with a row for each value, as Car Scanner writes; None if it is another one."""
    name_place, value_place, unit_place = (place_of(names, words) for words in (LONG_NAMES, LONG_VALUES, LONG_UNITS))
    if name_place is None or value_place is None or clock.place in {name_place, value_place}:
        return None
    signals = cells[name_place]
    is_named = len(set(signals)) < len(signals) and not any(NUMBER.fullmatch(name) for name in signals)
    if not is_named or words_for_blanks(cells[value_place], marks) is None:
        return None
    units = [""] * len(signals) if unit_place is None else cells[unit_place]
    columns = {
        name: SignalColumn(name, unit) for name, unit in reversed(list(zip(signals, units, strict=True))) if name
    }
    return ColumnPlan(
        columns=tuple(columns[name] for name in dict.fromkeys(signals) if name),
        places=(value_place,),
        clocks={clock.place: clock.reading},
        clock_places=(clock.place,),
        worded=frozenset({value_place}),
        name_place=name_place,
    )


def plan_of_columns(
    columns: Sequence[SignalColumn],
    cells: Sequence[Sequence[str]],
    clock: RowClock,
    payloads: Collection[int] = (),
    stated_clocks: Collection[int] = (),
    marks: Marks = PLAIN,
) -> ColumnPlan:
    """Return the plan of a table with a column for each signal, and perhaps a clock for each group of them.

    A clock of the same name as that of the row begins a group if it begins when that does. Signals behind another
    clock keep the row's time if both run equally fast, and are left out if not. Where the header states the clocks,
    there are no others.
    """
    kept = {clock.place, clock.date_place, *stated_clocks}
    others = [place for place, column in enumerate(columns) if column.name and place not in {*kept, *payloads}]
    blanks = {place: words for place in others if (words := words_for_blanks(cells[place], marks)) is not None}
    left_out = [
        column.name
        for place, column in enumerate(columns)
        if column.name and place not in kept | {*blanks} and any(cells[place])
    ]
    notes = [f"columns of words are left out: {', '.join(left_out)}"] * bool(left_out)
    names = [column.name for column in columns]
    paces = {
        place: pace_of(cells[place], columns[place], clock.time_us, marks)
        for place in (() if stated_clocks else time_places(names))
        if place not in kept
    }
    clocks = {clock.place: clock.reading, **clocks_of_groups(columns, cells, clock, marks)}
    for other in clocks:
        blanks.pop(other, None)
        paces.pop(other, None)
    begins = sorted([*clocks, *(place for place, pace in paces.items() if pace)])
    for other in (place for place in begins if place in paces and not 1.0 / MOST_PACE <= paces[place] <= MOST_PACE):
        stop = next((place for place in begins if place > other), len(columns))
        behind = ", ".join(columns[place].name for place in range(other, stop) if blanks.pop(place, None) is not None)
        notes.append(f"{columns[other].name!r} is another clock than that of the rows; left out are {behind}")
    notes += [f"{columns[place].name!r} has no value at {', '.join(words)}" for place, words in blanks.items() if words]
    return ColumnPlan(
        columns=tuple(columns[place] for place in blanks),
        places=tuple(blanks),
        clocks=clocks,
        clock_places=tuple(max((begin for begin in clocks if begin < place), default=clock.place) for place in blanks),
        worded=frozenset(place for place, words in blanks.items() if words),
        notes=tuple(notes),
    )


def place_of(names: Sequence[str], words: Container[str]) -> int | None:
    """Return the first place of a column that is called by one of some words."""
    plain = [re.sub(r"[\W_]+", "", name.casefold()) for name in names]
    return next((place for place, name in enumerate(plain) if name in words), None)
