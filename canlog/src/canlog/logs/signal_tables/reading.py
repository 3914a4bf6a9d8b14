"""Tables of signals: a row for each moment, a column for each signal, as frames of `canlog.database.signal_columns`.

Test benches, tuners and scan tools write them. Blank cells are no values; a cell that is neither blank nor a number is
counted and told, and costs no other cell of its row. Some have a column of times before each group of signals, and some
a row for each value, with the name of its signal.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import BinaryIO, Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, UInt32Array
from canlog.database.signal_columns import SignalColumn, column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, FrameBatch, empty_batch, join
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.signal_tables.cells import MOST_VALUE, WORD, number_in, ungrouped
from canlog.logs.signal_tables.clock import DAY_US, moment_us
from canlog.logs.signal_tables.dialect import cells_of, lines_in, stripped
from canlog.logs.signal_tables.header import MOST_COLUMNS
from canlog.logs.signal_tables.table import LONG_UNITS, PROBE_BYTES, TableHeader, place_of, table_header

BLOCK_BYTES: Final = 1024 * 1024
MOST_ROW_BYTES: Final = 256 * 1024  # whatever is longer is no row
MOST_US: Final = 2.0**53  # beyond, a time is not told to the microsecond
SECTION: Final = re.compile(r"\[[\w ]+\]")  # a title between header and rows


def all_columns(stream: BinaryIO) -> tuple[SignalColumn, ...]:
    """Return the columns of a table; of one with a row for each value all signals that it names anywhere.

    The stream is at its beginning before and afterwards. Raises SourceError if it is no table of signals.
    """
    header = table_header(stream.read(PROBE_BYTES))
    stream.seek(0)
    if header is None:
        raise SourceError("no table of signals")
    if header.name_place is None:
        return header.columns
    columns = dict[str, SignalColumn]()
    unit_place = place_of(header.names, LONG_UNITS)
    for text, _ in _blocks(stream, LogCounts()):
        for line in lines_in(text):
            cells = cells_of(line, header.separator)
            if len(cells) >= header.width and stripped(cells) not in header.repeated:
                name, unit = cells[header.name_place].strip(), "" if unit_place is None else cells[unit_place].strip()
                if name and len(columns) < MOST_COLUMNS:
                    columns.setdefault(name, SignalColumn(name, unit))
    stream.seek(0)
    return tuple(columns.values())


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
    if len(table.held_back):
        counts.frames += len(table.held_back)
        yield table.held_back


class _Table:
    """Reads the rows of one table."""

    def __init__(self, header: TableHeader, counts: LogCounts) -> None:
        self._header = header
        self._counts = counts
        self._line = 0
        self._day_us = 0.0  # that have passed since the first time of day
        self._last_us = -1.0
        self._order: list[int | None] | None = None  # where the cells of the header are behind another one
        self._is_unknown = False  # what is behind a header without times
        self._ids = np.array([column_id(one.name) | EXTENDED_FLAG for one in header.columns], np.uint32)
        self.held_back = empty_batch()  # values that are later than those of another clock that are still to come
        for note in header.notes:
            counts.note(note)

    def read(self, text: bytes, *, is_terminated: bool) -> FrameBatch:
        """Return the values of a block of whole lines; of a last line without its end all but the last cell."""
        header = self._header
        rows, numbers = self._rows(lines_in(text), is_terminated=is_terminated)
        columns = list(zip(*rows, strict=True)) if rows else [()] * header.width
        clocks = {place: self._times_us(columns[place], numbers, unit) for place, unit in header.clocks.items()}
        if header.name_place is not None:
            names = [cell.strip() for cell in columns[header.name_place]]
            ids = np.array([column_id(name) | EXTENDED_FLAG for name in names], np.uint32)
            return frames_of_values(clocks[header.time_place], self._values(columns[header.places[0]], numbers, 0), ids)
        values = np.empty((len(rows), len(header.places)), np.float64)
        for slot, place in enumerate(header.places):
            values[:, slot] = self._values(columns[place], numbers, slot)
        if len(clocks) == 1:
            return frames_of_rows(clocks[header.time_place], values, self._ids)
        time_us = np.column_stack([clocks[place] for place in header.clock_places])
        return self._in_order(frames_of_rows(time_us, values, self._ids), clocks.values())

    def _rows(self, lines: Sequence[str], *, is_terminated: bool) -> tuple[list[list[str]], list[int]]:
        """Return the cells of the rows of values among some lines, in the order of the header, and their numbers."""
        header, rows, numbers = self._header, list[list[str]](), list[int]()
        for number, line in enumerate(lines, self._line + 1):
            if number <= header.lines or not line.strip() or SECTION.fullmatch(line.strip()):
                continue
            cells = cells_of(line, header.separator)
            if header.separator == "," and not header.has_decimal_comma and '"' in line:
                cells = ungrouped(cells)
            if number == self._line + len(lines) and not is_terminated:
                self._counts.cut_off(f"line {number}")
                cells = [*cells[:-1], *[""] * (header.width - len(cells) + 1)]
            while len(cells) > header.width and not cells[-1]:
                cells.pop()
            if self._is_header(cells):
                continue
            if self._order is not None and not self._is_unknown:
                cells = ["" if place is None else "".join(cells[place : place + 1]) for place in self._order]
            if self._is_unknown:
                self._counts.reject(LogReject.MALFORMED, f"line {number}, behind a header of other columns")
            elif len(cells) != header.width:
                self._counts.reject(LogReject.MALFORMED, f"line {number} ({len(cells)} cells, not {header.width})")
            else:
                rows.append(cells)
                numbers.append(number)
        self._line += len(lines)
        return rows, numbers

    def _in_order(self, batch: FrameBatch, clocks: Iterable[FloatArray]) -> FrameBatch:
        """Return values of several clocks by their times, as far as no clock is behind; the others are held back."""
        batch = join([self.held_back, batch])
        batch = batch[np.argsort(batch.t_ns, kind="stable")]
        ends_us = [float(np.nanmax(time_us)) for time_us in clocks if np.isfinite(time_us).any()]
        end = int(np.searchsorted(batch.t_ns, int(min(ends_us, default=0.0)) * 1000, side="right"))
        self.held_back = batch[end:]
        return batch[:end]

    def _is_header(self, cells: Sequence[str]) -> bool:
        """Return whether a row is the header again, or another one: cells behind that are found by their names."""
        header = self._header
        is_header = "".join(cells[header.time_place :][:1]).strip() in header.clock_words
        if is_header and stripped(cells) not in header.repeated:
            places = {name.strip(): place for place, name in reversed(list(enumerate(cells)))}
            self._order = [places.get(name.strip()) for name in header.names]
            self._is_unknown = self._order[header.time_place] is None or not any(
                self._order[place] is not None for place in header.places
            )
            if news := places.keys() - {name.strip() for name in header.names} - {""}:
                self._counts.note(f"columns that only a later header names are left out: {', '.join(sorted(news))}")
        elif is_header:
            self._order, self._is_unknown = None, False
        self._counts.skipped += is_header
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
        found = np.array([number_in(cell) for cell in cells], np.float64)
        for row in np.flatnonzero(np.isinf(found)).tolist():
            if not (self._header.places[slot] in self._header.worded and WORD.fullmatch(cells[row])):
                name = self._header.columns[slot].name
                self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, column {name!r}")
        found[np.isinf(found)] = np.nan
        return found

    def _times_us(self, cells: Sequence[str], numbers: Sequence[int], unit: float | None) -> FloatArray:
        """Return the times in a place [us], NaN where there is none; a row without its time is counted."""
        if unit is not None:
            with np.errstate(over="ignore"):  # a damaged number
                times_us = np.array([number_in(cell) for cell in cells], np.float64) * unit
        else:
            times_us = np.array([self._clock_us(cell) for cell in cells], np.float64)
        is_bad = ~(np.abs(times_us) < MOST_US)
        for row in np.flatnonzero(is_bad).tolist():
            if len(self._header.clocks) == 1 or cells[row].strip():
                self._counts.reject(LogReject.MALFORMED, f"line {numbers[row]}, its time")
        times_us[is_bad] = np.nan
        return np.rint(times_us)

    def _clock_us(self, cell: str) -> float:
        """Return a time of day or a date [us]; times of day go on over midnight."""
        found, is_date = moment_us(cell)
        if is_date or np.isnan(found):
            return found
        if found + self._day_us < self._last_us - DAY_US / 2.0:
            self._day_us += DAY_US
        self._last_us = found + self._day_us
        return self._last_us + self._header.base_us


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
