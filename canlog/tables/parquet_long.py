"""Decoded frames as long Parquet: a row per value, in the order of frames and of the signals in them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.decode.carriers import Carriers
from canlog.parquet import contents
from canlog.parquet.column_file import Levels
from canlog.parquet.packing import Int32Array
from canlog.parquet_file import NAME_TYPE
from canlog.tables.coded_signals import NAMELESS, CodedSignal, ValueTexts
from canlog.tables.frame_contents import frame_contents
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.layouts import SIGNAL, TEXT, UNIT, VALUE, Values
from canlog.tables.parquet_tables import ParquetRows
from canlog.tables.value_rows import SignalRuns, values_by_frame


@dataclass(slots=True)
class _Signals:
    """The signals of a group of rows as they are found, those of one message after the other."""

    index: Int32Array  # (rows,) of all values, signal by signal
    begin: Int64Array  # (messages + 1,) as of SignalRuns
    is_shared: BoolArray  # (messages,) as of SignalRuns
    names: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    run: list[int] = field(default_factory=list)
    first: list[int] = field(default_factory=list)
    base: list[int] = field(default_factory=list)
    values: list[FloatArray] = field(default_factory=list)  # the different ones
    texts: list[Int32Array] = field(default_factory=list)  # of each of these
    text_names: dict[str, int] = field(default_factory=dict)
    row_count: int = 0
    value_count: int = 0

    def add(self, name: str, unit: str, run: int, coded: CodedSignal) -> None:
        """Add a signal."""
        self.names.append(name)
        self.units.append(unit)
        self.run.append(run)
        self.first.append(self.row_count)
        self.base.append(self.value_count)
        self.values.append(coded.values)
        self.index[self.row_count : self.row_count + len(coded.index)] = coded.index
        self.row_count += len(coded.index)
        self.value_count += len(coded.values)

    def add_texts(self, coded: CodedSignal, known: ValueTexts | None) -> None:
        """Add the texts of its values."""
        numbers = [self.text_names.setdefault(text, len(self.text_names)) for text in known.names] if known else []
        code = np.full(len(coded.values), NAMELESS) if coded.texts is None else coded.texts
        self.texts.append(np.array([*numbers, NAMELESS], np.int32)[code])  # the last place is NAMELESS, too

    def renumber(self, number: Int32Array) -> None:
        """Let values be known by numbers that all signals share: ``number`` of the values of one after the other."""
        ends = [*self.first[1:], self.row_count], [*self.base[1:], self.value_count]
        for first, base, stop, last in zip(self.first, self.base, *ends, strict=True):
            self.index[first:stop] = number[base:last][self.index[first:stop]]

    def runs(self, found: Sequence[Carriers]) -> SignalRuns:
        """Return where everything is."""
        return SignalRuns(
            begin=self.begin,
            is_shared=self.is_shared,
            run=np.array(self.run, np.int64),
            first=np.array(self.first, np.int64),
            frame=np.concatenate([one.frames for one in found]),
            run_begin=np.cumsum([0, *(len(one.frames) for one in found)]),
        )


@dataclass(frozen=True, slots=True)
class _Rows:
    """A row per value."""

    value: Int32Array  # (rows,) number of its value among the different ones
    signal: Int32Array  # (rows,) number of its signal
    distinct: FloatArray
    text: Int32Array | None  # (rows,) number of its text


class LongParquet(ParquetRows):
    """A row per value."""

    def write_group(self, group: FrameGroup) -> None:
        """Write frames, a row for each of their values."""
        found = list(self._carriers(group))
        repeats = np.zeros(len(group), np.int32)
        for one in found:
            repeats[one.frames] += len(one.signals)
        row_count = int(repeats.sum())
        signals = self._signals(found, row_count, group.slot)
        if not row_count:
            return
        rows = self._rows(group, signals, signals.runs(found))
        everywhere = self._file.everywhere(row_count)
        columns = frame_contents(group, self._names.messages, self._origins, self._file.packer, repeats)
        columns[SIGNAL] = self._names_of(rows, signals.names)
        columns[UNIT] = self._names_of(rows, signals.units)
        for name, content in columns.items():
            self._file.add(name, self._layout.kinds[name], everywhere, content)
        self._write_values(rows, list(signals.text_names), everywhere)
        self._file.end_group(row_count)
        self._account.row_count += row_count

    def _signals(self, found: Sequence[Carriers], row_count: int, slots: Int64Array) -> _Signals:
        """Return the values of all signals in the order of their messages."""
        count = len(self._tables)
        frame_counts = np.bincount(slots, minlength=count)
        signals = _Signals(np.empty(row_count, np.int32), np.zeros(count + 1, np.int64), np.zeros(count, np.bool_))
        for slot, parts in groupby(enumerate(found), key=lambda part: part[1].slot):
            carrier_of = {name: part for part in parts for name in part[1].signals}
            for name in self._tables[slot].signals:
                run, one = carrier_of[name]
                coded = self._coded(one, name)
                signals.add(name, self._layout.unit((slot, name)), run, coded)
                if self._values is not Values.NUMBERS:
                    signals.add_texts(coded, self._layout.texts.get((slot, name)))
            signals.begin[slot + 1] = len(carrier_of)
            runs = dict(carrier_of.values())
            signals.is_shared[slot] = all(
                len(runs) == 1 and len(one.frames) == frame_counts[slot] for one in runs.values()
            )
        np.cumsum(signals.begin, out=signals.begin)
        return signals

    def _rows(self, group: FrameGroup, signals: _Signals, runs: SignalRuns) -> _Rows:
        """Return the values in the order of their frames."""
        distinct = np.concatenate(signals.values)
        if not signals.texts:  # signals share many values; but what a value is called depends on the signal
            found = self._file.packer.numbered(distinct.view(np.int64))
            distinct = found.distinct.view(np.float64)
            signals.renumber(found.index)
        else:
            signals.renumber(np.arange(len(distinct), dtype=np.int32))
        value, signal = np.empty((2, len(signals.index)), np.int32)
        cursor = np.zeros(len(runs.run_begin), np.int64)
        values_by_frame(group.slot, runs, signals.index, cursor, value, signal)
        return _Rows(value, signal, distinct, np.concatenate(signals.texts)[value] if signals.texts else None)

    def _names_of(self, rows: _Rows, names: Sequence[str]) -> contents.Content:
        """Return a text column in which every signal has one text."""
        known = {name: number for number, name in enumerate(dict.fromkeys(names))}
        number_of = np.array([known[name] for name in names], np.int32)
        index = rows.signal if len(known) in {1, len(names)} else number_of[rows.signal]
        return contents.names(list(known), self._file.packer.runs(index, len(known)))

    def _write_values(self, rows: _Rows, texts: Sequence[str], everywhere: Levels) -> None:
        """Write the numbers, and the texts if they are wanted."""
        packer, count = self._file.packer, len(rows.value)
        levels, distinct, index = everywhere, rows.distinct, rows.value
        if rows.text is not None:
            is_named = rows.text != NAMELESS
            if is_named.any():
                named = self._file.levels(np.flatnonzero(is_named), count)
                body = packer.runs(rows.text[is_named], len(texts))
                self._file.add(TEXT, NAME_TYPE, named, contents.names(texts, body))
                if self._values is Values.TEXTS:
                    levels = self._file.levels(np.flatnonzero(~is_named), count)
                    found = packer.numbered(distinct.view(np.int64)[index[~is_named]])
                    distinct, index = found.distinct.view(np.float64), found.index
        if len(index):
            self._file.add(VALUE, "float64", levels, contents.numbers(distinct, index, packer))
