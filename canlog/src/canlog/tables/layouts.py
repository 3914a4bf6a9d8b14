"""Decoded frames as the columns of a table: a row per frame, a column per signal.

Nothing is null that a frame carries: null are signals of other messages, of other pages of a multiplexer, and what lies
behind the end of a short frame. Columns are called ``Message.Signal``, with the identifier where that does not tell two
signals apart.
"""

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import BoolArray, FloatArray, Int64Array, UInt32Array
from canlog.column_files import BOOL_TYPE, FLOAT_TYPE, NAME_TYPE, TIME_TYPE, load_pyarrow
from canlog.decode.codec import MessageTable, MessageValues
from canlog.decode.signals import FloatCode, PayloadWords, SignalTable
from canlog.frames import EXTENDED_FLAG, FrameBatch
from canlog.tables.frame_groups import LOG_SHIFT

TEXT_SUFFIX: Final = ".text"  # of the column that names the states beside the numbers
BARE_ID: Final = 0x1FFF_FFFF
Place = tuple[int, str]  # slot of a message in its codec, and its signal


@dataclass(frozen=True, slots=True, kw_only=True)
class TableNames:
    """How messages and signals are called in a table; it depends on the database alone, not on the log."""

    messages: tuple[str, ...]  # by slot
    columns: Mapping[Place, str]

    def of_message(self, slot: int, taken: Iterable[str]) -> "TableNames":
        """Return the names in a table of one message alone: those of its signals, unless they are ``taken``."""
        used = set(taken)
        columns: dict[Place, str] = {}
        for place in (place for place in self.columns if place[0] == slot):
            columns[place] = _unused(place[1], used)
            used |= {columns[place], columns[place] + TEXT_SUFFIX}
        return TableNames(messages=self.messages, columns=columns)


def flagged_id(message: Message) -> int:
    """Return the identifier of a message as its frames have it, with the flag of 29 bits."""
    return int(message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0))


def identifier_text(can_id: int) -> str:
    """Return an identifier with its flags in hexadecimal: eight digits if it has 29 bits, three if it has 11."""
    return f"0x{can_id & BARE_ID:08X}" if can_id & EXTENDED_FLAG else f"0x{can_id & BARE_ID:03X}"


def table_names(tables: Sequence[MessageTable]) -> TableNames:
    """Return names of which no two are alike.

    Messages of one name are called ``Name@0x123``. Dots in names can still make two columns alike: then their messages
    get the identifier, too, and should even that not help, the later column a number.
    """
    count = Counter(table.message.name for table in tables)
    messages = [
        _with_identifier(table.message) if count[table.message.name] > 1 else table.message.name for table in tables
    ]
    wanted = {(slot, name): f"{messages[slot]}.{name}" for slot, table in enumerate(tables) for name in table.signals}
    uses = Counter(name for column in wanted.values() for name in (column, column + TEXT_SUFFIX))
    columns: dict[Place, str] = {}
    used: set[str] = set()
    for (slot, signal), column in wanted.items():
        is_ambiguous = uses[column] > 1 or uses[column + TEXT_SUFFIX] > 1
        name = f"{_with_identifier(tables[slot].message)}.{signal}" if is_ambiguous else column
        if name in used or name + TEXT_SUFFIX in used:
            name = _unused(name, used)
        columns[slot, signal] = name
        used |= {name, name + TEXT_SUFFIX}
    distinct: dict[str, None] = {}
    for name in messages:
        is_taken = name in distinct or name + TEXT_SUFFIX in distinct
        distinct[_unused(name, distinct.keys()) if is_taken else name] = None
    return TableNames(messages=tuple(distinct), columns=columns)


def _with_identifier(message: Message) -> str:
    return f"{message.name}@{identifier_text(flagged_id(message))}"


def _unused(name: str, used: Container[str]) -> str:
    """Return a name, with a number if it or its text column is taken."""
    unused, number = name, 1
    while unused in used or unused + TEXT_SUFFIX in used:
        number += 1
        unused = f"{name}#{number}"
    return unused


Int32Array = npt.NDArray[np.int32]
NAMELESS = -1


class ValueTexts:
    """The value table of one signal, compiled: a code for each value, and the names that codes stand for."""

    def __init__(self, signal: Signal, table: SignalTable) -> None:
        low, high = table.field.raw_limits
        choices = {raw: str(text) for raw, text in (signal.choices or {}).items()}
        self._table = table
        self._raws = sorted(raw for raw in choices if isinstance(table.code, FloatCode) or low <= raw <= high)
        self.names = tuple(dict.fromkeys(choices[raw] for raw in self._raws))
        self._codes = np.array([self.names.index(choices[raw]) for raw in self._raws], np.int32)

    def codes(self, words: PayloadWords) -> Int32Array:
        """Return for every payload the place of its text in ``names``, NAMELESS where the value has none."""
        raw = self._table.field.raw(words)
        if not self._raws:
            return np.full(len(raw), NAMELESS, np.int32)
        code = self._table.code
        number = code.raw_number(raw.view(np.uint64)) if isinstance(code, FloatCode) else raw
        known = np.array(self._raws, number.dtype)
        place = np.minimum(np.searchsorted(known, number), len(known) - 1)
        return np.where(known[place] == number, self._codes[place], np.int32(NAMELESS))


LOG, TIME, CHANNEL, ID, IS_EXTENDED = "log", "time", "channel", "id", "is_extended"
MESSAGE, UNIT = "message", "unit"
FRAME_KINDS: Final = {TIME: TIME_TYPE, CHANNEL: "int64", ID: "int32", IS_EXTENDED: BOOL_TYPE, MESSAGE: NAME_TYPE}
TableShapeName = Literal["wide", "messages"]
ValuesName = Literal["numbers", "texts", "both"]
Column = Any  # of pyarrow, which is untyped


class Values(StrEnum):
    """What is written for a value that has a name in the database."""

    NUMBERS = "numbers"  # the number
    TEXTS = "texts"  # the name
    BOTH = "both"


def frame_kinds(logs: Sequence[str]) -> dict[str, str]:
    """Return names and types of the columns that say what is known of frames besides their signals."""
    return {LOG: NAME_TYPE, **FRAME_KINDS} if logs else FRAME_KINDS


class WideLayout:
    """A row per frame, and a column per signal of the messages in ``slots``."""

    def __init__(
        self,
        tables: Sequence[MessageTable],
        names: TableNames,
        values: Values,
        slots: Sequence[int],
        logs: Sequence[str] = (),
        *,
        is_measured: bool = False,
    ) -> None:
        self._tables = tables
        self._is_measured = is_measured  # values that are no measurement are null, too
        self.names = names
        self.values = values
        self._logs = logs  # the names of several logs
        self.frame_kinds = frame_kinds(logs)
        self._places = [(slot, name) for slot in slots for name in tables[slot].signals]
        self.texts: dict[Place, ValueTexts] = {}
        if values is not Values.NUMBERS:
            self.texts = {
                (slot, name): ValueTexts(tables[slot].definitions[name], compiled)
                for slot in slots
                for name, compiled in tables[slot].signals.items()
                if tables[slot].definitions[name].choices
            }

    def _frame_columns(self, batch: FrameBatch, rows: Int64Array) -> dict[str, Column]:
        """Return what is known of frames besides their signals."""
        arrow = import_module("pyarrow")
        can_id: UInt32Array = batch.can_id[rows]
        channel: Int64Array = batch.channel[rows].astype(np.int64)
        log: dict[str, Column] = {}
        if self._logs:
            log = {LOG: _name_column(self._logs, (channel >> LOG_SHIFT).astype(np.int32))}
        return {
            **log,
            TIME: column_of(batch.t_ns[rows], kind=arrow.timestamp("ns", "UTC")),
            CHANNEL: column_of(channel & 0xFF),
            ID: column_of((can_id & np.uint32(BARE_ID)).astype(np.int32)),
            IS_EXTENDED: column_of((can_id & np.uint32(EXTENDED_FLAG)) != 0),
        }

    @property
    def kinds(self) -> dict[str, str]:
        kinds = dict(self.frame_kinds)
        for place in self._places:
            kinds[self.names.columns[place]] = FLOAT_TYPE
            if place in self.texts:
                kinds[self.names.columns[place] + TEXT_SUFFIX] = NAME_TYPE
        return kinds

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        units = ((place, self._tables[place[0]].definitions[place[1]].unit) for place in self._places)
        return {self.names.columns[place]: {UNIT: unit} for place, unit in units if unit}

    def columns(self, batch: FrameBatch, messages: Sequence[MessageValues]) -> tuple[int, dict[str, Column]]:
        """Return the number of rows and the columns of one row group, in their order."""
        frames = np.concatenate([message.rows for message in messages])
        number = np.repeat(np.arange(len(messages), dtype=np.int32), [len(message.rows) for message in messages])
        order = np.argsort(frames, kind="stable")
        row_of = np.empty(len(batch), np.int64)
        row_of[frames[order]] = np.arange(len(frames))
        cells = _Cells(len(frames))
        for message in messages:
            self._fill(cells, message, row_of[message.rows])
        columns = self._frame_columns(batch, frames[order])
        columns[MESSAGE] = _name_column([self.names.messages[message.slot] for message in messages], number[order])
        numbers = cells.numbers(self._places)
        for place in self._places:
            columns[self.names.columns[place]] = numbers[place]
            if place in self.texts:
                columns[self.names.columns[place] + TEXT_SUFFIX] = cells.texts(place, self.texts[place].names)
        return len(frames), columns

    def _fill(self, cells: "_Cells", message: MessageValues, rows: Int64Array) -> None:
        """Fill in the values of some frames of one message, and the texts of those that have any."""
        for name, decoded in message.signals.items():
            place, is_there = (message.slot, name), decoded.is_present
            if place in self.texts:
                codes = self.texts[place].codes(message.words)
                if is_there is not None:
                    codes = np.where(is_there, codes, np.int32(NAMELESS))
                cells.put_codes(place, rows, codes)
                if self.values is Values.TEXTS:
                    is_there = codes == NAMELESS if is_there is None else is_there & (codes == NAMELESS)
            if self._is_measured and decoded.is_good is not None:
                is_there = decoded.is_good if is_there is None else is_there & decoded.is_good
            cells.put(place, rows, decoded.value, is_there)


class _Cells:
    """Columns of a wide row group that are being filled; cells that are not filled stay null."""

    def __init__(self, row_count: int) -> None:
        self._count = row_count
        self._value: dict[Place, FloatArray] = {}
        self._is_there: dict[Place, BoolArray] = {}
        self._codes: dict[Place, Int32Array] = {}

    def put(self, place: Place, rows: Int64Array, value: FloatArray, is_there: BoolArray | None) -> None:
        """Fill in some rows of a signal; ``is_there`` marks those that carry it, None: all do."""
        if place not in self._value:
            self._value[place] = np.zeros(self._count)
            self._is_there[place] = np.zeros(self._count, np.bool_)
        self._value[place][rows] = value
        self._is_there[place][rows] = True if is_there is None else is_there

    def put_codes(self, place: Place, rows: Int64Array, codes: Int32Array) -> None:
        """Fill in some rows of a signal's texts."""
        self._codes.setdefault(place, np.full(self._count, NAMELESS, np.int32))[rows] = codes

    def numbers(self, places: Sequence[Place]) -> dict[Place, Column]:
        """Return the numbers of signals; they are not copied, and the bits of what is there are packed fast."""
        arrow = load_pyarrow()
        columns: dict[Place, Column] = {}
        for place in places:
            value = self._value.get(place)
            if value is None:
                columns[place] = arrow.nulls(self._count, FLOAT_TYPE)
                continue
            bits = arrow.py_buffer(np.packbits(self._is_there[place], bitorder="little"))
            columns[place] = arrow.Array.from_buffers(arrow.float64(), len(value), [bits, arrow.py_buffer(value)])
        return columns

    def texts(self, place: Place, names: Sequence[str]) -> Column:
        return _name_column(names, self._codes.get(place, np.full(self._count, NAMELESS, np.int32)))


def _name_column(names: Sequence[str], which: Int32Array) -> Column:
    """Return a text column as codes and their names; ``which`` of the names each row has, null where NAMELESS."""
    arrow = load_pyarrow()
    known = {name: code for code, name in enumerate(dict.fromkeys(names))}
    codes = np.array([*(known[name] for name in names), NAMELESS], np.int32)[which]  # NAMELESS is the last place, too
    indices = column_of(np.maximum(codes, 0), codes != NAMELESS)  # readers check the codes of what is null as well
    texts = [name.encode() for name in known]
    ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
    dictionary = arrow.StringArray.from_buffers(len(texts), arrow.py_buffer(ends), arrow.py_buffer(b"".join(texts)))
    return arrow.DictionaryArray.from_arrays(indices, dictionary)


def column_of(values: npt.NDArray[Any], is_there: BoolArray | None = None, kind: Any = None) -> Column:  # noqa: ANN401 - a type of pyarrow
    """Return values as a column, null where they are not there; they are not copied, and their bits are packed fast.

    pyarrow's own way takes longer, and loads pandas where it is installed.
    """
    arrow = import_module("pyarrow")  # loaded by `load_pyarrow` before
    packed = np.packbits(values, bitorder="little") if values.dtype == np.bool_ else values
    bits = None if is_there is None else arrow.py_buffer(np.packbits(is_there, bitorder="little"))
    return arrow.Array.from_buffers(
        kind or arrow.from_numpy_dtype(values.dtype), len(values), [bits, arrow.py_buffer(packed)]
    )
