"""Tables of signals: a row for each moment, a column for each signal, as frames of `canlog.database.signal_columns`.

Test benches, tuners and scan tools write them. Blank cells are no values; a cell that is neither blank nor a number is
counted and told, and costs no other cell of its row. Some have a column of times before each group of signals, and some
a row for each value, with the name of its signal.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice, pairwise
from typing import BinaryIO, Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, FrameBatch, empty_batch, join
from canlog.logs.dates import moment_of
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.signal_tables.cells import MOST_VALUE, WORD, numbers_in, without_unit
from canlog.logs.signal_tables.columns import LONG_UNITS, place_of
from canlog.logs.signal_tables.dialect import dialect_of, is_comment, lines_in, stripped
from canlog.logs.signal_tables.header import MOST_COLUMNS, PREAMBLE_ROWS, SECTION, is_header_row
from canlog.logs.signal_tables.recordings import (
    AS_BEFORE,
    BEGINS_WITH_WORD,
    LINES_OF_PROBE,
    MOST_HEADER_LINES,
    first_rows,
    is_other_header,
    later_header,
    other_header,
)
from canlog.logs.signal_tables.table import TableHeader, table_header

BLOCK_BYTES: Final = 1024 * 1024
WORD_FIRST: Final = re.compile(rb"\n[ \t\r\"';,|#]*[A-Za-z\x80-\xff]")  # of a line that may be a header
MOST_TRIES: Final = 50  # to read lines of words as a header, in one table
MOST_ROW_BYTES: Final = 256 * 1024  # whatever is longer is no row
MOST_US: Final = 2.0**53  # beyond, a time is not told to the microsecond


def all_columns(stream: BinaryIO) -> tuple[SignalColumn, ...]:
    """Return the columns of a table; of one with a row for each value all signals that it names anywhere.

    Of several recordings one behind the other all columns are returned. The stream is at its beginning before and
    afterwards. Raises SourceError if it is no table of signals.
    """
    columns = dict[str, SignalColumn]()
    for part in _parts(stream, LogCounts()):
        header = part.header
        new: Iterable[SignalColumn] = header.columns if part.is_first else ()
        if header.name_place is not None:
            new = _named_in(part.lines, header, header.name_place)
        for column in new:
            if len(columns) < MOST_COLUMNS:
                columns.setdefault(column.name, column)
    stream.seek(0)
    return tuple(columns.values())


def _named_in(lines: Sequence[str], header: TableHeader, name_place: int) -> Iterator[SignalColumn]:
    """Yield the signals that rows with a value each name."""
    unit_place = place_of(header.names, LONG_UNITS)
    for line in lines:
        cells = header.row(header.dialect.cells(line))
        if (
            len(cells) >= header.width
            and stripped(cells) not in header.repeated
            and (name := cells[name_place].strip())
        ):
            yield SignalColumn(name, "" if unit_place is None else cells[unit_place].strip())


def read_signal_table(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the values of a table as frames, a batch for about a mebibyte of text.

    Raises SourceError if its beginning is no table of signals.
    """
    table: _Table | None = None
    for part in _parts(stream, counts):
        batches = list[FrameBatch]()
        if part.is_first:
            before, table = table, _Table(part.header, counts, part.line)
            if before is not None:
                batches.append(table.go_on_from(before))
        if table is not None:
            batches.append(table.read(part.lines, is_terminated=part.is_terminated))
        if batch := _filled(batches, counts):
            yield batch
    if table is not None and (batch := _filled([table.finish()], counts)):
        yield batch


def _filled(batches: Sequence[FrameBatch], counts: LogCounts) -> FrameBatch | None:
    """Return the frames of some batches, counted; None if there are none."""
    filled = [batch for batch in batches if len(batch)]
    counts.frames += sum(map(len, filled))
    return join(filled) if filled else None


class _Part(NamedTuple):
    """Some lines that follow each other, all of one recording or of several with the same columns."""

    header: TableHeader
    line: int  # how many lines stand before them
    lines: Sequence[str]
    is_first: bool  # of that header, which is among them
    is_terminated: bool = True  # whether the last line has its end


def _parts(stream: BinaryIO, counts: LogCounts) -> Iterator[_Part]:
    """Yield the lines of a table from the first on, parted where a header of other columns or units stands.

    Raises SourceError if the beginning is no table of signals.
    """
    blocks = _blocks(stream, counts)
    first = list(islice(blocks, 2))  # a short text and what follows its last newline
    header = table_header(b"".join(text for text, _ in first))
    if header is None:
        raise SourceError("no table of signals")
    known = {column.name: column for column in header.columns}
    is_first, was_terminated, line, tries, lines = True, True, 0, 0, list[str]()
    for text, is_terminated in chain(first, blocks, [(b"", True)]):
        begin = place = 0
        if text:
            has_words = bool(lines) or line < header.lines or WORD_FIRST.search(b"\n" + text) is not None
            lines, was_terminated = [*lines, *lines_in(text)] if lines else lines_in(text), is_terminated
            place = 0 if has_words else len(lines)
        while (place := _header_after(lines, place, header, line)) < len(lines):
            if len(lines) - place < LINES_OF_PROBE and text:
                break  # what follows tells more
            rows = [_cells(other, header) for other in lines[place : place + MOST_HEADER_LINES]]
            found = None
            if tries < MOST_TRIES and is_other_header(rows, header):
                found = other_header(lines[place:], header, known)
                tries += found is None
            if found is None:
                place += 1
                continue
            if place > begin:
                yield _Part(header, line + begin, lines[begin:place], is_first)
            header, begin, is_first = replace(found, lines=line + place + found.lines), place, True
            known = {**{column.name: column for column in header.columns}, **known}
            place += found.lines
        if place > begin:
            is_cut = place == len(lines) and not was_terminated
            yield _Part(header, line + begin, lines[begin:place], is_first, is_terminated=not is_cut)
            is_first = False
        line, lines = line + place, lines[place:]


def _cells(line: str, header: TableHeader) -> Sequence[str]:
    """Return the cells of a line, in another dialect if it has but one in that of the header."""
    cells = header.dialect.cells(line)
    return cells if len(cells) > 1 else dialect_of([line]).cells(line)


def _header_after(lines: Sequence[str], place: int, header: TableHeader, before: int) -> int:
    """Return the first line from a place on that may be a header between rows; how many there are if none is.

    ``before`` is how many lines of the file were before these.
    """
    for number in range(max(place, header.lines - before), len(lines)):
        line = lines[number]
        if line[:1].isdigit():  # of nearly all
            continue
        if BEGINS_WITH_WORD.match(line) and is_header_row(_cells(line, header)):
            return number
    return len(lines)


class _Table:
    """Reads the rows of one table."""

    def __init__(self, header: TableHeader, counts: LogCounts, line: int) -> None:
        self._header = header
        self._counts = counts
        self._line = line  # how many were read
        self._laps = {place: _Laps(reading.wraps_us) for place, reading in header.clocks.items()}
        self._later = AS_BEFORE
        self._is_new = False  # a header was the last that is not blank
        self._odd_lines = list[str]()  # before a header that may come, to which they belong then
        self._last_us: dict[int, float] = {}
        self._ids = np.array([column_id(one.name) | EXTENDED_FLAG for one in header.columns], np.uint32)
        self._held_back = empty_batch()  # values that are later than those of another clock that are still to come
        for note in header.notes:
            counts.note(note)

    def go_on_from(self, before: "_Table") -> FrameBatch:
        """Return what a recording before held back; times of day go on, and lines before this header belong to it."""
        own, former = self._header, before._header  # noqa: SLF001 - of the same class
        names = ", ".join(column.name for column in own.columns)
        self._counts.note(f"line {self._line + 1} begins a recording with columns of its own: {names}")
        if own.clocks[own.time_place] == former.clocks[former.time_place]:
            self._laps[own.time_place] = before._laps[former.time_place]  # noqa: SLF001 - likewise
        self._counts.skipped += len(before._odd_lines)  # noqa: SLF001 - likewise
        before._odd_lines.clear()  # noqa: SLF001 - likewise
        return before.finish()

    def read(self, lines: Sequence[str], *, is_terminated: bool) -> FrameBatch:
        """Return the values of some lines; of a last line without its end all but the last cell."""
        header = self._header
        rows = self._rows(lines, is_terminated=is_terminated)
        columns = list(zip(*rows.cells, strict=True)) if rows.cells else [()] * header.width
        clocks = {place: self._times_us(place, columns, rows.numbers) for place in header.clocks}
        if header.name_place is not None:
            names = [cell.strip() for cell in columns[header.name_place]]
            ids = np.array([column_id(name) | EXTENDED_FLAG for name in names], np.uint32)
            values = self._values(columns[header.places[0]], rows.numbers, 0)
            return frames_of_values(clocks[header.time_place], values, ids)
        values = np.empty((len(rows.cells), len(header.places)), np.float64)
        for slot, place in enumerate(header.places):
            values[:, slot] = self._values(columns[place], rows.numbers, slot)
        if len(clocks) == 1:
            return frames_of_rows(clocks[header.time_place], values, self._ids)
        return self._by_times(clocks, values, rows.behind_header)

    def finish(self) -> FrameBatch:
        """Return the values that were held back at the end of the table."""
        self._reject_odd_lines()
        return self._held_back

    def _rows(self, lines: Sequence[str], *, is_terminated: bool) -> "_Rows":
        """Return the rows of values among some lines."""
        header, rows = self._header, _Rows([], [], [])
        for number, line in enumerate(lines, self._line + 1):
            if number <= header.lines or not line.strip() or SECTION.fullmatch(line.strip()):
                continue
            cells = header.dialect.cells(line)
            if number == self._line + len(lines) and not is_terminated:
                self._counts.cut_off(f"line {number}")
                cells = [*cells[:-1], *[""] * (header.width - len(cells) + 1)]
            if self._is_header(cells):
                continue
            if not line[0].isdigit() and is_comment(cells):
                self._counts.skipped += 1
                continue
            if self._later.is_unknown:
                self._counts.reject(LogReject.MALFORMED, f"line {number}, behind a header of other columns")
                continue
            cells = header.row(list(self._later.in_order(cells)))
            if len(cells) == header.width:
                self._add(cells, number, rows)
            else:
                self._odd_lines.append(f"line {number} ({len(cells)} cells, not {header.width})")
        self._line += len(lines)
        if len(self._odd_lines) > PREAMBLE_ROWS:
            self._reject_odd_lines()
        return rows

    def _add(self, cells: list[str], number: int, rows: "_Rows") -> None:
        """Add a row of values; lines before it that were none are no part of a header."""
        self._reject_odd_lines()
        if self._is_new:
            rows.behind_header.append(len(rows.cells))
        self._is_new = False
        rows.cells.append(cells)
        rows.numbers.append(number)

    def _is_header(self, cells: Sequence[str]) -> bool:
        """Return whether a row is the header again, or another one; cells behind that are found by their names."""
        later = later_header(cells, self._header)
        if later is None:
            return False
        self._later, self._is_new = later, True
        if later.new_names:
            names = ", ".join(sorted(later.new_names))
            self._counts.note(f"columns that only a later header names are left out: {names}")
        self._counts.skipped += 1 + len(self._odd_lines)  # what stood before it belongs to it
        self._odd_lines.clear()
        return True

    def _reject_odd_lines(self) -> None:
        """Count lines that have too many or too few cells, and are no part of a header."""
        for place in self._odd_lines:
            self._counts.reject(LogReject.MALFORMED, place)
        self._odd_lines.clear()

    def _by_times(
        self, clocks: Mapping[int, FloatArray], values: FloatArray, behind_header: Sequence[int]
    ) -> FrameBatch:
        """Return values of several clocks by their times, one recording after the other.

        Within a recording they come as far as no clock is behind; the others are held back.
        """
        time_us = np.column_stack([clocks[place] for place in self._header.clock_places])
        before = [np.array([self._last_us.get(place, np.nan)]) for place in clocks]
        joined = [np.concatenate([last, own]) for last, own in zip(before, clocks.values(), strict=True)]
        begins = [row - 1 for row in first_rows(joined, [row + 1 for row in behind_header])]
        batches = list[FrameBatch]()
        for begin, end in pairwise([*begins, len(values)]):
            rows = slice(max(begin, 0), end)
            if begin >= 0:  # a recording ended
                batches.append(self._held_back)
                self._held_back = empty_batch()
            batch = frames_of_rows(time_us[rows], values[rows], self._ids)
            batches.append(self._in_order(batch, [own[rows] for own in clocks.values()]))
        for place, own in clocks.items():
            if np.isfinite(own).any():
                self._last_us[place] = float(own[np.isfinite(own)][-1])
        return join(batches)

    def _in_order(self, batch: FrameBatch, clocks: Iterable[FloatArray]) -> FrameBatch:
        batch = join([self._held_back, batch])
        batch = batch[np.argsort(batch.t_ns, kind="stable")]
        ends_us = [float(np.nanmax(time_us)) for time_us in clocks if np.isfinite(time_us).any()]
        end = int(np.searchsorted(batch.t_ns, int(min(ends_us, default=0.0)) * 1000, side="right"))
        self._held_back = batch[end:]
        return batch[:end]

    def _values(self, cells: Sequence[str], numbers: Sequence[int], slot: int) -> FloatArray:
        """Return a column as numbers, NaN for blank cells and for those that are none; the latter are counted."""
        header, place = self._header, self._header.places[slot]
        if unit := header.units_behind.get(place):
            cells = [without_unit(cell, unit) for cell in cells]
        found = numbers_in(cells, header.marks)
        for row in np.flatnonzero(np.isinf(found)).tolist():
            if not (place in header.worded and WORD.fullmatch(cells[row])):
                name = header.columns[slot].name
                self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, column {name!r}")
        found[np.isinf(found)] = np.nan
        return found

    def _times_us(self, place: int, columns: Sequence[Sequence[str]], numbers: Sequence[int]) -> FloatArray:
        """Return the times in a place [us], NaN where there is none; a row without its time is counted."""
        header, cells = self._header, columns[place]
        if unit := header.units_behind.get(place):
            cells = [without_unit(cell, unit) for cell in cells]
        times_us = header.clocks[place].times_us(cells, header.marks)
        if header.date_place is None or place != header.time_place:
            times_us = self._laps[place].go_on(times_us) + header.base_us
        else:
            times_us = times_us + self._days_us(columns[header.date_place])
        is_bad = ~(np.abs(times_us) < MOST_US)
        for row in np.flatnonzero(is_bad).tolist():
            if len(header.clocks) == 1 or cells[row].strip():
                self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, its time")
        times_us[is_bad] = np.nan
        return np.rint(times_us)

    def _days_us(self, cells: Sequence[str]) -> FloatArray:
        """Return the days in a column [us]."""
        days = {cell: moment_of(cell, is_month_first=self._header.is_month_first) for cell in set(cells)}
        return np.array([np.nan if (day := days[cell]) is None else day.us for cell in cells], np.float64)


class _Rows(NamedTuple):
    """Rows of values, in the order of the first header."""

    cells: list[list[str]]
    numbers: list[int]  # of their lines
    behind_header: list[int]  # those before which a header stood


class _Laps:
    """Lets times of a day or an hour go on when they begin again."""

    def __init__(self, wraps_us: float) -> None:
        self._wraps_us = wraps_us
        self._last_us = -np.inf  # as it was read
        self._passed_us = 0.0

    def go_on(self, times_us: FloatArray) -> FloatArray:
        """Return times that go on."""
        rows = np.flatnonzero(np.isfinite(times_us))
        if not self._wraps_us or not len(rows):
            return times_us
        read_us = times_us[rows]
        steps_us = np.diff(read_us, prepend=self._last_us)
        laps = np.cumsum(steps_us < -self._wraps_us / 2.0)
        times_us[rows] += self._passed_us + self._wraps_us * laps
        self._last_us, self._passed_us = float(read_us[-1]), self._passed_us + self._wraps_us * float(laps[-1])
        return times_us


def frames_of_values(time_us: FloatArray, values: FloatArray, ids: UInt32Array) -> FrameBatch:
    """Return a frame for each value that there is, in their order.

    Parameters
    ----------
    time_us : (n,) array
        Time of each value [us]; one without a time, NaN or beyond 285 years, is left out.
    values : (n,) array
        NaN where there is no value.
    ids : (n,) array
        Identifier of each, with its flag.
    """
    is_there = (np.abs(values) < MOST_VALUE) & (np.abs(time_us) < MOST_US)
    time_ns: Int64Array = time_us[is_there].astype(np.int64) * 1000
    payload = np.ascontiguousarray(values[is_there], "<f8")
    return FrameBatch(
        t_ns=time_ns,
        can_id=ids[is_there],
        length=np.full(len(payload), 8, np.uint8),
        data=payload.view(np.uint8).reshape(-1, 8),
    )


def frames_of_rows(time_us: FloatArray, values: FloatArray, ids: UInt32Array) -> FrameBatch:
    """Return a frame for each value that there is, row by row.

    Parameters
    ----------
    time_us : (n,) or (n, m) array
        Time of each row, or of each value, as in `frames_of_values`.
    values : (n, m) array
        NaN where there is no value.
    ids : (m,) array
        Identifier of each column, with its flag.
    """
    times_us = np.broadcast_to(time_us.reshape(len(values), -1 if len(values) else 1), values.shape)
    return frames_of_values(times_us.ravel(), values.ravel(), np.tile(ids, len(values)))


def checked_rows(time_us: FloatArray, values: FloatArray, ids: UInt32Array, counts: LogCounts) -> FrameBatch:
    """Return rows of a binary table as `frames_of_rows` does; impossible values and rows without a time are counted."""
    counts.reject(LogReject.MALFORMED, "a row without a time", int(np.count_nonzero(~(np.abs(time_us) < MOST_US))))
    counts.reject(LogReject.MALFORMED, "a value beyond all measurements", int((np.abs(values) >= MOST_VALUE).sum()))
    return frames_of_rows(time_us, values, ids)


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
