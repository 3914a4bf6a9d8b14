"""All signals of one message decoded in one compiled pass; the values are those of each signal's own table."""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.decode.bit_fields import WORD_BITS, PayloadWords, UInt64Array
from canlog.decode.signal_table import NO_INVALID, BoolArray, Decoded, InvalidCounts, Selector, SignalTable
from canlog.decode.value_codes import IntegerCode
from canlog.errors import DefinitionError
from canlog.jit import array_kernel, inlined_kernel


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


WORD: Final = int(_Field.WORD)
_LEFT, _RIGHT = int(_Field.LEFT), int(_Field.RIGHT)
_IS_SIGNED, _IS_CHECKED = int(_Field.IS_SIGNED), int(_Field.IS_CHECKED)
_LOWEST, _HIGHEST = int(_Field.LOWEST), int(_Field.HIGHEST)
_FIRST_CODE, _LAST_CODE = int(_Field.FIRST_CODE), int(_Field.LAST_CODE)


class SignalRules(NamedTuple):
    """How the plain signals of m messages are read, one row per signal in the order of the messages."""

    begin: Int64Array  # (m + 1,) where the signals of a message begin
    word_begin: Int64Array  # (m + 1,) where the words begin that they lie in
    word: Int64Array  # (w, 2) first byte of a word, and whether it is big-endian
    field: Int64Array  # (k, 9) what ``_Field`` names
    factor: FloatArray  # (k, 2) scale and offset
    code: Int64Array  # (c, 2) ranges of raw values that are no measurements


def is_plain(table: SignalTable) -> bool:
    """Return whether the compiled pass reads a signal: an integer that a float holds, in one word."""
    return isinstance(table.code, IntegerCode) and table.code.is_exact_in_float and not table.field.spill


def signal_rules(messages: Sequence[Sequence[SignalTable]]) -> SignalRules:
    """Return the rules of plain signals, message by message."""
    words: list[tuple[int, bool]] = []
    fields: list[dict[_Field, int]] = []
    factors: list[tuple[float, float]] = []
    codes: list[tuple[int, int]] = []
    begin, word_begin = [0], [0]
    for tables in messages:
        own = list(dict.fromkeys((table.field.first_byte, table.field.is_big) for table in tables))
        for table in tables:
            field, code = table.field, table.code
            if not isinstance(code, IntegerCode):
                raise DefinitionError("only integers are read by rules")
            row = {
                _Field.WORD: own.index((field.first_byte, field.is_big)),
                _Field.LEFT: WORD_BITS - field.shift - field.length,
                _Field.RIGHT: WORD_BITS - field.length,
                _Field.IS_SIGNED: field.is_signed,
                _Field.IS_CHECKED: code.raw_range != code.raw_limits or len(code.not_available) > 0,
                _Field.LOWEST: code.raw_range[0],
                _Field.HIGHEST: code.raw_range[1],
                _Field.FIRST_CODE: len(codes),
                _Field.LAST_CODE: len(codes) + len(code.not_available),
            }
            fields.append(row)
            factors.append((code.scale, code.offset))
            codes += code.not_available
        words += own
        begin.append(len(fields))
        word_begin.append(len(words))
    return SignalRules(
        begin=np.array(begin, np.int64),
        word_begin=np.array(word_begin, np.int64),
        word=np.array(words, np.int64).reshape(-1, 2),
        field=np.array([[row[name] for name in _Field] for row in fields], np.int64).reshape(-1, len(_Field)),
        factor=np.array(factors, np.float64).reshape(-1, 2),
        code=np.array(codes, np.int64).reshape(-1, 2),
    )


class SignalBlock:
    """The signals of a message, compiled.

    Plain signals go through one kernel; floats and wider integers keep to their own tables. Signals of one page of a
    multiplexer share the mask that says where they are.
    """

    def __init__(self, tables: Mapping[str, SignalTable]) -> None:
        plain = {name: table for name, table in tables.items() if is_plain(table)}
        row_of = {name: row for row, name in enumerate(plain)}
        self._signals = [(name, row_of.get(name, -1), table) for name, table in tables.items()]  # -1: by itself
        self._rules = signal_rules([list(plain.values())])
        self._has_checks = bool(self._rules.field[:, _IS_CHECKED].any())

    def decode(self, words: PayloadWords) -> dict[str, Decoded]:
        """Return all signals in every payload."""
        value = np.empty((len(self._rules.field), len(words)))
        good = np.empty((len(value), len(words) if self._has_checks else 0), np.bool_)
        bad_count = np.zeros((len(value), 2), np.int64)
        if len(value):
            _decode_rows(words.words(self._rules.word), self._rules, value, good, bad_count)
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
    words: UInt64Array, rules: SignalRules, value: FloatArray, good: BoolArray, bad_count: Int64Array
) -> None:
    """Decode the signals of one message: values of shape (signals, n), and where needed which are measurements."""
    for row in range(rules.field.shape[0]):
        decode_signal(words[rules.field[row, WORD]], rules, row, value[row], good[row], bad_count[row])


@inlined_kernel
def decode_signal(
    word: UInt64Array, rules: SignalRules, row: int, value: FloatArray, good: BoolArray, bad_count: Int64Array
) -> None:
    """Decode one signal of many payloads.

    Where some raw values are no measurements, fill in which are, and how many are codes and how many out of range.
    """
    field = rules.field[row]
    left, right = np.uint64(field[_LEFT]), np.uint64(field[_RIGHT])
    scale, offset = rules.factor[row, 0], rules.factor[row, 1]
    if field[_IS_SIGNED]:
        for at in range(word.size):
            value[at] = np.float64(np.int64(word[at] << left) >> np.int64(right)) * scale + offset
    else:
        for at in range(word.size):  # as signed numbers, which become floats faster: no plain signal has 64 bits
            value[at] = np.float64(np.int64((word[at] << left) >> right)) * scale + offset
    if field[_IS_CHECKED]:
        unusable = rules.code[field[_FIRST_CODE] : field[_LAST_CODE]]
        is_signed = field[_IS_SIGNED] != 0
        _check(word, left, right, is_signed, (field[_LOWEST], field[_HIGHEST]), unusable, good, bad_count)


@inlined_kernel
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
