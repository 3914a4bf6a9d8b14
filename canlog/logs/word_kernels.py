"""Eight bytes at a time, compiled: loads, and digits that are read together instead of one after the other.

A word holds eight characters of a text, the first of them lowest. The tests on all eight at once add numbers to bytes
below 128 that reach bit 7 exactly from the bound on; no sum carries into the next byte.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from canlog.arrays import UInt8Array
from canlog.jit import inlined_kernel

UInt64Array = npt.NDArray[np.uint64]

WORD_BYTES: Final = 8
NO_DIGITS: Final = -1

_1, _2, _3, _4, _5, _6, _7 = (np.uint64(number) for number in range(1, 8))
_8, _16, _24, _32, _40, _48, _56 = (np.uint64(8 * number) for number in range(1, 8))


def _each(byte: int) -> np.uint64:
    """Return a word of eight equal bytes."""
    return np.uint64(int.from_bytes(bytes([byte]) * WORD_BYTES, "little"))


_TOP_BITS, _HIGH_NIBBLES, _LOW_NIBBLES = _each(0x80), _each(0xF0), _each(0x0F)
_SMALL, _ONES, _NINE = _each(0x20), _each(0x01), np.uint64(9)
_ZEROS, _SIXES, _THREES = _each(ord("0")), _each(0x06), _each(0x33)
_FROM_0, _PAST_9 = _each(0x80 - ord("0")), _each(0x80 - ord("9") - 1)
_FROM_A, _PAST_F = _each(0x80 - ord("a")), _each(0x80 - ord("f") - 1)
_EVEN_BYTES, _EVEN_HALVES = np.uint64(0x00FF_00FF_00FF_00FF), np.uint64(0x0000_FFFF_0000_FFFF)
_LOW_HALF = np.uint64(0xFFFF_FFFF)
_TEN, _BYTES_0_AND_4 = np.uint64(10), np.uint64(0x0000_00FF_0000_00FF)
_MILLIONS, _HUNDREDS = np.uint64(100 + (1_000_000 << 32)), np.uint64(1 + (10_000 << 32))


@inlined_kernel
def half(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of two bytes."""
    place = np.uint64(at)  # unsigned: no look from the end of the array
    return int(np.int64(raw[place]) | np.int64(raw[place + _1]) << 8)


@inlined_kernel
def word(raw: UInt8Array, at: int) -> np.uint64:
    """Return eight bytes from anywhere, little-endian, in one load."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    low |= np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24
    high = np.uint64(raw[place + _4]) << _32 | np.uint64(raw[place + _5]) << _40
    high |= np.uint64(raw[place + _6]) << _48 | np.uint64(raw[place + _7]) << _56
    return low | high


@inlined_kernel
def lower(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of four bytes."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    return int(np.int64(low | np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24))


@inlined_kernel
def decimal_digits(text: np.uint64) -> int:
    """Return the number that eight decimal digits are, NO_DIGITS if any is none."""
    if (text & _HIGH_NIBBLES) | (((text + _SIXES) & _HIGH_NIBBLES) >> _4) != _THREES:
        return NO_DIGITS
    value = text - _ZEROS
    value = value * _TEN + (value >> _8)  # pairs, in every other byte
    value = (value & _BYTES_0_AND_4) * _MILLIONS + ((value >> _16) & _BYTES_0_AND_4) * _HUNDREDS
    return int(np.int64(value >> _32))


@inlined_kernel
def hex_digits(text: np.uint64) -> int:
    """Return the four bytes that eight hexadecimal digits are, the first lowest; NO_DIGITS if any is none."""
    small = text | _SMALL
    is_digit = (text + _FROM_0) & ~(text + _PAST_9)
    is_letter = (small + _FROM_A) & ~(small + _PAST_F)
    if ((is_digit | is_letter) & ~text & _TOP_BITS) != _TOP_BITS:
        return NO_DIGITS
    value = (text & _LOW_NIBBLES) + ((text >> _6) & _ONES) * _NINE
    value = (value << _4 | value >> _8) & _EVEN_BYTES
    value = (value | value >> _8) & _EVEN_HALVES
    return int(np.int64((value | value >> _16) & _LOW_HALF))


@inlined_kernel
def reversed_bytes(value: int) -> int:
    """Return four bytes in the other order."""
    return (value & 0xFF) << 24 | (value & 0xFF00) << 8 | (value >> 8) & 0xFF00 | (value >> 24) & 0xFF
