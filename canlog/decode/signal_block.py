"""All signals of one message decoded in one compiled pass; the values are those of each signal's own table."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.decode.bit_fields import WORD_BITS, PayloadWords, UInt64Array
from canlog.decode.signal_table import NO_INVALID, Decoded, InvalidCounts, Selector, SignalTable
from canlog.decode.value_codes import IntegerCode
from canlog.errors import DefinitionError
from canlog.jit import array_kernel, inlined_kernel

SIGNAL: Final = np.dtype(
    [
        ("word", np.int64),  # which of the words
        ("left", np.uint64),  # shift that brings its highest bit to the top
        ("right", np.uint64),  # shift that then brings its lowest bit to the bottom
        ("is_signed", np.int64),
        ("is_checked", np.int64),  # some raw values are no measurements
        ("lowest", np.int64),
        ("highest", np.int64),
        ("first_code", np.int64),  # of the ranges of raw values that are none
        ("last_code", np.int64),
        ("scale", np.float64),
        ("offset", np.float64),
    ]
)
SignalArray = npt.NDArray[np.void]  # of SIGNAL


class SignalRules(NamedTuple):
    """How the plain signals of m messages are read, one row per signal in the order of the messages."""

    begin: Int64Array  # (m + 1,) where the signals of a message begin
    word_begin: Int64Array  # (m + 1,) where the words begin that they lie in
    word: Int64Array  # (w, 2) first byte of a word, and whether it is big-endian
    signal: SignalArray  # (k,)
    code: Int64Array  # (c, 2) ranges of raw values that are no measurements


def is_plain(table: SignalTable) -> bool:
    """Return whether the compiled pass reads a signal: an integer that a float holds, in one word."""
    return isinstance(table.code, IntegerCode) and table.code.is_exact_in_float and not table.field.spill


def signal_rules(messages: Sequence[Sequence[SignalTable]]) -> SignalRules:
    """Return the rules of plain signals, message by message."""
    words: list[tuple[int, bool]] = []
    signals: list[tuple[float, ...]] = []
    codes: list[tuple[int, int]] = []
    begin, word_begin = [0], [0]
    for tables in messages:
        own = list(dict.fromkeys((table.field.first_byte, table.field.is_big) for table in tables))
        for table in tables:
            field, code = table.field, table.code
            if not isinstance(code, IntegerCode):
                raise DefinitionError("only integers are read by rules")
            word = own.index((field.first_byte, field.is_big))
            shifts = WORD_BITS - field.shift - field.length, WORD_BITS - field.length
            is_checked = code.raw_range != code.raw_limits or len(code.not_available) > 0
            places = len(codes), len(codes) + len(code.not_available)
            signals.append(
                (word, *shifts, field.is_signed, is_checked, *code.raw_range, *places, code.scale, code.offset)
            )
            codes += code.not_available
        words += own
        begin.append(len(signals))
        word_begin.append(len(words))
    return SignalRules(
        begin=np.array(begin, np.int64),
        word_begin=np.array(word_begin, np.int64),
        word=np.array(words, np.int64).reshape(-1, 2),
        signal=np.array(signals, SIGNAL),
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
        self._has_checks = bool(self._rules.signal["is_checked"].any())

    def decode(self, words: PayloadWords) -> dict[str, Decoded]:
        value = np.empty((len(self._rules.signal), len(words)))
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
    for row in range(rules.signal.size):
        decode_signal(words[rules.signal[row]["word"]], rules, row, value[row], good[row], bad_count[row])


@inlined_kernel
def decode_signal(
    word: UInt64Array, rules: SignalRules, row: int, value: FloatArray, good: BoolArray, bad_count: Int64Array
) -> None:
    """Decode one signal of many payloads.

    Where some raw values are no measurements, fill in which are, and how many are codes and how many out of range.
    """
    signal = rules.signal[row]
    left, right, scale, offset = signal["left"], signal["right"], signal["scale"], signal["offset"]
    if signal["is_signed"]:
        for at in range(word.size):
            value[at] = np.float64(np.int64(word[at] << left) >> np.int64(right)) * scale + offset
    else:
        for at in range(word.size):  # as signed numbers, which become floats faster: no plain signal has 64 bits
            value[at] = np.float64(np.int64((word[at] << left) >> right)) * scale + offset
    if signal["is_checked"]:
        unusable = rules.code[signal["first_code"] : signal["last_code"]]
        _check(word, signal, unusable, good, bad_count)


@inlined_kernel
def _check(word: UInt64Array, signal: np.void, unusable: Int64Array, good: BoolArray, bad_count: Int64Array) -> None:
    """Fill in which raw values are measurements, and how many are codes and how many out of range."""
    left, right, is_signed = signal["left"], signal["right"], signal["is_signed"] != 0
    lowest, highest = signal["lowest"], signal["highest"]
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
