"""Columns as numbers of their different values, packed; the room that this takes is kept from column to column."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.parquet.compact import varint
from canlog.parquet.packing import (
    DELTA_BLOCK,
    GROUP,
    Int32Array,
    index_keys,
    pack_differences,
    pack_presence,
    pack_runs,
)

_HEAD_BYTES: Final = 12  # of a run or of a stretch of packed bits, at most, with its value
_BLOCK_BYTES: Final = 16  # of a block of differences, besides these
_LEAST_PLACES: Final = 64


@dataclass(frozen=True, slots=True)
class Numbered:
    """The different values of a column in the order in which they come, and which of them each row has."""

    distinct: Int64Array  # (d,)
    index: Int32Array  # (n,) until the next column is numbered


@dataclass(slots=True)
class Packer:
    """Packs one column after the other; results are copies unless they say otherwise."""

    _table: Int32Array = field(default_factory=lambda: np.empty(0, np.int32))
    _distinct: Int64Array = field(default_factory=lambda: np.empty(0, np.int64))
    _index: Int32Array = field(default_factory=lambda: np.empty(0, np.int32))
    _out: UInt8Array = field(default_factory=lambda: np.empty(0, np.uint8))
    _held: Int64Array = field(default_factory=lambda: np.empty(DELTA_BLOCK, np.int64))

    def numbered(self, key: Int64Array, most_distinct: int | None = None) -> Numbered:
        """Return the different values of a column, of which there are at most ``most_distinct``, if that is known."""
        count = len(key)
        most = count if most_distinct is None else min(count, most_distinct)
        places = max(_LEAST_PLACES, 1 << (2 * most).bit_length())
        if len(self._table) < places:
            self._table = np.empty(places, np.int32)
        if len(self._index) < count:
            self._distinct, self._index = np.empty(count, np.int64), np.empty(count, np.int32)
        found = index_keys(key, self._table[:places], self._distinct, self._index[:count])
        return Numbered(self._distinct[:found].copy(), self._index[:count])

    def runs(self, index: Int32Array, value_count: int) -> bytes:
        """Return which of some values each row has, as a page of Parquet has it: a width, then runs and packed bits."""
        width = bits_for(value_count)
        if value_count == 1:
            return bytes([width]) + _run(len(index), 0)
        out = self._room((len(index) + GROUP) * width // 8 + (len(index) // GROUP + 2) * _HEAD_BYTES)
        out[0] = width
        return out[: 1 + pack_runs(index, width, out[1:])].tobytes()

    def differences(self, value: Int64Array) -> bytes:
        """Return whole numbers that differ little from each other."""
        out = self._room(9 * len(value) + (len(value) // DELTA_BLOCK + 4) * (9 * DELTA_BLOCK // 4 + _BLOCK_BYTES))
        return out[: pack_differences(value, self._held, out)].tobytes()

    def presence(self, rows: Int64Array, count: int) -> bytes:
        """Return which of ``count`` rows have a value."""
        out = self._room((len(rows) + 2) * 2 * _HEAD_BYTES + count // GROUP)
        return out[: pack_presence(rows, count, out)].tobytes()

    def everywhere(self, count: int) -> bytes:
        """Return that all of ``count`` rows have a value."""
        return _run(count, 1)

    def _room(self, size: int) -> UInt8Array:
        if len(self._out) < size:
            self._out = np.empty(size, np.uint8)
        return self._out


def _run(length: int, value: int) -> bytes:
    """Return a run of a value of up to eight bits."""
    return varint(length << 1) + bytes([value])


def bits_for(value_count: int) -> int:
    """Return how many bits number so many values; at least one, as readers expect."""
    return max(1, (value_count - 1).bit_length())
