"""Signals as their different values and which of them each frame has: what is repeated is decoded once."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cantools.database.can.signal import Signal

from canlog.arrays import FloatArray, Int64Array
from canlog.decode.bit_fields import PayloadWords, UInt64Array
from canlog.decode.signal_table import SignalTable
from canlog.decode.value_codes import FloatCode
from canlog.parquet.codes import Packer

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
        return self.codes_of(self._table.field.raw(words))

    def codes_of(self, raw: UInt64Array | Int64Array) -> Int32Array:
        """Return the same of raw values."""
        if not self._raws:
            return np.full(len(raw), NAMELESS, np.int32)
        code = self._table.code
        number = code.raw_number(raw.view(np.uint64)) if isinstance(code, FloatCode) else raw
        known = np.array(self._raws, number.dtype)
        place = np.minimum(np.searchsorted(known, number), len(known) - 1)
        return np.where(known[place] == number, self._codes[place], np.int32(NAMELESS))


@dataclass(frozen=True, slots=True)
class CodedSignal:
    """A signal in some frames: its different values, which of them each frame has, and how many are odd."""

    values: FloatArray  # (d,)
    index: Int32Array  # (n,) until the next signal is coded
    texts: Int32Array | None  # (d,) codes of ``ValueTexts``; None: without a value table
    out_of_range: int
    not_a_number: int


def coded_signal(
    table: SignalTable, words: PayloadWords, packer: Packer, texts: ValueTexts | None = None
) -> CodedSignal:
    """Return a signal in all of some payloads, as ``SignalTable.decode`` would."""
    raw = table.field.raw(words)
    numbered = packer.numbered(raw.view(np.int64), 1 << table.field.length)
    distinct: UInt64Array | Int64Array = numbered.distinct
    if raw.dtype != np.int64:
        distinct = numbered.distinct.view(np.uint64)
    code = table.code
    if isinstance(code, FloatCode):
        values = code.value(distinct.view(np.uint64))
        is_odd = ~np.isfinite(values)
        is_outside = code.is_outside(values) & ~is_odd
        not_a_number = _count(is_odd, numbered.index)
        out_of_range = _count(is_outside, numbered.index)
    else:
        values, not_a_number = code.value(distinct), 0
        outside = code.is_outside(distinct)
        out_of_range = 0 if outside is None else _count(outside, numbered.index)
    codes = None if texts is None else texts.codes_of(distinct)
    return CodedSignal(values, numbered.index, codes, out_of_range, not_a_number)


def _count(is_meant: npt.NDArray[np.bool_], index: Int32Array) -> int:
    """Return how many rows have one of the values that are meant."""
    return int(np.count_nonzero(is_meant[index])) if is_meant.any() else 0
