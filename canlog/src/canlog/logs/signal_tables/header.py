"""Headers of tables: names and units of columns, in the rows that programs write before those of values."""

from collections.abc import Sequence
from typing import Final

from canlog.database.signal_columns import SignalColumn
from canlog.logs.signal_tables.cells import NUMBER, UNIT_IN_BRACKETS
from canlog.logs.signal_tables.clock import TIME_OF_DAY
from canlog.logs.signal_tables.dialect import stripped

PREAMBLE_ROWS: Final = 60
MOST_COLUMNS: Final = 10_000
LONGEST_UNIT: Final = 20  # characters; words for people are longer
STACKED: Final = frozenset({"TIME", "STAMP", "ZEIT", "CZAS"})  # over the times of a group of VCDS
HALTECH: Final = "%DataLog%"
HALTECH_UNITS: Final = {
    "EngineSpeed": "rpm", "Pressure": "0.1 kPa", "AbsPressure": "0.1 kPa", "Temperature": "0.1 K", "Speed": "0.1 km/h",
    "Percentage": "0.1 %", "Angle": "0.1 deg", "BatteryVoltage": "mV", "Time_us": "us",
}  # fmt: skip
"""Units of the whole numbers of Haltech's NSP by the type of a channel, as public readers of its exports have them."""


def signal_columns(names: Sequence[str], units: Sequence[str] = ()) -> tuple[list[SignalColumn], list[str]]:
    """Return columns by the names and units of a header, and notes: a name that comes twice is numbered."""
    columns, seen = list[SignalColumn](), dict[str, int]()
    for place, text in enumerate(names):
        bracketed = UNIT_IN_BRACKETS.search(text)
        has_unit = bracketed is not None and bracketed.start() > 0
        unit = (units[place] if place < len(units) else "").strip().strip("[]()")
        unit = unit or (bracketed["unit"].strip() if bracketed and has_unit else "")
        name = (text[: bracketed.start()] if bracketed and has_unit else text).strip()
        seen[name] = seen.get(name, 0) + 1
        if name and seen[name] > 1:
            name = f"{name} ({seen[name]})"
        columns.append(SignalColumn(name, unit))
    several = ", ".join(repr(name) for name, count in seen.items() if name and count > 1)
    return columns, [f"several columns are called {several}: the others are numbered"] * bool(several)


def names_of(rows: Sequence[Sequence[str]], place: int, separator: str) -> list[str]:
    """Return the names in a row, without empty ones at its end.

    Where no other row has as many cells, some separators are parts of names that nobody quoted: those between brackets,
    and if these do not suffice those before a blank.
    """
    names = list(rows[place])
    while names and not names[-1].strip():
        names.pop()
    widths = {len(row) for row in rows[place + 1 :]}
    if len(names) in widths:
        return names
    for is_joined in (_is_in_brackets, lambda name, part: _is_in_brackets(name, part) or part.startswith(" ")):
        joined = list[str]()
        for name in names:
            if joined and is_joined(joined[-1], name):
                joined[-1] += separator + name
            else:
                joined.append(name)
        if len(joined) in widths:
            return joined
    return names


def _is_in_brackets(name: str, _part: str) -> bool:
    """Return whether a name is not complete: a bracket of it is open."""
    return any(name.count(opening) > name.count(closing) for opening, closing in ("()", "[]"))


def are_units(row: Sequence[str], width: int) -> bool:
    """Return whether a row behind a header is one of units: no cell is a number or a date, and some say something."""
    cells = [cell.strip() for cell in row]
    return (
        width - 1 <= len(cells) <= width + 1
        and any(cells)
        and not any(NUMBER.fullmatch(cell) or TIME_OF_DAY.search(cell) for cell in cells)
        and max(map(len, cells)) <= LONGEST_UNIT
    )


def stacked(rows: Sequence[Sequence[str]], place: int) -> tuple[list[str], Sequence[str], int] | None:
    """Return names, units and the first row of values where VCDS stacks three rows of them; None if it does not.

    TIME stands over STAMP before each group. Logs of identifiers have place, name and unit of one signal below each
    other; those of groups a name in two rows, and the units beside STAMP.
    """
    if len(rows) < place + 3 or not (
        clocks := [n for n, cell in enumerate(rows[place]) if cell.strip().upper() in STACKED]
    ):
        return None
    below, last = rows[place + 1], rows[place + 2]
    if any("".join(below[clock : clock + 1]).strip().upper() not in STACKED for clock in clocks):
        return None
    width = max(len(stripped(row)) for row in (rows[place], below))
    is_of_values = any(NUMBER.fullmatch("".join(last[clock : clock + 1]).strip()) for clock in clocks)
    above = rows[place - 1] if is_of_values and place else below
    parts = [[*row, *[""] * width][:width] for row in ((above, rows[place]) if is_of_values else (below,))]
    names = [" ".join(filter(None, map(str.strip, cells))) for cells in zip(*parts, strict=True)]
    units = [*(below if is_of_values else last), *[""] * width][:width]
    for number, clock in enumerate(clocks, 1):
        names[clock], units[clock] = f"time {number}", "s"
    return names, units, place + (2 if is_of_values else 3)
