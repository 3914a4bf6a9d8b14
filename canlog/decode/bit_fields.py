"""Where a signal lies in a payload, and how one array operation reads it out of all payloads.

A payload is read as 64-bit words that begin at any byte, in either byte order; a signal is a shift and a mask of one of
them. Only a signal of more than 56 bits that lies across nine bytes needs a byte besides.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import Int64Array, UInt8Array
from canlog.errors import DefinitionError
from canlog.frames import FD_PAYLOAD_BYTES
from canlog.jit import array_kernel, inlined_kernel

UInt64Array = npt.NDArray[np.uint64]

WORD_BYTES: Final = 8
WORD_BITS: Final = 64
LITTLE_WORD: Final = np.dtype(np.uint64)  # of the machines that numba compiles for
_ODD_BYTES: Final = np.uint64(0x00FF_00FF_00FF_00FF)
_ODD_PAIRS: Final = np.uint64(0x0000_FFFF_0000_FFFF)


class PayloadWords:
    """Some rows of payloads, or all, as 64-bit words; bytes past the end of the rows are zeros."""

    def __init__(self, data: UInt8Array, rows: Int64Array | None = None) -> None:
        self._payloads = word_view(data)
        self._rows = np.arange(len(data)) if rows is None else rows
        self._words: dict[tuple[int, bool], UInt64Array] = {}  # those of multiplexers serve many signals

    def __len__(self) -> int:
        return len(self._rows)

    def word(self, first_byte: int, *, is_big: bool) -> UInt64Array:
        """Return the eight bytes from ``first_byte`` on, the first of them highest if ``is_big``, shape (n,)."""
        key = first_byte, is_big
        if key not in self._words:
            self._words[key] = self.words(np.array([key], np.int64))[0]
        return self._words[key]

    def words(self, places: Int64Array) -> UInt64Array:
        """Return several words by their first bytes and whether they are big-endian, shape (words, n)."""
        found = np.empty((len(places), len(self)), np.uint64)
        pick_words(self._payloads, self._rows, places, found)
        return found


def word_view(data: UInt8Array) -> UInt64Array:
    """Return payloads as little-endian words, shape (n, words), zeros behind their last byte."""
    missing = -data.shape[1] % WORD_BYTES
    whole = np.pad(data, ((0, 0), (0, missing))) if missing else np.ascontiguousarray(data)
    words: UInt64Array = whole.view(LITTLE_WORD)
    return words if words.flags.aligned else words.copy()


@array_kernel
def pick_words(payloads: UInt64Array, rows: Int64Array, places: Int64Array, words: UInt64Array) -> None:
    """Fill in words of some payloads, shape (words, rows): by their first bytes and whether they are big-endian."""
    for number in range(places.shape[0]):
        pick_word(payloads, rows, places[number, 0], places[number, 1] != 0, words[number])


@array_kernel
def pick_word(
    payloads: UInt64Array,
    rows: Int64Array,
    first_byte: int,
    is_big: bool,  # noqa: FBT001 - a compiled function
    word: UInt64Array,
) -> None:
    """Fill in the eight bytes from ``first_byte`` on of some payloads."""
    column = first_byte // WORD_BYTES
    passed = np.uint64(8 * (first_byte % WORD_BYTES))  # bits of that column in front of the word
    width = payloads.shape[1]
    for at in range(rows.size):
        bits = payloads[rows[at], column] if column < width else np.uint64(0)
        if passed:
            following = payloads[rows[at], column + 1] if column + 1 < width else np.uint64(0)
            bits = bits >> passed | following << (np.uint64(WORD_BITS) - passed)
        word[at] = byteswapped(bits) if is_big else bits


@inlined_kernel
def byteswapped(word: np.uint64) -> np.uint64:
    """Return a word with its bytes in the other order."""
    word = (word & _ODD_BYTES) << np.uint64(8) | (word >> np.uint64(8)) & _ODD_BYTES
    word = (word & _ODD_PAIRS) << np.uint64(16) | (word >> np.uint64(16)) & _ODD_PAIRS
    return np.uint64(word << np.uint64(32) | word >> np.uint64(32))


@dataclass(frozen=True, slots=True)
class BitField:
    """A signal in the word of its byte order that begins at ``first_byte``."""

    is_big: bool
    first_byte: int
    shift: int
    length: int
    is_signed: bool
    spill: int = 0  # bits by which the signal reaches into a ninth byte's side of the word; 0: it does not

    def raw(self, words: PayloadWords) -> UInt64Array | Int64Array:
        """Return the raw values, shape (n,)."""
        word = words.word(self.first_byte, is_big=self.is_big)
        if self.spill:
            word = self._with_ninth_byte(word, words.word(self.first_byte + WORD_BYTES, is_big=False))
        if self.is_signed:
            left = word << np.uint64(WORD_BITS - self.shift - self.length)
            return left.view(np.int64) >> np.int64(WORD_BITS - self.length)
        return (word >> np.uint64(self.shift)) & np.uint64(2**self.length - 1)

    @property
    def raw_limits(self) -> tuple[int, int]:
        """Smallest and largest raw value."""
        if self.is_signed:
            return -(2 ** (self.length - 1)), 2 ** (self.length - 1) - 1
        return 0, 2**self.length - 1

    @property
    def last_byte(self) -> int:
        """Place of the last byte that the signal lies in."""
        if self.spill:
            return self.first_byte + WORD_BYTES
        in_word = WORD_BITS - 1 - self.shift if self.is_big else self.shift + self.length - 1
        return self.first_byte + in_word // 8

    def _with_ninth_byte(self, word: UInt64Array, following: UInt64Array) -> UInt64Array:
        """Return the word moved by ``spill`` bits, so that the whole signal is in it."""
        ninth = following & np.uint64(0xFF)
        if self.is_big:
            return (word << np.uint64(self.spill)) | (ninth >> np.uint64(8 - self.spill))
        return (word >> np.uint64(self.spill)) | (ninth << np.uint64(WORD_BITS - self.spill))


def place_signal(message: Message, signal: Signal, most_bytes: int = FD_PAYLOAD_BYTES) -> BitField:
    """Return where a signal of a message lies; a payload has ``most_bytes`` at most.

    Raises
    ------
    DefinitionError
        If it lies outside its message or outside the payload, or has more than 64 bits.
    """
    where = f"{message.name}.{signal.name}"
    is_big = signal.byte_order == "big_endian"
    # The database counts bits of a byte from its lowest; in a big-endian word the highest bit of byte 0 comes first.
    first = 8 * (signal.start // 8) + 7 - signal.start % 8 if is_big else signal.start
    if signal.length > WORD_BITS:
        raise DefinitionError(f"{where} has {signal.length} bits; up to {WORD_BITS} are understood")
    if not (signal.length >= 1 and first >= 0 and first + signal.length <= 8 * message.length):
        raise DefinitionError(f"{where} lies outside its message")
    if first + signal.length > 8 * most_bytes:
        raise DefinitionError(f"{where} lies outside the {FD_PAYLOAD_BYTES} bytes of a CAN FD frame")
    # Words at multiples of eight bytes serve many signals; one that crosses their borders gets a word of its own.
    in_one_word = first // WORD_BITS == (first + signal.length - 1) // WORD_BITS
    first_byte = WORD_BYTES * (first // WORD_BITS) if in_one_word else first // 8
    offset = first - 8 * first_byte
    spill = offset if offset + signal.length > WORD_BITS else 0
    offset -= spill
    return BitField(
        is_big=is_big,
        first_byte=first_byte,
        shift=WORD_BITS - offset - signal.length if is_big else offset,
        length=signal.length,
        is_signed=signal.is_signed and not signal.conversion.is_float,
        spill=spill,
    )
