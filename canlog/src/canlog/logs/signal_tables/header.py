"""Headers of tables: which of the rows before the values name the columns, and which tell units or other things."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from canlog.database.signal_columns import SignalColumn
from canlog.logs.dates import is_moment
from canlog.logs.signal_tables.cells import BLANKS, NUMBER, UNIT_IN_BRACKETS, WITH_UNIT
from canlog.logs.signal_tables.clock import TIME_UNITS_US, time_places
from canlog.logs.signal_tables.dialect import Dialect, stripped

PREAMBLE_ROWS: Final = 60
MOST_COLUMNS: Final = 10_000
MOST_HEADER_ROWS: Final = 8
LEAST_NUMBERED: Final = 3  # columns, whose numbers are no row of values
LONGEST_UNIT: Final = 20  # characters; words for people are longer
SECTION: Final = re.compile(r"\[[\w ]+\]")  # a title between header and rows
SPELLINGS: Final = """
rpm 1/min /min min-1 min^-1 u/min tr/min r/min rev/min rad/s 1/s hz khz
km/h kmh kph mph mi/h m/s kn knots m/s2 m/s^2 m/s² g km m mm mi ft
bar mbar kpa hpa mpa pa psi psig inhg mmhg kgf/cm2 kgf/cm² kg/cm2 torr atm
nm n.m n·m n*m kn·m lb-ft lbft lb·ft lbf·ft lbf-ft lb.ft ftlb ft-lb ft·lb ft-lbs
°c °f degc degf .c .f c f k ℃ ℉ celsius fahrenheit â°c â°f
% percent pct ° deg degrees °kw °crk grad lambda λ afr bit bool on/off count counts
v mv volt volts a ma amps ohm ω w kw hp ps j kj n
l/h g/s kg/h mg/s mg/r mg/stk lb/min cc/min l/100km l ml cc gal hh:mm:ss sec.ms
"""
UNITS: Final = frozenset({*TIME_UNITS_US, *SPELLINGS.split(), "unix time", "deg c", "deg f"})
"""Spellings of units in rows that hold nothing but units, in small letters; a program may have others beside them."""
LEAST_KNOWN: Final = 0.5  # of the cells of a row that is one of units, whatever stands around it
BRACKETS: Final = "[](){}<>"
UNIT_BEHIND: Final = re.compile(r".*?\S(?:\s+/\s*|,\s*|\s+)(?P<unit>(?:1/)?[^\s,]*[^\W\d_][^\s,]*|°|%)")
ONE_LETTER: Final = frozenset("sv°%")  # others behind a name tell clutches and gears apart


@dataclass(frozen=True, slots=True, kw_only=True)
class HeaderRows:
    """What the rows before the values say: a name and a unit for each column, and where the values begin."""

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    place: int  # of its first row
    first: int  # row of values
    dialect: Dialect  # of those
    clock_places: tuple[int, ...] = ()  # where it says that times stand
    why: str = ""
    notes: tuple[str, ...] = ()


def signal_columns(names: Sequence[str], units: Sequence[str] = ()) -> tuple[list[SignalColumn], list[str]]:
    """Return columns by the names and units of a header, and notes: a name that comes twice is numbered."""
    columns, seen = list[SignalColumn](), dict[str, int]()
    for place, text in enumerate(names):
        bracketed = UNIT_IN_BRACKETS.search(text)
        has_unit = bracketed is not None and bracketed.start() > 0
        unit = (units[place] if place < len(units) else "").strip().strip(BRACKETS)
        unit = unit or (bracketed["unit"].strip() if bracketed and has_unit else "")
        name = (text[: bracketed.start()] if bracketed and has_unit else text).strip()
        seen[name] = seen.get(name, 0) + 1
        if name and seen[name] > 1:
            name = f"{name} ({seen[name]})"
        columns.append(SignalColumn(name, unit))
    several = ", ".join(repr(name) for name, count in seen.items() if name and count > 1)
    return columns, [f"several columns are called {several}: the others are numbered"] * bool(several)


def with_units_of_names(columns: Sequence[SignalColumn]) -> list[SignalColumn]:
    """Return columns with the units in which their names end, as in ``Oil temp degC``; the names stay as they are.

    Only where no other unit is told, and where names of half of the columns or more end so. A name of one word, as
    ``oil_temp_degC``, is a program's: what it says of the unit is for whoever weighs it against the values.
    """
    behind = [_unit_behind(column.name) for column in columns]
    count = sum(map(bool, behind))
    if any(column.unit for column in columns) or count < max(2, LEAST_KNOWN * len(columns)):
        return list(columns)
    return [SignalColumn(column.name, unit) for column, unit in zip(columns, behind, strict=True)]


def _unit_behind(name: str) -> str:
    """Return the unit in which a name ends; empty if it ends in none."""
    found = UNIT_BEHIND.fullmatch(name)
    unit = "" if found is None else found["unit"].casefold()
    is_of_clock = unit not in TIME_UNITS_US or bool(time_places([name]))
    return found["unit"] if found and is_of_clock and unit in UNITS and (len(unit) > 1 or unit in ONE_LETTER) else ""


def named_header(rows: Sequence[Sequence[str]], place: int, dialect: Dialect) -> HeaderRows | None:
    """Return the header that begins with a row of names; None if that row names no columns.

    Rows of units, sources, addresses or descriptions may follow in any order, or units stand before: units are told by
    their spelling. Of rows that hold no unit that is known the last one is taken for it.
    """
    names, left_out = names_of(rows, place, dialect.separator)
    width = len(names)
    if not 1 < width <= MOST_COLUMNS or any(NUMBER.fullmatch(name.strip()) for name in names):
        return None
    first, below = _words_below(rows, place, width)
    has_times = any(len(row[clock]) > 1 for row in below.values() for clock in time_places(row))
    if has_times and (
        not time_places(names) or known_units(names) >= LEAST_KNOWN > max(map(known_units, below.values()))
    ):
        return None  # that is the header, and this a line before it, perhaps of units
    units, why = _units_of(below, rows[place - 1] if place else ())
    note = f"rows have no cells for the last names in the header: {', '.join(left_out)} left out"
    return HeaderRows(
        names=tuple(names), units=tuple(units), place=place, first=first, dialect=dialect,
        why=f"line {place + 1} names the columns{why}", notes=(note,) * bool(left_out),
    )  # fmt: skip


def _words_below(rows: Sequence[Sequence[str]], place: int, width: int) -> tuple[int, dict[int, Sequence[str]]]:
    """Return the first row of values, and the rows of words between it and the names; addresses may be among them."""
    first, below = place + 1, dict[int, Sequence[str]]()
    for number in range(place + 1, min(place + 1 + MOST_HEADER_ROWS, len(rows))):
        row = rows[number]
        if _are_words(row, width):
            below[number] = row
            first = number + 1
        elif _are_places(rows, number, width):
            first = number + 1
        elif len(stripped(row)) > 1 and not _are_addresses(row):
            break
    return first, below


def _units_of(below: Mapping[int, Sequence[str]], above: Sequence[str]) -> tuple[Sequence[str], str]:
    """Return the row of units among those around the names, and in words which it is."""
    short = {number: row for number, row in below.items() if max(map(len, map(str.strip, row))) <= LONGEST_UNIT}
    best = max(short, key=lambda number: known_units(short[number]), default=None)
    if best is not None and known_units(short[best]) > 0.0:
        return short[best], f", line {best + 1} their units"
    if known_units(above) >= LEAST_KNOWN:
        return above, ", the line above their units"
    if not short:
        return (), ""
    return short[max(short)], f", line {max(short) + 1} is taken for their units"


def known_units(row: Sequence[str]) -> float:
    """Return how many of the filled cells of a row are units that are known, of all."""
    filled = [cell.strip().strip(BRACKETS).casefold() for cell in row if cell.strip()]
    return sum(cell in UNITS for cell in filled) / len(filled) if filled else 0.0


def _are_words(row: Sequence[str], width: int) -> bool:
    """Return whether a row below names has words alone: neither a number nor a time, and as many cells."""
    cells = [cell.strip() for cell in row]
    return max(width - 1, 2) <= len(cells) <= width + 1 and any(cells) and not any(_is_value(cell) for cell in cells)


def is_header_row(cells: Sequence[str]) -> bool:
    """Return whether a row between those of values holds words alone, as headers do."""
    words = [word for cell in cells if (word := cell.strip()).casefold() not in BLANKS]
    return len(words) > 1 and not any(_is_value(word) for word in words)


def _is_value(cell: str) -> bool:
    """Return whether a cell is a number, perhaps with a unit behind it, or a time; some units begin with a number."""
    is_number = NUMBER.fullmatch(cell) or (WITH_UNIT.fullmatch(cell) and cell.casefold() not in UNITS)
    return bool(is_number) or is_moment(cell)


ADDRESS: Final = re.compile(r"(?:0x)?[0-9A-Fa-f]{1,8}h?")


def _are_addresses(row: Sequence[str]) -> bool:
    """Return whether a row holds numbers of channels: whole ones, some of them with letters, or 0x before them."""
    filled = [cell.strip() for cell in row if cell.strip()]
    return all(map(ADDRESS.fullmatch, filled)) and any(not cell.isdigit() for cell in filled)


def _are_places(rows: Sequence[Sequence[str]], number: int, width: int) -> bool:
    """Return whether a row numbers the columns: from one on, and beside a blank line or before times that fall."""
    if stripped(rows[number]) != tuple(map(str, range(1, width + 1))) or width < LEAST_NUMBERED:
        return False
    before, behind = rows[number - 1], rows[number + 1 : number + 4]
    if any(stripped(row) for row in behind) and not all(map(stripped, [before, *behind[:1]])):
        return all(stripped(row) for row in behind[1:])  # a blank line behind each row says nothing
    first = behind[0][0].strip().replace(",", ".") if behind and behind[0] else ""
    return NUMBER.fullmatch(first) is not None and float(first) < 1.0


def names_of(rows: Sequence[Sequence[str]], place: int, separator: str) -> tuple[list[str], list[str]]:
    """Return the names in a row, without empty ones at its end, and those for which no row has cells.

    Where no other row has as many cells, some separators are parts of names that nobody quoted: those between brackets,
    and if these do not suffice those before a blank.
    """
    names = list(rows[place])
    while names and not names[-1].strip():
        names.pop()
    widths = {len(row) for row in rows[place + 1 :]}
    if len(names) in widths:
        return names, []
    for is_joined in (_is_in_brackets, lambda name, part: _is_in_brackets(name, part) or part.startswith(" ")):
        joined = list[str]()
        for name in names:
            if joined and is_joined(joined[-1], name):
                joined[-1] += separator + name
            else:
                joined.append(name)
        if len(joined) in widths:
            return joined, []
    most = max(widths, default=0)
    return (names[:most], names[most:]) if 1 < most < len(names) else (names, [])


def _is_in_brackets(name: str, _part: str) -> bool:
    """Return whether a name is not complete: a bracket of it is open."""
    return any(name.count(opening) > name.count(closing) for opening, closing in ("()", "[]"))
