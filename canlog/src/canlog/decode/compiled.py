"""Plain signals decoded inside compiled loops: parts for kernels of others, and one for all of a message."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import BoolArray, FloatArray, Int64Array, UInt64Array
from canlog.decode.signals import WORD_BITS, WORD_BYTES, IntegerCode, SignalTable
from canlog.errors import DefinitionError
from canlog.jit import kernel, part

_ODD_BYTES: Final = np.uint64(0x00FF_00FF_00FF_00FF)
_ODD_PAIRS: Final = np.uint64(0x0000_FFFF_0000_FFFF)
SIGNAL: Final = np.dtype(
    [
        ("word", np.int64),  # which of the words
        ("left", np.uint64),  # shift that brings its highest bit to the top
        ("right", np.uint64),  # shift that then brings its lowest bit to the bottom
        ("sign", np.uint64),  # its highest bit, of signed numbers
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


def signal_rules(messages: Sequence[Sequence[SignalTable]]) -> SignalRules:
    """Return the rules of plain signals, message by message."""
    words: list[tuple[int, bool]] = []
    signals: list[tuple[float, ...]] = []
    codes: list[tuple[int, int]] = []
    begin, word_begin = [0], [0]
    for tables in messages:
        places = list(dict.fromkeys((table.field.first_byte, table.field.is_big) for table in tables))
        for table in tables:
            field, code = table.field, table.code
            if not isinstance(code, IntegerCode):
                raise DefinitionError("only integers are read by rules")
            word = places.index((field.first_byte, field.is_big))
            shifts = WORD_BITS - field.shift - field.length, WORD_BITS - field.length
            is_checked = code.raw_range != code.raw_limits or len(code.not_available) > 0
            code_rows = len(codes), len(codes) + len(code.not_available)
            sign = 1 << field.length - 1 if field.is_signed else 0
            signals.append((word, *shifts, sign, is_checked, *code.raw_range, *code_rows, code.scale, code.offset))
            codes += code.not_available
        words += places
        begin.append(len(signals))
        word_begin.append(len(words))
    return SignalRules(
        begin=np.array(begin, np.int64),
        word_begin=np.array(word_begin, np.int64),
        word=np.array(words, np.int64).reshape(-1, 2),
        signal=np.array(signals, SIGNAL),
        code=np.array(codes, np.int64).reshape(-1, 2),
    )


@part
def pick_word(payloads: UInt64Array, rows: Int64Array, start: Int64Array, word: UInt64Array) -> None:
    """Fill in the eight bytes of some payloads from a first one on, in one of the two orders."""
    column, is_big = start[0] // WORD_BYTES, start[1] != 0
    passed = np.uint64(8 * (start[0] % WORD_BYTES))  # bits of that column in front of the word
    width = payloads.shape[1]
    for at in range(rows.size):
        bits = payloads[rows[at], column] if column < width else np.uint64(0)
        if passed:
            following = payloads[rows[at], column + 1] if column + 1 < width else np.uint64(0)
            bits = bits >> passed | following << (np.uint64(WORD_BITS) - passed)
        word[at] = byteswapped(bits) if is_big else bits


@part
def byteswapped(word: np.uint64) -> np.uint64:
    """Return a word with its bytes in the other order."""
    word = (word & _ODD_BYTES) << np.uint64(8) | (word >> np.uint64(8)) & _ODD_BYTES
    word = (word & _ODD_PAIRS) << np.uint64(16) | (word >> np.uint64(16)) & _ODD_PAIRS
    return np.uint64(word << np.uint64(32) | word >> np.uint64(32))


@part
def decode_signal(
    word: UInt64Array, rules: SignalRules, row: int, value: FloatArray, good: BoolArray, bad_count: Int64Array
) -> None:
    """Decode one signal of many payloads.

    Where some raw values are no measurements, fill in which are, and how many are codes and how many out of range.
    """
    signal = rules.signal[row]
    left, right, sign, scale, offset = (
        signal["left"],
        signal["right"],
        signal["sign"],
        signal["scale"],
        signal["offset"],
    )
    for at in range(word.size):  # as signed numbers, which become floats faster: no plain signal has 64 bits
        raw = np.int64((word[at] << left) >> right ^ sign) - np.int64(sign)
        value[at] = np.float64(raw) * scale + offset
    if signal["is_checked"]:
        _check(word, signal, rules.code, good, bad_count)


@kernel
def decode_block(
    payloads: UInt64Array, rows: Int64Array, rules: SignalRules, word: UInt64Array, raw: Int64Array, value: FloatArray
) -> None:
    """Fill in the raw and the physical values of all m signals of one message.

    Parameters
    ----------
    payloads : (n, words) array
        Little-endian words.
    rows : (k,) array
        The payloads that are read.
    word : (k,) array
        Room for a word of each.
    raw, value : (m, k) array
        Are filled in.
    """
    for number in range(rules.word.shape[0]):
        pick_word(payloads, rows, rules.word[number], word)
        for place in range(rules.signal.size):
            signal = rules.signal[place]
            if signal["word"] != number:
                continue
            left, right, sign = signal["left"], signal["right"], signal["sign"]
            scale, offset = signal["scale"], signal["offset"]
            for at in range(rows.size):  # as signed numbers, which become floats faster
                code = np.int64((word[at] << left) >> right ^ sign) - np.int64(sign)
                raw[place, at] = code
                value[place, at] = np.float64(code) * scale + offset


@part
def _check(word: UInt64Array, signal: np.void, code: Int64Array, good: BoolArray, bad_count: Int64Array) -> None:
    """Fill in which raw values are measurements, and how many are codes and how many out of range."""
    left, right, sign, lowest, highest = (
        signal["left"],
        signal["right"],
        signal["sign"],
        signal["lowest"],
        signal["highest"],
    )
    codes = outside = 0
    for at in range(word.size):
        raw, is_code = np.int64((word[at] << left) >> right ^ sign) - np.int64(sign), False
        for place in range(signal["first_code"], signal["last_code"]):
            is_code |= code[place, 0] <= raw <= code[place, 1]
        is_inside = lowest <= raw <= highest
        good[at] = is_inside and not is_code
        codes += is_code
        outside += not (is_inside or is_code)
    bad_count[0], bad_count[1] = codes, outside
