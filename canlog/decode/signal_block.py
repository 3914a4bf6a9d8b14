"""All signals of one message decoded in one compiled pass; the values are those of each signal's own table."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.decode.bit_fields import WORD_BITS, PayloadWords, UInt64Array
from canlog.decode.signal_table import NO_INVALID, BoolArray, Decoded, InvalidCounts, Selector, SignalTable
from canlog.decode.value_codes import IntegerCode
from canlog.jit import array_kernel

NO_MASK: Final = np.ones((0, 0), np.bool_)


class _Field(IntEnum):
    """What a row of the table says about a signal."""

    WORD = 0  # which of the words
    LEFT = 1  # shift that brings its highest bit to the top
    RIGHT = 2  # shift that then brings its lowest bit to the bottom
    IS_SIGNED = 3
    IS_CHECKED = 4  # some raw values are no measurements
    LOWEST = 5
    HIGHEST = 6
    FIRST_CODE = 7  # of the ranges of raw values that are none
    LAST_CODE = 8


_WORD, _LEFT, _RIGHT = int(_Field.WORD), int(_Field.LEFT), int(_Field.RIGHT)
_IS_SIGNED, _IS_CHECKED = int(_Field.IS_SIGNED), int(_Field.IS_CHECKED)
_LOWEST, _HIGHEST = int(_Field.LOWEST), int(_Field.HIGHEST)
_FIRST_CODE, _LAST_CODE = int(_Field.FIRST_CODE), int(_Field.LAST_CODE)


class SignalBlock:
    """The signals of a message, compiled.

    Integers that a float holds go through one kernel; floats and wider integers keep to their own tables. Signals of
    one page of a multiplexer share the mask that says where they are.
    """

    def __init__(self, tables: Mapping[str, SignalTable]) -> None:
        plain = [(name, table, table.code) for name, table in tables.items() if isinstance(table.code, IntegerCode)]
        plain = [(name, table, code) for name, table, code in plain if code.is_exact_in_float and not table.field.spill]
        row_of = {name: row for row, (name, _, _) in enumerate(plain)}
        self._signals = [(name, row_of.get(name, -1), table) for name, table in tables.items()]  # -1: by itself
        self._words = list(dict.fromkeys((table.field.first_byte, table.field.is_big) for _, table, _ in plain))
        codes = [span for _, _, code in plain for span in code.not_available]
        self._codes = np.array(codes, np.int64).reshape(-1, 2)
        self._fields = np.zeros((len(plain), len(_Field)), np.int64)
        self._factors = np.array([(code.scale, code.offset) for _, _, code in plain], np.float64).reshape(-1, 2)
        known = 0
        for row, (_, table, code) in zip(self._fields, plain, strict=True):
            field, count = table.field, len(code.not_available)
            row[_WORD] = self._words.index((field.first_byte, field.is_big))
            row[_LEFT], row[_RIGHT] = WORD_BITS - field.shift - field.length, WORD_BITS - field.length
            row[_IS_SIGNED], row[_IS_CHECKED] = field.is_signed, code.raw_range != code.raw_limits or count > 0
            row[_LOWEST], row[_HIGHEST] = code.raw_range
            row[_FIRST_CODE], row[_LAST_CODE] = known, known + count
            known += count
        self._has_checks = bool(self._fields[:, _IS_CHECKED].any())

    def decode(self, words: PayloadWords) -> dict[str, Decoded]:
        """Return all signals in every payload."""
        value = np.empty((len(self._fields), len(words)))
        good = np.empty(value.shape, np.bool_) if self._has_checks else NO_MASK
        bad_count = np.zeros((len(self._fields), 2), np.int64)
        if len(self._fields):
            _decode_rows(words.words(self._words), self._fields, self._factors, self._codes, value, good, bad_count)
        values, bad_counts = list(value), bad_count.tolist()
        present: dict[tuple[Selector, ...], BoolArray] = {}
        found: dict[str, Decoded] = {}
        for name, row, table in self._signals:
            if row < 0:
                found[name] = table.decode(words)
                continue
            codes, outside = bad_counts[row]
            is_bad = codes or outside  # rarely: what is the same for all signals is made once
            invalid = InvalidCounts(codes, outside) if is_bad else NO_INVALID
            is_good = good[row] if is_bad else None
            if not table.selectors:
                found[name] = Decoded(values[row], is_good, invalid)
                continue
            if table.selectors not in present:
                present[table.selectors] = table.presence(words)
            if codes and outside:  # which of them are present, the table tells
                found[name] = table.decode(words)
            else:
                found[name] = _selected(values[row], present[table.selectors], is_good, invalid)
        return found


def _selected(value: FloatArray, present: BoolArray, is_good: BoolArray | None, invalid: InvalidCounts) -> Decoded:
    """Return a signal with the frames that do not carry it masked out; what is invalid, is so for one reason."""
    if is_good is None:
        return Decoded(value, present, NO_INVALID, present)
    good = present & is_good
    bad_count = int(np.count_nonzero(present) - np.count_nonzero(good))
    return Decoded(value, good, InvalidCounts(*(bad_count if count else 0 for count in invalid)), present)


@array_kernel
def _decode_rows(
    words: UInt64Array,
    fields: Int64Array,
    factors: FloatArray,
    codes: Int64Array,
    value: FloatArray,
    good: BoolArray,
    bad_count: Int64Array,
) -> None:
    """Decode the signals of a table: values of shape (signals, n), and where needed which of them are measurements."""
    for row in range(fields.shape[0]):
        field = fields[row]
        word = words[field[_WORD]]
        left, right = np.uint64(field[_LEFT]), np.uint64(field[_RIGHT])
        if field[_IS_SIGNED]:
            _signed_values(word, left, right, factors[row, 0], factors[row, 1], value[row])
        else:
            _unsigned_values(word, left, right, factors[row, 0], factors[row, 1], value[row])
        if field[_IS_CHECKED]:
            unusable = codes[field[_FIRST_CODE] : field[_LAST_CODE]]
            is_signed = field[_IS_SIGNED] != 0
            ends = field[_LOWEST], field[_HIGHEST]
            _check(word, left, right, is_signed, ends, unusable, good[row], bad_count[row])


@array_kernel
def _unsigned_values(
    word: UInt64Array, left: np.uint64, right: np.uint64, scale: float, offset: float, value: FloatArray
) -> None:
    for row in range(word.size):
        value[row] = np.float64((word[row] << left) >> right) * scale + offset


@array_kernel
def _signed_values(
    word: UInt64Array, left: np.uint64, right: np.uint64, scale: float, offset: float, value: FloatArray
) -> None:
    for row in range(word.size):
        value[row] = np.float64(np.int64(word[row] << left) >> np.int64(right)) * scale + offset


@array_kernel
def _check(
    word: UInt64Array,
    left: np.uint64,
    right: np.uint64,
    is_signed: bool,  # noqa: FBT001 - a compiled function
    ends: tuple[int, int],
    unusable: Int64Array,
    good: BoolArray,
    bad_count: Int64Array,
) -> None:
    """Fill in which raw values are measurements, and how many are codes and how many out of range."""
    lowest, highest = ends
    outside = 0
    for row in range(word.size):
        raw = np.int64(word[row] << left) >> np.int64(right) if is_signed else np.int64((word[row] << left) >> right)
        is_inside = lowest <= raw <= highest
        good[row] = is_inside
        outside += not is_inside
    codes = 0
    for place in range(unusable.shape[0]):
        for row in range(word.size):
            raw = (
                np.int64(word[row] << left) >> np.int64(right) if is_signed else np.int64((word[row] << left) >> right)
            )
            if unusable[place, 0] <= raw <= unusable[place, 1]:
                codes += 1
                outside -= not good[row]
                good[row] = False
    bad_count[0] = codes
    bad_count[1] = outside
