"""Times of a table: which columns hold them, and how they are written."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple, Protocol

import numpy as np

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn
from canlog.logs.columns.lines import Role
from canlog.logs.columns.log import SYNONYMS, UNITS
from canlog.logs.dates import Moment, is_day, is_moment, is_month_first, moment_of
from canlog.logs.signal_tables.cells import (
    LEAST_ROWS,
    PLAIN,
    REVOLUTIONS,
    UNIT_IN_BRACKETS,
    Marks,
    number_in,
    numbers_in,
)

LEAST_RISING: Final = 0.9  # of all steps of a clock: a few may fall where a recorder began again
LEAST_TICKS: Final = 20  # that tell the pace of a clock: one more or less is no other pace
US_PER_S: Final = 1_000_000.0
TIME_UNITS_US: Final = {**{word: 10.0**power for word, power in UNITS.items()}, "min": 6e7, "h": 3.6e9, "hours": 3.6e9}
EPOCH: Final = {"ms": 1e12, "us": 1e15, "ns": 1e18}  # a time since 1970 is one to four of these until 2096
HOUR_US: Final = 3_600 * US_PER_S
DAY_US: Final = 24 * HOUR_US
MOST_APART_US: Final = 60.0 * US_PER_S  # beginnings of the clocks of one recording
MOST_PACE: Final = 1.1  # of a clock: one that runs faster or slower than that of the row is another one
DAYS_TO_EPOCH: Final = 25_569.0  # from 1899-12-30, where spreadsheets begin to count, to 1970-01-01
DAYS_SINCE_1982: Final = (30_000.0, 80_000.0)  # of spreadsheets, until 2119
SHORTEST_STEP_S: Final = 2e-4  # no recorder of a car takes a row more often
SMALLEST_STEP_DAYS: Final = 1e-9  # .1 ms, as far as spreadsheets write
STEADY: Final = 0.6  # of the steps of a clock that nothing names: so many lie within half of the usual one
LEAST_STEADY_ROWS: Final = 20
NAMED_TIMES: Final = frozenset(
    {"seconds", "second", "secs", "sec", "elapsed", "elapsedtime", "sekunden", "sekunde", "sek", "logtime", "uhrzeit",
     "minutes", "milliseconds", "millis", "msec", "interval", "recordtime", "tiempo", "tempo", "czas", "heure", "tid",
     "date", "datum", "fecha"}
)  # fmt: skip
PARTS_OF_NAMES: Final = re.compile(r"time|zeit|seconds|sekunden|elapsed|stamp|clock")
DURATIONS: Final = re.compile(
    r"cycle|period|timeout|shifttime|shifttim|schalt|inj|einspritz|ontime|offtime|dwell|respon|filltime|f[uü]ll|durat|dauer"
    r"|laptime|delay|dead|remain|sincelast"
)
"""Names of times that are values: how long something took."""
COUNTERS: Final = re.compile(
    r"(?:log|row|line|rec|record|sample|frame|scan|entry|item|data|msg|can|signal|p|arb)?"
    r"(?:id|ids|no|nr|num|number|nummer|index|idx|counter|count|cnt|row|line|record|sample|samples|seq|sequence|pid|address|addr)"
    r"|identifier|spn|pgn|code|gear|gang|bit|startbit|length|dlc|laufendenummer|lfdnr|zeile"
)
"""Names of columns that number rows, or what is listed in them."""
QUANTITIES: Final = re.compile(
    rf"{REVOLUTIONS.pattern}|\b(?:engine|motor|vehicle|wheel|gps)[ _]?speed\b|\bdist(?:ance)?\b|\bmileage\b"
    r"|\bodometer\b|\btorque\b|drehmoment|\bpressure\b|druck|\btemp(?:erature)?\b",
    re.IGNORECASE,
)
QUANTITY_UNITS: Final = frozenset(
    (
        *(
            "rpm",
            "1/min",
            "u/min",
            "tr/min",
            "rad/s",
            "nm",
            "n·m",
            "lb-ft",
            "ft-lb",
            "km/h",
            "kph",
            "mph",
            "m/s",
            "m",
            "km",
        ),
        *("mi", "ft", "bar", "kpa", "psi", "%", "°c", "°f", "degc", "degf", "v", "kw", "hp"),
    )
)
"""Names and units of what rises over a curve or a drive, and is no time."""


class TimeReading(Protocol):
    """How the cells of a clock are read."""

    @property
    def wraps_us(self) -> float:
        """After how long its times begin again [us]; 0 if they never do."""

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:
        """Return the times in cells [us], NaN or infinite where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Counted:
    """Times that are numbers of a unit, from some origin on."""

    unit_us: float
    origin_us: float = 0.0
    wraps_us: float = 0.0

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:
        with np.errstate(over="ignore"):  # a damaged number
            return numbers_in(cells, marks) * self.unit_us + self.origin_us


@dataclass(frozen=True, slots=True, kw_only=True)
class OfDay:
    """Times of day, of twelve hours or of 24; behind them the days that have passed may stand."""

    wraps_us: float = DAY_US

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:  # noqa: ARG002 - a clock has marks of its own
        return np.array([moment.us if (moment := moment_of(cell)) and not moment.is_date else np.nan for cell in cells])


MINUTES: Final = re.compile(r"(\d{1,3}):(\d\d)([.,]\d{1,6})?")


@dataclass(frozen=True, slots=True, kw_only=True)
class OfHour:
    """Minutes and seconds, as spreadsheets show times: the hour is lost, and is counted from their falls."""

    wraps_us: float = HOUR_US

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:  # noqa: ARG002 - likewise
        found = [MINUTES.fullmatch(cell.strip()) for cell in cells]
        return np.array([np.nan if one is None else (60.0 * int(one[1]) + _seconds(one)) * US_PER_S for one in found])


def _seconds(found: re.Match[str]) -> float:
    return float(found[2] + (found[3] or "").replace(",", "."))


@dataclass(frozen=True, slots=True, kw_only=True)
class Dated:
    """Dates with times of day."""

    is_month_first: bool = False  # between slashes
    wraps_us: float = 0.0

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:  # noqa: ARG002 - likewise
        found = [moment_of(cell, is_month_first=self.is_month_first) for cell in cells]
        return np.array([moment.us if moment is not None and moment.is_date else np.nan for moment in found])


PACKED: Final = re.compile(r"(\d{1,2})(\d\d)(\d\d(?:\.\d+)?)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Packed:
    """Times of day without marks, as GPS receivers tell them: 095559.90."""

    wraps_us: float = DAY_US

    def times_us(self, cells: Sequence[str], marks: Marks) -> FloatArray:  # noqa: ARG002 - likewise
        found = [PACKED.fullmatch(cell.strip()) for cell in cells]
        return np.array(
            [
                np.nan if one is None else (3600.0 * int(one[1]) + 60.0 * int(one[2]) + float(one[3])) * US_PER_S
                for one in found
            ]
        )


class ReadClock(NamedTuple):
    """How a column of times is read, its times [us], and what had to be assumed."""

    reading: TimeReading
    time_us: FloatArray
    notes: tuple[str, ...] = ()


def clock_reading(cells: Sequence[str], column: SignalColumn, marks: Marks = PLAIN) -> ReadClock | None:
    """Return how the filled cells of a column are times; None if most of them are none."""
    filled = sum(map(bool, cells))
    numbers = np.array([number_in(cell, marks) for cell in cells], np.float64)
    is_number = np.isfinite(numbers)
    if filled and is_number.sum() >= LEAST_RISING * filled:
        reading, notes = _counted(numbers[is_number], column)
        return ReadClock(reading, numbers * reading.unit_us + reading.origin_us, notes)
    month_first, notes = is_month_first([cell for cell in cells if cell])
    kinds: tuple[TimeReading, ...] = (OfDay(), Dated(is_month_first=month_first), OfHour())
    for kind in kinds:
        time_us = kind.times_us(cells, marks)
        if filled and np.isfinite(time_us).sum() >= LEAST_RISING * filled:
            is_hourly = isinstance(kind, OfHour)
            said = (f"times of {column.name!r} are minutes and seconds: their hour is not told",) * is_hourly
            return ReadClock(kind, time_us, said or (notes if isinstance(kind, Dated) else ()))
    return None


def _counted(times: FloatArray, column: SignalColumn) -> tuple[Counted, tuple[str, ...]]:
    """Return how numbers count times: in the unit that is said, as days of a spreadsheet, or as their steps show."""
    if not column.unit and (days := _spreadsheet_days(times)):
        return days
    unit_us, notes = time_unit_us(column.unit, times, column.name)
    return Counted(unit_us=unit_us), tuple(notes)


def _spreadsheet_days(times: FloatArray) -> tuple[Counted, tuple[str, ...]] | None:
    """Return that times are days, as spreadsheets keep them: as seconds they would come too fast for any recorder."""
    steps = np.diff(times)
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    if not SMALLEST_STEP_DAYS < step < SHORTEST_STEP_S:
        return None
    low, high = DAYS_SINCE_1982
    if low <= times.min() and times.max() < high:
        days = Counted(unit_us=DAY_US, origin_us=-DAYS_TO_EPOCH * DAY_US)
        return days, ("times are taken as days since 1899-12-30, as spreadsheets count them",)
    if times.min() >= 0.0 and times.max() < 2.0 and _is_round(step * 86_400.0) and not _is_round(step):
        return Counted(unit_us=DAY_US), ("times are taken as parts of a day, as spreadsheets keep times of day",)
    return None


def _is_round(number: float) -> bool:
    """Return whether a number has two digits, as the steps of clocks do in their unit."""
    rounded = float(f"{number:.1e}")
    return abs(number - rounded) <= 2e-3 * rounded


def time_unit_us(unit: str, times: FloatArray, name: str) -> tuple[float, list[str]]:
    """Return how many microseconds the unit of a column of times has, and what had to be assumed.

    Where neither header nor name tells, the steps do: a recorder takes a row every few milliseconds to seconds.
    """
    suffix = re.split(r"[\s_.-]", name.casefold())[-1]
    for word in (unit.casefold(), suffix):
        if word in TIME_UNITS_US:
            return TIME_UNITS_US[word], []
    step, middle = float(np.median(np.diff(times))) if len(times) > 1 else 1.0, float(np.median(times))
    for word, least in EPOCH.items():
        if least <= middle < 4.0 * least and step * TIME_UNITS_US[word] <= 5.0 * US_PER_S:
            return TIME_UNITS_US[word], [f"times are taken as {word}: as such they count from 1970"]
    is_whole = bool(np.all(times == np.rint(times)))
    taken = "s" if step < (2.0 if is_whole else 5.0) else "ms" if step <= 2e3 else "us" if step <= 2e6 else "ns"
    return TIME_UNITS_US[taken], [f"times are taken as {taken}: their steps are {step:g}"]


def time_places(names: Sequence[str]) -> list[int]:
    """Return where the times may stand by the names of columns, the likeliest place first."""
    plain = [_plain(name) for name in names]
    bare = [re.sub(r"(?:ns|us|µs|ms|s|sec)$", "", word) for word in plain]
    known = [place for word in SYNONYMS[Role.TIME] for place, one in enumerate(plain) if word in {one, bare[place]}]
    named = [place for place, word in enumerate(plain) if word in NAMED_TIMES]
    parts = [place for place, word in enumerate(plain) if PARTS_OF_NAMES.search(word) and not DURATIONS.search(word)]
    return list(dict.fromkeys([*known, *named, *parts]))


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", UNIT_IN_BRACKETS.sub("", name).casefold())


@dataclass(frozen=True, slots=True, kw_only=True)
class RowClock:
    """Where the times of rows stand, and how they are read."""

    place: int
    reading: TimeReading
    date_place: int | None = None  # of the days, where times of day have a column of their own
    is_month_first: bool = False  # in it
    base_us: float = 0.0  # that times count from
    why: str = ""
    notes: tuple[str, ...] = ()
    time_us: FloatArray  # of the first rows


@dataclass(frozen=True, slots=True, kw_only=True)
class NoRowClock:
    """Why no column of a table holds its times."""

    why: str
    is_list: bool = False  # of things: no log at all


def clock_of(
    columns: Sequence[SignalColumn],
    cells: Sequence[Sequence[str]],
    marks: Marks = PLAIN,
    payloads: Collection[int] = (),
) -> RowClock | NoRowClock:
    """Return the clock of the rows of a table, or why there is none.

    Parameters
    ----------
    columns
        Names and units.
    cells
        The cells of each column in the first rows.
    marks
        What points and commas in numbers mean.
    payloads
        Where bytes of frames stand, which name nothing.
    """
    names = [column.name for column in columns]
    named = time_places(names)
    days = [place for place, column in enumerate(cells) if any(column) and all(is_day(cell) for cell in column if cell)]
    first = [0] if names and 0 not in days and _may_be_first(cells, columns) else []
    counts = [place for place in first if _counts_rows(cells[place])]
    ranked = [*(place for place in named if place not in days), *(place for place in first if place not in counts)]
    for place in dict.fromkeys([*ranked, *counts]):
        if (read := clock_reading(cells[place], columns[place], marks)) and _rises(cells[place], read):
            why = f"{columns[place].name!r} rises" + ("" if place in named else ", the first column")
            return _with_days(place, read, why, columns, cells, days)
    return _steady_clock(columns, cells, marks) or _no_clock(names, cells, named, days, payloads)


def stated_clock(
    places: Sequence[int],
    reading: TimeReading | None,
    columns: Sequence[SignalColumn],
    cells: Sequence[Sequence[str]],
    marks: Marks = PLAIN,
) -> RowClock | NoRowClock:
    """Return the first clock that rises of those that a header states, and perhaps how it is read; or why none does."""
    for place in places:
        read = (
            clock_reading(cells[place], columns[place], marks)
            if reading is None
            else ReadClock(reading, reading.times_us(cells[place], marks))
        )
        if read is not None and _rises(cells[place], read):
            why = f"the header says that {columns[place].name!r} holds times"
            return RowClock(place=place, reading=read.reading, why=why, notes=read.notes, time_us=read.time_us)
    return NoRowClock(why=f"the times in {columns[places[0]].name!r} cannot be read or do not rise")


def _may_be_first(cells: Sequence[Sequence[str]], columns: Sequence[SignalColumn]) -> bool:
    """Return whether the first column may hold times though its name does not say so: rows of a list are no moments.

    Nor are values of a quantity, such as the speeds over which a curve is told.
    """
    name = columns[0].name
    is_index = not name.strip() and _counts_rows(cells[0])
    is_named = COUNTERS.fullmatch(_plain(name)) is not None or _is_duration(name)
    return not (is_index or is_named or _is_quantity(columns[0]) or _is_list(cells))


def _is_quantity(column: SignalColumn) -> bool:
    return QUANTITIES.search(column.name) is not None or column.unit.casefold() in QUANTITY_UNITS


def _is_duration(name: str) -> bool:
    return DURATIONS.search(_plain(name)) is not None


def _is_list(cells: Sequence[Sequence[str]]) -> bool:
    """Return whether each row has a name of its own: a list of things."""
    for column in cells:
        words = [cell for cell in column if cell and not math.isfinite(number_in(cell)) and not is_moment(cell)]
        if len(words) >= max(LEAST_ROWS, LEAST_RISING * len(column)) and len(set(words)) > LEAST_RISING * len(words):
            return True
    return False


def _counts_rows(cells: Sequence[str]) -> bool:
    """Return whether a column numbers the rows, one after the other."""
    numbers = np.array([number_in(cell) for cell in cells])
    is_counted = len(numbers) > 1 and bool(np.isfinite(numbers).all()) and bool(np.all(np.diff(numbers) == 1.0))
    return is_counted and float(numbers[0]) in {0.0, 1.0}


def _with_days(
    place: int,
    read: ReadClock,
    why: str,
    columns: Sequence[SignalColumn],
    cells: Sequence[Sequence[str]],
    days: Sequence[int],
) -> RowClock:
    """Return a clock, with the column of its days where times of day have one."""
    date_place = next((other for other in days if other != place), None) if isinstance(read.reading, OfDay) else None
    if date_place is None:
        return RowClock(place=place, reading=read.reading, why=why, notes=read.notes, time_us=read.time_us)
    month_first, notes = is_month_first([cell for cell in cells[date_place] if cell])
    day_us = np.array([_us(moment_of(cell, is_month_first=month_first)) for cell in cells[date_place]])
    return RowClock(
        place=place, reading=read.reading, date_place=date_place, is_month_first=month_first,
        why=f"{why}, on the days of {columns[date_place].name!r}", notes=(*read.notes, *notes),
        time_us=read.time_us + day_us,
    )  # fmt: skip


def _us(moment: Moment | None) -> float:
    return np.nan if moment is None else moment.us


def _steady_clock(columns: Sequence[SignalColumn], cells: Sequence[Sequence[str]], marks: Marks) -> RowClock | None:
    """Return the only column that always rises in steady steps, as a clock does; None if none does, or several do."""
    found = list[RowClock]()
    for place, column in enumerate(columns if not _is_list(cells) else ()):
        read = clock_reading(cells[place], column, marks) if _is_steady(cells[place], column, marks) else None
        if read is not None:
            why = f"{column.name!r} alone rises in steady steps"
            notes = (f"no column is named as a time: {why}, and is taken as the time", *read.notes)
            found.append(RowClock(place=place, reading=read.reading, why=why, notes=notes, time_us=read.time_us))
    return found[0] if len(found) == 1 else None


def _is_steady(cells: Sequence[str], column: SignalColumn, marks: Marks) -> bool:
    is_of_time = not column.unit or column.unit.casefold() in TIME_UNITS_US
    if len(cells) < LEAST_STEADY_ROWS or not all(cells) or _counts_rows(cells) or not is_of_time:
        return False
    if COUNTERS.fullmatch(_plain(column.name)) or _is_duration(column.name) or _is_quantity(column):
        return False
    read = clock_reading(cells, column, marks)
    if read is None or not np.all(np.isfinite(read.time_us)):
        return False
    steps_us = np.diff(read.time_us)
    usual_us = float(np.median(steps_us))
    return bool(np.all(steps_us > 0.0) and np.mean(np.abs(steps_us - usual_us) < 0.5 * usual_us) >= STEADY)


def _no_clock(
    names: Sequence[str],
    cells: Sequence[Sequence[str]],
    named: Sequence[int],
    days: Sequence[int],
    payloads: Collection[int],
) -> NoRowClock:
    """Return why no column holds times."""
    if _is_list([column for place, column in enumerate(cells) if place not in {*payloads, *named, *days}]):
        return NoRowClock(why="each row names another thing: a list or catalogue, not a log", is_list=True)
    if days and len(set(cells[days[0]])) > 1:
        return NoRowClock(why=f"{names[days[0]]!r} holds days without times of day: a list, not a log", is_list=True)
    if named:
        shown = next((cell for cell in cells[named[0]] if cell), "nothing")
        return NoRowClock(
            why=f"the times in {names[named[0]]!r} cannot be read or do not rise; it begins with {shown!r}"
        )
    counter = next((name for name, column in zip(names, cells, strict=True) if _counts_rows(column)), None)
    if counter is not None:
        shown = repr(counter) if counter else "the first column"
        return NoRowClock(why=f"{shown} only counts the rows, and no other column holds times")
    return NoRowClock(why="no column holds times that rise")


def _rises(cells: Sequence[str], read: ReadClock) -> bool:
    """Return whether cells are times: from the first on, mostly rising, and not standing."""
    is_time = np.isfinite(read.time_us)
    return bool(
        len(cells) and is_time[0] and is_time.sum() >= LEAST_RISING * len(cells) and is_rising(read.time_us[is_time])
    )


def is_rising(times: Sequence[float] | FloatArray) -> bool:
    """Return whether numbers can be times: enough, mostly rising, and not all the same."""
    if len(times) < LEAST_ROWS:
        return False
    steps = [after - before for before, after in pairwise(times)]
    return sum(step >= 0 for step in steps) >= LEAST_RISING * len(steps) and any(step > 0 for step in steps)


def clocks_of_groups(
    columns: Sequence[SignalColumn], cells: Sequence[Sequence[str]], clock: RowClock, marks: Marks = PLAIN
) -> Mapping[int, TimeReading]:
    """Return where the times of further groups are, and how they are read; they are called as those of the row."""
    called, clocks = _bare(columns[clock.place].name), dict[int, TimeReading]()
    begin_us = clock.time_us[np.isfinite(clock.time_us)][0]
    for place, column in enumerate(columns):
        filled = [cell for cell in cells[place] if cell]
        if place == clock.place or _bare(column.name) != called:
            continue
        if (read := clock_reading(filled, column, marks)) is not None and _rises(filled, read):
            other_us = read.time_us[np.isfinite(read.time_us)][0]
            if abs(other_us - begin_us) <= MOST_APART_US:
                clocks[place] = read.reading
    return clocks


def _bare(name: str) -> str:
    """Return the letters of a name: what is left of a clock's without the number that tells it from others."""
    return re.sub(r"[\W\d_]+", "", name.casefold())


def pace_of(cells: Sequence[str], column: SignalColumn, row_us: FloatArray, marks: Marks = PLAIN) -> float:
    """Return how fast the time of a column runs beside that of its row; 0 if it is no clock, whatever its name.

    It is the usual pace between two of its ticks: a clock that begins again, or a pause, is no other pace.
    """
    filled = [cell for cell in cells if cell]
    is_rising_column = (among := clock_reading(filled, column, marks)) is not None and _rises(filled, among)
    if not is_rising_column or (read := clock_reading(cells, column, marks)) is None:
        return 0.0
    both = np.isfinite(read.time_us) & np.isfinite(row_us)
    time_us, at_us = read.time_us[both], row_us[both]
    steps_us = np.diff(time_us)
    if (column.unit and read.notes) or np.sum(steps_us > 0.0) < LEAST_RISING * max(LEAST_TICKS, len(steps_us)):
        return 0.0
    ticks = np.concatenate([[0], np.flatnonzero(steps_us != 0.0) + 1])
    own_us, passed_us = np.diff(time_us[ticks]), np.diff(at_us[ticks])
    is_usable = (own_us > 0.0) & (passed_us > 0.0)
    return float(np.median(own_us[is_usable] / passed_us[is_usable])) if is_usable.any() else 0.0
