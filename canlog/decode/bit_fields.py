"""Where a signal lies in a payload, and how one array operation reads it out of all payloads.

A payload is read as 64-bit words that begin at any byte, in either byte order; a signal is a shift and a mask of one of
them. Only a signal of more than 56 bits that lies across nine bytes needs a byte besides.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.arrays import Int64Array, UInt8Array
from canlog.errors import DefinitionError
from canlog.frames import FD_PAYLOAD_BYTES

UInt64Array = npt.NDArray[np.uint64]

WORD_BYTES: Final = 8
WORD_BITS: Final = 64
LITTLE_WORD: Final = np.dtype(np.uint64)  # of the machines that numba compiles for


class PayloadWords:
    """Payloads as 64-bit words, each made when it is first asked for; bytes past the end of the rows are zeros.

    Parameters
    ----------
    data : (n, bytes) array
        The payloads.
    rows : (k,) array, optional
        Which of them are meant; left out: all.
    """

    def __init__(self, data: UInt8Array, rows: Int64Array | None = None) -> None:
        self._data = data
        self._rows = rows
        self._words: dict[tuple[int, bool], UInt64Array] = {}

    def __len__(self) -> int:
        return len(self._data if self._rows is None else self._rows)

    def word(self, first_byte: int, *, is_big: bool) -> UInt64Array:
        """Return the eight bytes from ``first_byte`` on, the first of them highest if ``is_big``, shape (n,)."""
        key = first_byte, is_big
        if key not in self._words:
            self._words[key] = self.word(first_byte, is_big=False).byteswap() if is_big else self._little(first_byte)
        return self._words[key]

    def words(self, places: Sequence[tuple[int, bool]]) -> UInt64Array:
        """Return several words by their first bytes and whether they are big-endian, shape (words, n)."""
        found = np.empty((len(places), len(self)), np.uint64)
        for row, (first_byte, is_big) in zip(found, places, strict=True):
            row[:] = self.word(first_byte, is_big=is_big)
        return found

    def byte(self, index: int) -> UInt64Array:
        """Return one byte of each payload, shape (n,)."""
        return self._piece(index)[:, 0].astype(np.uint64)

    def _little(self, first_byte: int) -> UInt64Array:
        """Return a little-endian word; those that payloads are made of can be picked without copying bytes."""
        if first_byte % WORD_BYTES == 0 and self._data.shape[1] % WORD_BYTES == 0 and self._data.flags.c_contiguous:
            words: UInt64Array = self._data.view(LITTLE_WORD)[:, first_byte // WORD_BYTES]
            return words if self._rows is None else words.take(self._rows)
        return np.ascontiguousarray(self._piece(first_byte)).view(LITTLE_WORD)[:, 0]

    def _piece(self, first_byte: int) -> UInt8Array:
        piece = self._data[:, first_byte : first_byte + WORD_BYTES]
        piece = piece if self._rows is None else piece[self._rows]
        missing = WORD_BYTES - piece.shape[1]
        return np.pad(piece, ((0, 0), (0, missing))) if missing else piece


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
            word = self._with_ninth_byte(word, words.byte(self.first_byte + WORD_BYTES))
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

    def _with_ninth_byte(self, word: UInt64Array, ninth: UInt64Array) -> UInt64Array:
        """Return the word moved by ``spill`` bits, so that the whole signal is in it."""
        if self.is_big:
            return (word << np.uint64(self.spill)) | (ninth >> np.uint64(8 - self.spill))
        return (word >> np.uint64(self.spill)) | (ninth << np.uint64(WORD_BITS - self.spill))


def place_signal(message: Message, signal: Signal) -> BitField:
    """Return where a signal of a message lies.

    Raises
    ------
    DefinitionError
        If it lies outside its message or outside the 64 bytes of a CAN FD frame, or has more than 64 bits.
    """
    where = f"{message.name}.{signal.name}"
    is_big = signal.byte_order == "big_endian"
    # The database counts bits of a byte from its lowest; in a big-endian word the highest bit of byte 0 comes first.
    first = 8 * (signal.start // 8) + 7 - signal.start % 8 if is_big else signal.start
    if signal.length > WORD_BITS:
        raise DefinitionError(f"{where} has {signal.length} bits; up to {WORD_BITS} are understood")
    if not (signal.length >= 1 and first >= 0 and first + signal.length <= 8 * message.length):
        raise DefinitionError(f"{where} lies outside its message")
    if first + signal.length > 8 * FD_PAYLOAD_BYTES:
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
