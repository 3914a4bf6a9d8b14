"""Tables of signals: a row for each moment, a column for each signal, as frames of `canlog.database.signal_columns`.

Test benches, tuners and scan tools write them. Blank cells are no values; a cell that is neither blank nor a number is
counted and told, and costs no other cell of its row.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain, islice, pairwise
from typing import BinaryIO, Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.logs.columns.lines import Role
from canlog.logs.columns.log import SYNONYMS, UNITS
from canlog.logs.log_counts import LogCounts, LogReject

BLOCK_BYTES: Final = 1024 * 1024
PROBE_BYTES: Final = 64 * 1024  # as many as detection sees
MOST_ROW_BYTES: Final = 256 * 1024  # whatever is longer is no row
PROBE_ROWS, PREAMBLE_ROWS = 100, 20
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
SECTION: Final = re.compile(r"\[[\w ]+\]")  # a title between header and rows
MONTHS: Final = "janfebmaraprmayjunjulaugsepoctnovdec"
US_PER_S: Final = 1_000_000.0
TIME_UNITS_US: Final = {**{word: 10.0**power for word, power in UNITS.items()}, "min": 6e7, "h": 3.6e9, "hours": 3.6e9}
EPOCH: Final = {"ms": 1e12, "us": 1e15, "ns": 1e18}  # a time since 1970 is one to four of these until 2096
DAY_US: Final = 86_400 * US_PER_S
MOST_VALUE: Final = 1e30  # beyond, a cell is no measurement, in any unit
MOST_PACE: Final = 1.1  # of a clock: one that runs faster or slower than that of the row is another one
MOST_US: Final = 2.0**53  # beyond, a time is not told to the microsecond


@dataclass(frozen=True, slots=True, kw_only=True)
class TableHeader:
    """How a table is written, and what its columns are."""

    separator: str
    lines: int  # before the first row of values
    width: int  # cells of a row
    time_place: int
    us_per_unit: float | None  # of numbers in the column of times; None: it holds times of day or dates
    has_decimal_comma: bool
    columns: tuple[SignalColumn, ...]
    places: tuple[int, ...]  # of the columns in a row
    worded: frozenset[int]  # those where words are no values
    notes: tuple[str, ...]
    repeated: frozenset[tuple[str, ...]]  # its cells, and units, which may stand again between rows
    clock_words: frozenset[str]  # those of them in the place of times


def table_header(text: bytes) -> TableHeader | None:
    """Return what the beginning of a text says of the table that it is; None if it is none.

    A header names two columns or more, one of them holds times that rise, and most cells of others are numbers. Whole
    lines of a probe tell it, or all of a shorter text, so that whoever detects a table and whoever reads it find the
    same columns.
    """
    is_all = len(text) < PROBE_BYTES
    lines = _lines(text if is_all else text[: text.rfind(b"\n", 0, PROBE_BYTES) + 1])
    separator = max(SEPARATORS, key=lambda one: sum(one in line for line in lines[:PROBE_ROWS]))
    rows = [_cells(line, separator) for line in lines]
    if is_all and rows[-1] and not text.endswith(b"\n"):
        rows[-1][-1] = ""  # may be cut off
    for place in range(min(PREAMBLE_ROWS, len(rows))):
        if len(rows[place]) > 1 and (found := _header_at(rows, place, separator)) is not None:
            return found
    return None


def read_signal_table(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the values of a table as frames, a batch for about a mebibyte of text.

    Raises SourceError if its beginning is no table of signals.
    """
    blocks = _blocks(stream, counts)
    first = list(islice(blocks, 2))  # a short text and what follows its last newline
    header = table_header(b"".join(text for text, _ in first))
    if header is None:
        raise SourceError("no table of signals")
    table = _Table(header, counts)
    for text, is_terminated in chain(first, blocks):
        batch = table.read(text, is_terminated=is_terminated)
        if len(batch):
            counts.frames += len(batch)
            yield batch


class _Table:
    """Reads the rows of one table."""

    def __init__(self, header: TableHeader, counts: LogCounts) -> None:
        self._header = header
        self._counts = counts
        self._line = 0
        self._day_us = 0.0  # that have passed since the first time of day
        self._last_us = -1.0
        self._has_other_columns = False
        self._ids = np.array([column_id(one.name) | EXTENDED_FLAG for one in header.columns], np.uint32)
        for note in header.notes:
            counts.note(note)

    def read(self, text: bytes, *, is_terminated: bool) -> FrameBatch:
        """Return the values of a block of whole lines; of a last line without its end all but the last cell."""
        header, lines = self._header, _lines(text)
        rows, numbers = list[list[str]](), list[int]()
        for number, line in enumerate(lines, self._line + 1):
            if number <= header.lines or not line.strip() or SECTION.fullmatch(line.strip()):
                continue
            cells = _cells(line, header.separator)
            if header.separator == "," and not header.has_decimal_comma and '"' in line:
                cells = _ungrouped(cells)
            is_cut = number == self._line + len(lines) and not is_terminated
            if is_cut:
                self._counts.cut_off(f"line {number}")
                cells = [*cells[:-1], *[""] * (header.width - len(cells) + 1)]
            while len(cells) > header.width and not cells[-1]:
                cells.pop()
            if self._is_header(cells):
                continue
            if self._has_other_columns:
                self._counts.reject(LogReject.MALFORMED, f"line {number}, behind a header of other columns")
                continue
            if len(cells) != header.width:
                self._counts.reject(LogReject.MALFORMED, f"line {number} ({len(cells)} cells, not {header.width})")
                continue
            rows.append(cells)
            numbers.append(number)
        self._line += len(lines)
        columns = list(zip(*rows, strict=True)) if rows else [()] * header.width
        time_us = self._times_us(columns[header.time_place], numbers)
        values = np.empty((len(rows), len(header.places)), np.float64)
        for slot, place in enumerate(header.places):
            values[:, slot] = self._values(columns[place], numbers, slot)
        return frames_of_rows(time_us, values, self._ids)

    def _is_header(self, cells: Sequence[str]) -> bool:
        """Return whether a row is the header again, or another one: what follows that belongs to other columns."""
        is_header = "".join(cells[self._header.time_place :][:1]).strip() in self._header.clock_words
        if is_header:
            self._has_other_columns = _stripped(cells) not in self._header.repeated
            self._counts.skipped += 1
        return is_header

    def _values(self, cells: Sequence[str], numbers: Sequence[int], slot: int) -> FloatArray:
        """Return a column as numbers, NaN for blank cells and for those that are none; the latter are counted."""
        if not self._header.has_decimal_comma:
            try:
                values = np.array(cells, np.str_).astype(np.float64) if cells else np.empty(0)
            except ValueError:
                values = np.empty(0)
            if len(values) == len(cells) and np.all(np.isfinite(values)):
                return values
        found = np.array([_number(cell) for cell in cells], np.float64)
        for row in np.flatnonzero(np.isinf(found)).tolist():
            if not (self._header.places[slot] in self._header.worded and WORD.fullmatch(cells[row])):
                name = self._header.columns[slot].name
                self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, column {name!r}")
        found[np.isinf(found)] = np.nan
        return found

    def _times_us(self, cells: Sequence[str], numbers: Sequence[int]) -> FloatArray:
        """Return the times of rows [us], NaN where there is none; such a row is counted."""
        unit = self._header.us_per_unit
        if unit is not None:
            with np.errstate(over="ignore"):  # a damaged number
                times_us = np.array([_number(cell) for cell in cells], np.float64) * unit
        else:
            times_us = np.array([self._clock_us(cell) for cell in cells], np.float64)
        is_bad = ~(np.abs(times_us) < MOST_US)
        for row in np.flatnonzero(is_bad).tolist():
            self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, its time")
        times_us[is_bad] = np.nan
        return np.rint(times_us)

    def _clock_us(self, cell: str) -> float:
        """Return a time of day or a date [us]; times of day go on over midnight."""
        found, is_date = _moment_us(cell)
        if is_date or np.isnan(found):
            return found
        if found + self._day_us < self._last_us - DAY_US / 2.0:
            self._day_us += DAY_US
        self._last_us = found + self._day_us
        return self._last_us


def frames_of_rows(time_us: FloatArray, values: FloatArray, ids: UInt32Array) -> FrameBatch:
    """Return a frame for each value that there is, row by row.

    Parameters
    ----------
    time_us : (n,) array
        Time of each row [us]; a row without one, NaN or beyond 285 years, is left out.
    values : (n, m) array
        NaN where there is no value.
    ids : (m,) array
        Identifier of each column, with its flag.
    """
    has_time = np.abs(time_us) < MOST_US
    has_value = (np.abs(values) < MOST_VALUE) & has_time[:, np.newaxis]
    rows, slots = np.nonzero(has_value)
    time_ns: Int64Array = np.where(has_time, time_us, 0.0).astype(np.int64) * 1000
    payload = np.ascontiguousarray(values[rows, slots], "<f8")
    return FrameBatch(
        t_ns=time_ns[rows],
        can_id=ids[slots],
        length=np.full(len(rows), 8, np.uint8),
        data=payload.view(np.uint8).reshape(-1, 8),
    )


def checked_rows(time_us: FloatArray, values: FloatArray, ids: UInt32Array, counts: LogCounts) -> FrameBatch:
    """Return rows of a binary table as `frames_of_rows` does; impossible values and rows without a time are counted."""
    counts.reject(LogReject.MALFORMED, "a row without a time", int(np.count_nonzero(~(np.abs(time_us) < MOST_US))))
    counts.reject(LogReject.MALFORMED, "a value beyond all measurements", int((np.abs(values) >= MOST_VALUE).sum()))
    return frames_of_rows(time_us, values, ids)


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
    names = _names_of(rows, place, separator)
    width = len(names)
    if not 1 < width <= MOST_COLUMNS or sum(bool(NUMBER.fullmatch(name.strip())) for name in names) > 0:
        return None
    first = place + 1
    units: Sequence[str] = ()
    while len(rows) > first and _are_units(rows[first], width):  # the last: types may stand before it
        units, first = rows[first], first + 1
        if any(len(units[one]) > 1 for one in time_places(units, ())) and not time_places(names, ()):
            return None  # that is the header, and this a line before it
    repeated = frozenset(map(_stripped, rows[place:first]))
    filled = [row for row in rows[first:] if any(row) and _stripped(row) not in repeated]
    body = [row[:width] for row in filled if len(row) >= width and not any(row[width:])]
    if len(body) < LEAST_ROWS or len(body) < len(filled) / 2:
        return None
    cells = [[row[one].strip() for row in body] for one in range(width)]
    commas = [cell for column in cells for cell in column if "," in cell and NUMBER.fullmatch(cell)]
    has_comma = any(separator != "," or not GROUPED.fullmatch(cell) for cell in commas)
    if separator == "," and not has_comma:
        cells = [_ungrouped(column) for column in cells]
    payloads = [one for one in range(width) if _is_payload(cells[one])]
    is_traffic = len(payloads) > 1 or any(not STATUS.fullmatch(cell) for one in payloads for cell in cells[one] if cell)
    clock = next((one for one in time_places(names) if _rises(cells[one])), None)
    if is_traffic or clock is None:
        return None
    columns, notes = signal_columns(names, units)
    others = [one for one in range(width) if columns[one].name and one not in {clock, *payloads}]
    blanks = {one: words for one in others if (words := _words_for_blanks(cells[one])) is not None}
    left_out = [columns[one].name for one in range(width) if one not in {clock, *blanks} and any(cells[one])]
    notes += [f"columns of words are left out: {', '.join(left_out)}"] * bool(left_out)
    time_us, unit, said = _clock_us(cells[clock], columns[clock])
    paces = {one: _pace(cells[one], columns[one], time_us) for one in time_places(names, ()) if one != clock}
    clocks = sorted([clock, *(one for one, pace in paces.items() if pace)])
    for other in [one for one in clocks if one != clock and not 1.0 / MOST_PACE <= paces[one] <= MOST_PACE]:
        stop = next((one for one in clocks if one > other), width)
        behind = ", ".join(columns[one].name for one in range(other, stop) if blanks.pop(one, None) is not None)
        notes.append(f"{columns[other].name!r} is another clock than that of the rows; left out are {behind}")
    if not blanks:
        return None
    notes += [f"{columns[one].name!r} has no value at {', '.join(words)}" for one, words in blanks.items() if words]
    return TableHeader(
        separator=separator, lines=first, width=width, time_place=clock, us_per_unit=unit, notes=(*said, *notes),
        has_decimal_comma=has_comma, columns=tuple(columns[one] for one in blanks), places=tuple(blanks),
        worded=frozenset(one for one, words in blanks.items() if words),
        repeated=repeated, clock_words=frozenset(row[clock].strip() for row in rows[place:first]) - {""},
    )  # fmt: skip


def _clock_us(cells: Sequence[str], column: SignalColumn) -> tuple[FloatArray, float | None, list[str]]:
    """Return the times in a column [us], NaN or infinite where there is none, their unit if they are numbers, notes."""
    numbers = np.array([_number(cell) for cell in cells])
    if np.isfinite(numbers).sum() < LEAST_RISING * sum(map(bool, cells)):
        return np.array([_moment_us(cell)[0] for cell in cells]), None, []
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
    numbers = ((_number(cell), cell) for cell in cells if cell)
    moments = [number if math.isfinite(number) else _moment_us(cell)[0] for number, cell in numbers]
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
    found = [(cell, _number(cell)) for cell in cells]
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


def _number(cell: str) -> float:
    """Return the number in a cell, NaN for a blank one, infinity for anything that is no measurement."""
    text = cell.strip()
    if NUMBER.fullmatch(text):
        value = float(text.replace(",", "."))
        return value if abs(value) < MOST_VALUE else np.inf
    folded = text.casefold()
    return np.nan if folded in BLANKS else WORDS.get(folded, np.inf)


def _moment_us(cell: str) -> tuple[float, bool]:
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


def _cells(line: str, separator: str) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _names_of(rows: Sequence[Sequence[str]], place: int, separator: str) -> list[str]:
    """Return the names in a row, without empty ones at its end.

    Where no other row has as many cells, those are one between whose brackets a separator stands: some quote none.
    """
    names = list(rows[place])
    while names and not names[-1].strip():
        names.pop()
    if any(len(row) == len(names) for row in rows[place + 1 :]):
        return names
    found = list[str]()
    for name in names:
        if found and found[-1].count("(") > found[-1].count(")"):
            found[-1] += separator + name
        else:
            found.append(name)
    return found


def _stripped(row: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of a row without blanks around them and without empty ones at its end."""
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _ungrouped(cells: Iterable[str]) -> list[str]:
    return [cell.replace(",", "") if "," in cell and GROUPED.fullmatch(cell.strip()) else cell for cell in cells]


def _lines(text: bytes) -> list[str]:
    """Return the lines of a text in UTF-8 or, where it is not that, in the code page of Windows."""
    try:
        decoded = text.decode("utf-8-sig")
    except UnicodeDecodeError:
        decoded = text.decode("cp1252", "replace")
    return decoded.replace("\r\n", "\n").removesuffix("\n").split("\n")


def _blocks(stream: BinaryIO, counts: LogCounts) -> Iterator[tuple[bytes, bool]]:
    """Yield a text in pieces of whole lines, with whether the last one has its end; what is too long is no row."""
    kept = b""
    while got := stream.read(BLOCK_BYTES):
        text = kept + got
        end = text.rfind(b"\n") + 1
        if end:
            yield text[:end], True
        kept = text[end:]
        if len(kept) > MOST_ROW_BYTES:
            counts.reject(LogReject.MALFORMED, "a row that does not end")
            kept = b""
    if kept.strip():
        yield kept, False
