"""Headers of tables of signals: which of the many ways a table is written in, and what its columns are."""

import csv
import math
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn
from canlog.logs.columns.lines import Role
from canlog.logs.columns.log import SYNONYMS, UNITS

PROBE_BYTES: Final = 64 * 1024  # as many as detection sees
PROBE_ROWS, PREAMBLE_ROWS = 100, 60
LEAST_ROWS, MOST_COLUMNS = 3, 10_000
LONGEST_UNIT: Final = 20  # characters; words for people are longer
LEAST_RISING: Final = 0.9  # of all steps of a clock: a few may fall where a recorder began again
LEAST_TICKS: Final = 20  # that tell the pace of a clock: one more or less is no other pace
SEPARATORS: Final = "\t;,|"
BLANKS: Final = frozenset({"", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none"})
WORDS: Final = {"true": 1.0, "on": 1.0, "yes": 1.0, "false": 0.0, "off": 0.0, "no": 0.0}
UNIT_IN_BRACKETS: Final = re.compile(r"\s*[\[(](?P<unit>(?!\d+[\])])[^\[\]()]*)[\])]\s*$")  # a number is an index
GROUPED: Final = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?")  # 1,195
NUMBER: Final = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?")
WORD: Final = re.compile(r"[^\W\d_]+(?: [^\W\d_]+)*")
PAYLOAD: Final = re.compile(r"(?:0x)?(?:[0-9A-Fa-f]{2}[\s:._-]?){1,64}")
STATUS: Final = re.compile(r"0x(?:[0-9A-Fa-f]{2}){1,2}|[0-9A-Fa-f]{2}")  # bits of a device, or the word AC
LETTERS: Final = re.compile(r"[A-Fa-f]")
TIME_OF_DAY: Final = re.compile(r"(?:(\d+)\s+)?(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?")
DAY_FIRST: Final = re.compile(r"(\d{1,2})(?:\.(\d{1,2})\.|-([A-Za-z]{3})-)(\d{4})[ T]+(.*)")
MONTHS: Final = "janfebmaraprmayjunjulaugsepoctnovdec"
US_PER_S: Final = 1_000_000.0
TIME_UNITS_US: Final = {**{word: 10.0**power for word, power in UNITS.items()}, "min": 6e7, "h": 3.6e9, "hours": 3.6e9}
EPOCH: Final = {"ms": 1e12, "us": 1e15, "ns": 1e18}  # a time since 1970 is one to four of these until 2096
DAY_US: Final = 86_400 * US_PER_S
MOST_APART_US: Final = 60.0 * US_PER_S  # beginnings of the clocks of one recording
STACKED: Final = frozenset({"TIME", "STAMP", "ZEIT", "CZAS"})  # over the times of a group of VCDS
HALTECH: Final = "%DataLog%"
HALTECH_UNITS: Final = {
    "EngineSpeed": "rpm", "Pressure": "0.1 kPa", "AbsPressure": "0.1 kPa", "Temperature": "0.1 K", "Speed": "0.1 km/h",
    "Percentage": "0.1 %", "Angle": "0.1 deg", "BatteryVoltage": "mV", "Time_us": "us",
}  # fmt: skip
"""Units of the whole numbers of Haltech's NSP by the type of a channel, as public readers of its exports have them."""
LONG_NAMES: Final = frozenset({"pid", "pidname", "name", "signal", "signalname", "channel", "parameter", "sensor"})
LONG_VALUES, LONG_UNITS = frozenset({"value", "wert"}), frozenset({"unit", "units", "einheit"})
MOST_VALUE: Final = 1e30  # beyond, a cell is no measurement, in any unit
MOST_PACE: Final = 1.1  # of a clock: one that runs faster or slower than that of the row is another one


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


def time_unit_us(unit: str, times: FloatArray, name: str) -> tuple[float, list[str]]:
    """Return how many microseconds the unit of a column of times has, and what had to be assumed.

    Where neither header nor name tells, the steps do: a recorder takes a row every few milliseconds to seconds.
    """
    suffix = re.split(r"[\s_.-]", name.casefold())[-1]
    for word in (unit.casefold(), suffix):
        if word in TIME_UNITS_US:
            return TIME_UNITS_US[word], []
    step, middle = float(np.median(np.diff(times))), float(np.median(times))
    for word, least in EPOCH.items():
        if least <= middle < 4.0 * least and step * TIME_UNITS_US[word] <= 5.0 * US_PER_S:
            return TIME_UNITS_US[word], [f"times are taken as {word}: as such they count from 1970"]
    is_whole = bool(np.all(times == np.rint(times)))
    taken = "s" if step < (2.0 if is_whole else 5.0) else "ms" if step <= 2e3 else "us" if step <= 2e6 else "ns"
    return TIME_UNITS_US[taken], [f"times are taken as {taken}: their steps are {step:g}"]


def _header_at(rows: Sequence[Sequence[str]], place: int, separator: str) -> TableHeader | None:
    """Return the header that a row is, with the row of units that may follow it; None if it is none."""
    names, units, first = _stacked(rows, place) or (_names_of(rows, place, separator), (), place + 1)
    width = len(names)
    if not 1 < width <= MOST_COLUMNS or any(NUMBER.fullmatch(name.strip()) for name in names):
        return None
    if not units:
        while len(rows) > first and _are_units(rows[first], width):  # the last: types may stand before it
            units, first = rows[first], first + 1
            if any(len(units[clock]) > 1 for clock in time_places(units, ())) and not time_places(names, ()):
                return None  # that is the header, and this a line before it
    return _header_of(rows, names, units, place, first, separator)


def _stacked(rows: Sequence[Sequence[str]], place: int) -> tuple[list[str], Sequence[str], int] | None:
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
    payloads = [index for index in range(width) if _is_payload(cells[index])]
    is_traffic = len(payloads) > 1 or any(
        not STATUS.fullmatch(cell) for index in payloads for cell in cells[index] if cell
    )
    clock = next((index for index in time_places(names) if _rises(cells[index])), None)
    if is_traffic or clock is None:
        return None
    columns, notes = signal_columns(names, units)
    time_us, unit, time_notes = _clock_us(cells[clock], columns[clock])
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
    if not is_named or _words_for_blanks(cells[value_place]) is None:
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
    blanks = {place: words for place in others if (words := _words_for_blanks(cells[place])) is not None}
    left_out = [
        columns[place].name for place in range(len(columns)) if place not in {clock, *blanks} and any(cells[place])
    ]
    notes = [f"columns of words are left out: {', '.join(left_out)}"] * bool(left_out)
    names = [column.name for column in columns]
    paces = {place: _pace(cells[place], columns[place], time_us) for place in time_places(names, ()) if place != clock}
    clocks = {clock: unit, **_clocks_of_groups(columns, cells, clock, time_us)}
    for other in clocks:
        blanks.pop(other, None)
        paces.pop(other, None)
    begins = sorted([*clocks, *(place for place, pace in paces.items() if pace)])
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


def _clocks_of_groups(
    columns: Sequence[SignalColumn], cells: Sequence[Sequence[str]], clock: int, time_us: FloatArray
) -> dict[int, float | None]:
    """Return where the times of further groups are, with their units; they are called as those of the row."""
    called, clocks = _bare(columns[clock].name), dict[int, float | None]()
    begin_us = time_us[np.isfinite(time_us)][0]
    for place, column in enumerate(columns):
        filled = [cell for cell in cells[place] if cell]
        if place != clock and _bare(column.name) == called and _rises(filled):
            other_us, unit, _ = _clock_us(filled, column)
            if abs(other_us[np.isfinite(other_us)][0] - begin_us) <= MOST_APART_US:
                clocks[place] = unit
    return clocks


def _bare(name: str) -> str:
    """Return the letters of a name: what is left of a clock's without the number that tells it from others."""
    return re.sub(r"[\W\d_]+", "", name.casefold())


def _clock_us(cells: Sequence[str], column: SignalColumn) -> tuple[FloatArray, float | None, list[str]]:
    """Return the times in a column [us], NaN or infinite where there is none, their unit if they are numbers, notes."""
    numbers = np.array([number_in(cell) for cell in cells])
    if np.isfinite(numbers).sum() < LEAST_RISING * sum(map(bool, cells)):
        return np.array([moment_us(cell)[0] for cell in cells]), None, []
    unit, notes = time_unit_us(column.unit, numbers[np.isfinite(numbers)], column.name)
    return numbers * unit, unit, notes


def _pace(cells: Sequence[str], column: SignalColumn, row_us: FloatArray) -> float:
    """Return how fast the time of a column runs beside that of its row; 0 if it is no clock, whatever its name."""
    if not _rises([cell for cell in cells if cell]):
        return 0.0
    time_us, _, notes = _clock_us(cells, column)
    both = np.isfinite(time_us) & np.isfinite(row_us)
    steps_us, row_steps_us = np.diff(time_us[both]), np.diff(row_us[both])
    if (column.unit and notes) or np.sum(steps_us > 0.0) < LEAST_RISING * max(LEAST_TICKS, len(steps_us)):
        return 0.0
    return float(steps_us[steps_us > 0.0].sum()) / max(float(row_steps_us[row_steps_us > 0.0].sum()), 1.0)


def _are_units(row: Sequence[str], width: int) -> bool:
    """Return whether a row behind a header is one of units: no cell is a number or a date, and some say something."""
    cells = [cell.strip() for cell in row]
    return (
        width - 1 <= len(cells) <= width + 1
        and any(cells)
        and not any(NUMBER.fullmatch(cell) or TIME_OF_DAY.search(cell) for cell in cells)
        and max(map(len, cells)) <= LONGEST_UNIT
    )


def time_places(names: Sequence[str], unnamed: Sequence[int] = (0,)) -> list[int]:
    """Return where the times may stand, the likeliest place first: by a name for them, at the beginning, by a part."""
    plain = [re.sub(r"[\W_]+", "", UNIT_IN_BRACKETS.sub("", name).casefold()) for name in names]
    bare = [re.sub(r"(?:ns|us|µs|ms|s|sec)$", "", word) for word in plain]
    known = [place for word in SYNONYMS[Role.TIME] for place, one in enumerate(plain) if word in {one, bare[place]}]
    parts = [place for place, word in enumerate(plain) if "time" in word or "zeit" in word]
    return list(dict.fromkeys([*known, *unnamed, *parts]))


def _rises(cells: Sequence[str]) -> bool:
    """Return whether cells are times: numbers or clocks from the first on, that mostly rise and do not stand."""
    numbers = ((number_in(cell), cell) for cell in cells if cell)
    moments = [number if math.isfinite(number) else moment_us(cell)[0] for number, cell in numbers]
    times = [one for one in moments if math.isfinite(one)]
    return len(times) >= LEAST_RISING * len(cells) and is_rising(times) and math.isfinite(moments[0])


def is_rising(times: Sequence[float]) -> bool:
    """Return whether numbers can be times: enough, mostly rising, and not all the same."""
    if len(times) < LEAST_ROWS:
        return False
    steps = [after - before for before, after in pairwise(times)]
    return sum(step >= 0 for step in steps) >= LEAST_RISING * len(steps) and any(step > 0 for step in steps)


def _words_for_blanks(cells: Sequence[str]) -> list[str] | None:
    """Return the words that a column has beside numbers, as a gear has N; None if words are most of what it has."""
    found = [(cell, number_in(cell)) for cell in cells]
    words, count = [cell for cell, one in found if math.isinf(one)], sum(math.isfinite(one) for _, one in found)
    if min(len(words), count) >= LEAST_ROWS and all(map(WORD.fullmatch, words)):
        return sorted(set(words))
    return [] if len(words) <= count else None


def _is_payload(cells: Sequence[str]) -> bool:
    """Return whether a column holds bytes of frames, some of them with letters as digits."""
    filled = [cell for cell in cells if cell]
    of_bytes = [cell for cell in filled if PAYLOAD.fullmatch(cell)]
    has_letters = any(LETTERS.search(cell.removeprefix("0x")) and not NUMBER.fullmatch(cell) for cell in of_bytes)
    return has_letters and len(of_bytes) > len(filled) / 2


def number_in(cell: str) -> float:
    """Return the number in a cell, NaN for a blank one, infinity for anything that is no measurement."""
    text = cell.strip()
    if NUMBER.fullmatch(text):
        value = float(text.replace(",", "."))
        return value if abs(value) < MOST_VALUE else np.inf
    folded = text.casefold()
    return np.nan if folded in BLANKS else WORDS.get(folded, np.inf)


def moment_us(cell: str) -> tuple[float, bool]:
    """Return a time of day or a date [us], and whether it is a date; NaN if neither. Without a zone it is UTC."""
    text = cell.strip()
    if found := TIME_OF_DAY.fullmatch(text):
        days, hours, minutes, seconds = (int(part or 0) for part in found.groups()[:4])
        fraction = float(f"0.{found[5]}") if found[5] else 0.0
        return (((days * 24 + hours) * 60 + minutes) * 60 + seconds + fraction) * US_PER_S, bool(found[1])
    if found := DAY_FIRST.fullmatch(text):
        day, month, named, year, rest = found.groups()
        month = month or str(MONTHS.find(named.lower()) // 3 + 1)
        text = f"{year}-{month:0>2}-{day:0>2} {rest}"
    try:
        moment = datetime.fromisoformat(text.replace("/", "-").replace(",", "."))
    except ValueError:
        return np.nan, False
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() * US_PER_S, True


def cells_of(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _names_of(rows: Sequence[Sequence[str]], place: int, separator: str) -> list[str]:
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


def stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a row without blanks around them and without empty ones at its end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def ungrouped(cells: Iterable[str]) -> list[str]:
    return [cell.replace(",", "") if "," in cell and GROUPED.fullmatch(cell.strip()) else cell for cell in cells]


def lines_in(text: bytes) -> list[str]:
    """Return the lines of a text in UTF-8 or, where it is not that, in the code page of Windows."""
    try:
        decoded = text.decode("utf-8-sig")
    except UnicodeDecodeError:
        decoded = text.decode("cp1252", "replace")
    return decoded.replace("\r\n", "\n").removesuffix("\n").split("\n")
