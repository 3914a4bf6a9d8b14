"""Decoded batches as the columns of a Parquet file: wide, a row per frame, or long, a row per value.

Nothing is null that a frame carries: null are signals of other messages, of other pages of a multiplexer, and what lies
behind the end of a short frame.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, UInt8Array, UInt32Array
from canlog.decode.codec import MessageTable, MessageValues
from canlog.decode.signal_table import BoolArray, Decoded
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.parquet_file import BOOL_TYPE, NAME_TYPE, TIME_TYPE, load_pyarrow
from canlog.tables.names import TEXT_SUFFIX, Place, TableNames
from canlog.tables.texts import NAMELESS, Int32Array, Values, ValueTexts

TIME, CHANNEL, ID, IS_EXTENDED = "time", "channel", "id", "is_extended"
MESSAGE, SIGNAL, VALUE, TEXT, UNIT = "message", "signal", "value", "text", "unit"
FRAME_KINDS: Final = {TIME: TIME_TYPE, CHANNEL: "int64", ID: "int32", IS_EXTENDED: BOOL_TYPE, MESSAGE: NAME_TYPE}
_BARE_ID: Final = np.uint32(0x1FFF_FFFF)
Column = Any  # of pyarrow, which is untyped


@dataclass(frozen=True, slots=True)
class _Part:
    """Values of one signal in a batch."""

    message: str
    signal: str
    unit: str
    rows: Int64Array  # (n,) of the batch
    value: FloatArray  # (n,)
    codes: Int32Array | None  # (n,) of ``names``
    names: tuple[str, ...]


class Layout:
    """What both layouts share: the messages of a codec, how they are called, and how values are written."""

    def __init__(self, tables: Sequence[MessageTable], names: TableNames, values: Values) -> None:
        self._tables = tables
        self._names = names
        self._values = values
        self._texts: dict[Place, ValueTexts] = {}
        if values is not Values.NUMBERS:
            self._texts = {
                (slot, name): ValueTexts(table.definitions[name], compiled)
                for slot, table in enumerate(tables)
                for name, compiled in table.signals.items()
                if table.definitions[name].choices
            }

    def _frame_columns(self, batch: FrameBatch, rows: Int64Array) -> dict[str, Column]:
        """Return what is known of frames besides their signals."""
        arrow = load_pyarrow()
        can_id: UInt32Array = batch.can_id[rows]
        return {
            TIME: arrow.array(batch.t_ns[rows], type=arrow.timestamp("ns", "UTC")),
            CHANNEL: batch.channel[rows].astype(np.int64),
            ID: (can_id & _BARE_ID).astype(np.int32),
            IS_EXTENDED: (can_id & np.uint32(EXTENDED_FLAG)) != 0,
        }

    def _unit(self, place: Place) -> str:
        slot, name = place
        return self._tables[slot].definitions[name].unit or ""


class WideLayout(Layout):
    """A row per frame and a column per signal of some messages.

    Parameters
    ----------
    tables, names, values
        As of ``Layout``.
    slots : sequence of int
        The messages whose signals are columns, in their order.
    """

    def __init__(self, tables: Sequence[MessageTable], names: TableNames, values: Values, slots: Sequence[int]) -> None:
        super().__init__(tables, names, values)
        self._places = [(slot, name) for slot in slots for name in tables[slot].signals]

    @property
    def kinds(self) -> dict[str, str]:
        """Names and types of the columns."""
        kinds = dict(FRAME_KINDS)
        for place in self._places:
            kinds[self._names.columns[place]] = "float64"
            if place in self._texts:
                kinds[self._names.columns[place] + TEXT_SUFFIX] = NAME_TYPE
        return kinds

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """What is to be known of columns."""
        return {self._names.columns[place]: {UNIT: unit} for place in self._places if (unit := self._unit(place))}

    def columns(self, batch: FrameBatch, found: Sequence[MessageValues]) -> tuple[int, dict[str, Column]]:
        """Return the number of rows and the columns of one row group, in their order."""
        rows = np.concatenate([one.rows for one in found])
        order = np.argsort(rows, kind="stable")
        to_row = np.empty(len(rows), np.int64)
        to_row[order] = np.arange(len(rows))
        cells, slots = _Cells(len(rows)), Counter(one.slot for one in found)
        start = 0
        for one in found:
            target = to_row[start : start + len(one.rows)]
            start += len(one.rows)
            self._fill(cells, one, target, is_only=slots[one.slot] == 1)
        messages = [self._names.messages[one.slot] for one in found]
        columns = self._frame_columns(batch, rows[order])
        which = np.repeat(np.arange(len(found), dtype=np.int32), [len(one.rows) for one in found])[order]
        columns[MESSAGE] = coded(messages, which)
        for place in self._places:
            columns[self._names.columns[place]] = cells.numbers(place)
            if place in self._texts:
                columns[self._names.columns[place] + TEXT_SUFFIX] = cells.texts(place, self._texts[place].names)
        return len(rows), columns

    def _fill(self, cells: "_Cells", one: MessageValues, target: Int64Array, *, is_only: bool) -> None:
        """Fill in the values of some frames; ``is_only`` if no others of their message are in the row group."""
        bits = cells.bits_of(target)
        for name, decoded in one.signals.items():
            place = one.slot, name
            if place in self._texts:
                self._fill_named(cells, place, target, one, decoded)
            elif is_only and decoded.is_present is None:
                cells.put_all(place, target, decoded.value, bits)
            else:
                cells.put(place, target, decoded.value, decoded.is_present)

    def _fill_named(
        self, cells: "_Cells", place: Place, target: Int64Array, one: MessageValues, decoded: Decoded
    ) -> None:
        """Fill in the values of a signal with a value table, and their texts."""
        present, codes = decoded.is_present, self._texts[place].codes(one.words)
        if present is not None:
            codes = np.where(present, codes, np.int32(NAMELESS))
        cells.put_codes(place, target, codes)
        if self._values is Values.TEXTS:
            present = codes == NAMELESS if present is None else present & (codes == NAMELESS)
        cells.put(place, target, decoded.value, present)


class LongLayout(Layout):
    """A row per value."""

    @property
    def kinds(self) -> dict[str, str]:
        """Names and types of the columns."""
        text = {} if self._values is Values.NUMBERS else {TEXT: NAME_TYPE}
        return {**FRAME_KINDS, SIGNAL: NAME_TYPE, VALUE: "float64", **text, UNIT: NAME_TYPE}

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """What is to be known of columns."""
        return {}

    def columns(self, batch: FrameBatch, found: Sequence[MessageValues]) -> tuple[int, dict[str, Column]]:
        """Return the number of rows and the columns of one row group, in their order."""
        parts = [part for one in found for part in self._parts(one)]
        if not parts:
            return 0, {}
        rows = np.concatenate([part.rows for part in parts])
        order = np.argsort(rows, kind="stable")
        which = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.rows) for part in parts])[order]
        columns = self._frame_columns(batch, rows[order])
        columns[MESSAGE] = coded([part.message for part in parts], which)
        columns[SIGNAL] = coded([part.signal for part in parts], which)
        value = np.concatenate([part.value for part in parts])[order]
        if self._values is Values.NUMBERS:
            columns[VALUE] = value
        else:
            codes, names = _joined_texts(parts)
            is_named = codes[order] != NAMELESS
            hidden = is_named if self._values is Values.TEXTS else None
            columns[VALUE] = load_pyarrow().array(value, mask=hidden)
            columns[TEXT] = _dictionary(codes[order], names)
        columns[UNIT] = coded([part.unit for part in parts], which)
        return len(rows), columns

    def _parts(self, one: MessageValues) -> Iterator[_Part]:
        for name, decoded in one.signals.items():
            place = one.slot, name
            texts = self._texts.get(place)
            codes = None if texts is None else texts.codes(one.words)
            kept: BoolArray | slice = slice(None) if decoded.is_present is None else decoded.is_present
            yield _Part(
                self._names.messages[one.slot],
                name,
                self._unit(place),
                one.rows[kept],
                decoded.value[kept],
                None if codes is None else codes[kept],
                () if texts is None else texts.names,
            )


class _Cells:
    """Columns of a wide row group that are being filled; what nobody fills stays null."""

    def __init__(self, row_count: int) -> None:
        self._count = row_count
        self._value: dict[Place, FloatArray] = {}
        self._is_there: dict[Place, BoolArray] = {}
        self._bits: dict[Place, UInt8Array] = {}
        self._codes: dict[Place, Int32Array] = {}

    def put(self, place: Place, target: Int64Array, value: FloatArray, is_present: BoolArray | None) -> None:
        """Fill in some rows of a signal."""
        if place not in self._value:
            self._value[place] = np.zeros(self._count)
            self._is_there[place] = np.zeros(self._count, np.bool_)
        self._value[place][target] = value
        self._is_there[place][target] = True if is_present is None else is_present

    def put_all(self, place: Place, target: Int64Array, value: FloatArray, bits: UInt8Array) -> None:
        """Fill in a signal at once; ``bits`` of its rows serve all signals of a message."""
        self._value[place] = np.zeros(self._count)
        self._value[place][target] = value
        self._bits[place] = bits

    def bits_of(self, target: Int64Array) -> UInt8Array:
        """Return a bit per row, set in some of them."""
        is_there = np.zeros(self._count, np.bool_)
        is_there[target] = True
        return np.packbits(is_there, bitorder="little")

    def put_codes(self, place: Place, target: Int64Array, codes: Int32Array) -> None:
        """Fill in some rows of a signal's texts."""
        if place not in self._codes:
            self._codes[place] = np.full(self._count, NAMELESS, np.int32)
        self._codes[place][target] = codes

    def numbers(self, place: Place) -> Column:
        """Return the numbers of a signal; they are not copied."""
        arrow = load_pyarrow()
        if place not in self._value:
            return arrow.nulls(self._count, arrow.float64())
        bits = self._bits.get(place)
        if bits is None:
            bits = np.packbits(self._is_there[place], bitorder="little")
        buffers = [arrow.py_buffer(bits), arrow.py_buffer(self._value[place])]
        return arrow.Array.from_buffers(arrow.float64(), self._count, buffers)

    def texts(self, place: Place, names: Sequence[str]) -> Column:
        """Return the texts of a signal."""
        codes = self._codes.get(place)
        return _dictionary(np.full(self._count, NAMELESS, np.int32) if codes is None else codes, names)


def coded(names: Sequence[str], which: Int32Array) -> Column:
    """Return a text column as codes and their names; ``which`` of the names each row has."""
    known = {name: code for code, name in enumerate(dict.fromkeys(names))}
    codes = np.array([known[name] for name in names], np.int32)[which]
    arrow = load_pyarrow()
    indices = arrow.Array.from_buffers(arrow.int32(), len(codes), [None, arrow.py_buffer(codes)])
    return arrow.DictionaryArray.from_arrays(indices, arrow.array(list(known), arrow.string()))


def _joined_texts(parts: Sequence[_Part]) -> tuple[Int32Array, list[str]]:
    """Return the texts of all parts, one behind the other, as codes of one list of names."""
    known: dict[str, int] = {}
    pieces: list[Int32Array] = []
    for part in parts:
        if part.codes is None:
            pieces.append(np.full(len(part.rows), NAMELESS, np.int32))
            continue
        places = np.array([*(known.setdefault(name, len(known)) for name in part.names), NAMELESS], np.int32)
        pieces.append(places[part.codes])  # NAMELESS is the last place, too
    return np.concatenate(pieces), list(known)


def _dictionary(codes: Int32Array, names: Sequence[str]) -> Column:
    """Return codes and their names as a text column, null where a code is NAMELESS."""
    arrow = load_pyarrow()
    indices = arrow.array(codes, mask=codes == NAMELESS)
    return arrow.DictionaryArray.from_arrays(indices, arrow.array(list(names), arrow.string()))
