"""Times of a table: which columns they are, and what they count."""

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from canlog.database.signal_columns import SignalColumn
from canlog.logs.columns.lines import Role
from canlog.logs.columns.log import SYNONYMS, UNITS
from canlog.logs.signal_tables.cells import LEAST_ROWS, UNIT_IN_BRACKETS, number_in

LEAST_RISING: Final = 0.9  # of all steps of a clock: a few may fall where a recorder began again
LEAST_TICKS: Final = 20  # that tell the pace of a clock: one more or less is no other pace
TIME_OF_DAY: Final = re.compile(r"(?:(\d+)\s+)?(\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?")
DAY_FIRST: Final = re.compile(r"(\d{1,2})(?:\.(\d{1,2})\.|-([A-Za-z]{3})-)(\d{4})[ T]+(.*)")
MONTHS: Final = "janfebmaraprmayjunjulaugsepoctnovdec"
US_PER_S: Final = 1_000_000.0
TIME_UNITS_US: Final = {**{word: 10.0**power for word, power in UNITS.items()}, "min": 6e7, "h": 3.6e9, "hours": 3.6e9}
EPOCH: Final = {"ms": 1e12, "us": 1e15, "ns": 1e18}  # a time since 1970 is one to four of these until 2096
DAY_US: Final = 86_400 * US_PER_S
MOST_APART_US: Final = 60.0 * US_PER_S  # beginnings of the clocks of one recording
MOST_PACE: Final = 1.1  # of a clock: one that runs faster or slower than that of the row is another one


def time_places(names: Sequence[str], unnamed: Sequence[int] = (0,)) -> list[int]:
    """Return where the times may stand, the likeliest place first: by a name for them, at the beginning, by a part."""
    plain = [re.sub(r"[\W_]+", "", UNIT_IN_BRACKETS.sub("", name).casefold()) for name in names]
    bare = [re.sub(r"(?:ns|us|µs|ms|s|sec)$", "", word) for word in plain]
    known = [place for word in SYNONYMS[Role.TIME] for place, one in enumerate(plain) if word in {one, bare[place]}]
    parts = [place for place, word in enumerate(plain) if "time" in word or "zeit" in word]
    return list(dict.fromkeys([*known, *unnamed, *parts]))


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


def is_rising(times: Sequence[float]) -> bool:
    """Return whether numbers can be times: enough, mostly rising, and not all the same."""
    if len(times) < LEAST_ROWS:
        return False
    steps = [after - before for before, after in pairwise(times)]
    return sum(step >= 0 for step in steps) >= LEAST_RISING * len(steps) and any(step > 0 for step in steps)


def rises(cells: Sequence[str]) -> bool:
    """Return whether cells are times: numbers or clocks from the first on, that mostly rise and do not stand."""
    numbers = ((number_in(cell), cell) for cell in cells if cell)
    moments = [number if math.isfinite(number) else moment_us(cell)[0] for number, cell in numbers]
    times = [one for one in moments if math.isfinite(one)]
    return len(times) >= LEAST_RISING * len(cells) and is_rising(times) and math.isfinite(moments[0])


def clock_us(cells: Sequence[str], column: SignalColumn) -> tuple[FloatArray, float | None, list[str]]:
    """Return the times in a column [us], NaN or infinite where there is none, their unit if they are numbers, notes."""
    numbers = np.array([number_in(cell) for cell in cells])
    if np.isfinite(numbers).sum() < LEAST_RISING * sum(map(bool, cells)):
        return np.array([moment_us(cell)[0] for cell in cells]), None, []
    unit, notes = time_unit_us(column.unit, numbers[np.isfinite(numbers)], column.name)
    return numbers * unit, unit, notes


def pace(cells: Sequence[str], column: SignalColumn, row_us: FloatArray) -> float:
    """Return how fast the time of a column runs beside that of its row; 0 if it is no clock, whatever its name."""
    if not rises([cell for cell in cells if cell]):
        return 0.0
    time_us, _, notes = clock_us(cells, column)
    both = np.isfinite(time_us) & np.isfinite(row_us)
    steps_us, row_steps_us = np.diff(time_us[both]), np.diff(row_us[both])
    if (column.unit and notes) or np.sum(steps_us > 0.0) < LEAST_RISING * max(LEAST_TICKS, len(steps_us)):
        return 0.0
    return float(steps_us[steps_us > 0.0].sum()) / max(float(row_steps_us[row_steps_us > 0.0].sum()), 1.0)


def clocks_of_groups(
    columns: Sequence[SignalColumn], cells: Sequence[Sequence[str]], clock: int, time_us: FloatArray
) -> dict[int, float | None]:
    """Return where the times of further groups are, with their units; they are called as those of the row."""
    called, clocks = _bare(columns[clock].name), dict[int, float | None]()
    begin_us = time_us[np.isfinite(time_us)][0]
    for place, column in enumerate(columns):
        filled = [cell for cell in cells[place] if cell]
        if place != clock and _bare(column.name) == called and rises(filled):
            other_us, unit, _ = clock_us(filled, column)
            if abs(other_us[np.isfinite(other_us)][0] - begin_us) <= MOST_APART_US:
                clocks[place] = unit
    return clocks


def _bare(name: str) -> str:
    """Return the letters of a name: what is left of a clock's without the number that tells it from others."""
    return re.sub(r"[\W\d_]+", "", name.casefold())
