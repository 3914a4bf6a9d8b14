"""Lines of text as matrices of characters: thousands of lines with a handful of array operations."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ecu_emulator.log_formats.base import ERROR_FLAG, EXTENDED_FLAG, Int64Array, UInt8Array, UInt32Array

HEX_DIGITS: Final = np.frombuffer(b"0123456789ABCDEF", np.uint8)
STANDARD_ID_DIGITS: Final = 3
EXTENDED_ID_DIGITS: Final = 8
DROPPED: Final = np.uint8(0)  # a character that is left out of its line


def constant(text: str, lines: int) -> UInt8Array:
    """Return the same characters for every line."""
    return np.tile(np.frombuffer(text.encode(), np.uint8), (lines, 1))


def decimal(value: Int64Array, digits: int) -> UInt8Array:
    """Return non-negative numbers with leading zeros, shape (n, digits)."""
    weights = 10 ** np.arange(digits - 1, -1, -1, dtype=np.int64)
    digit: Int64Array = value[:, None] // weights % 10
    return (digit + ord("0")).astype(np.uint8)


def aligned(value: Int64Array, width: int) -> UInt8Array:
    """Return non-negative numbers behind blanks, shape (n, width)."""
    digits = decimal(value, width)
    is_leading = np.logical_and.accumulate(digits == ord("0"), axis=1)
    is_leading[:, -1] = False
    return np.where(is_leading, np.uint8(ord(" ")), digits)


def identifier(can_id: UInt32Array, standard_digits: int = STANDARD_ID_DIGITS) -> UInt8Array:
    """Return identifiers as three or another number of hexadecimal digits, eight if extended or of an error frame."""
    shifts = np.arange(4 * (EXTENDED_ID_DIGITS - 1), -1, -4, dtype=np.uint32)
    is_long = (can_id & np.uint32(EXTENDED_FLAG | ERROR_FLAG)) != 0
    number = can_id & np.uint32(EXTENDED_FLAG - 1)
    digits: UInt8Array = HEX_DIGITS[number[:, None] >> shifts & np.uint32(0xF)]
    digits[~is_long, : EXTENDED_ID_DIGITS - standard_digits] = DROPPED
    return digits


def payload(data: UInt8Array, length: UInt8Array, separator: str = "") -> UInt8Array:
    """Return payload bytes as hexadecimal digits, each byte behind the separator, none past the length."""
    before = np.frombuffer(separator.encode(), np.uint8)
    text = np.empty((*data.shape, len(before) + 2), np.uint8)
    text[:, :, : len(before)] = before
    text[:, :, -2] = HEX_DIGITS[data >> 4]
    text[:, :, -1] = HEX_DIGITS[data & 0xF]
    text[np.arange(data.shape[1]) >= length[:, None]] = DROPPED
    return text.reshape(len(data), -1)


def when(condition: npt.NDArray[np.bool_], text: str) -> UInt8Array:
    """Return the characters for the lines where the condition holds."""
    return np.where(condition[:, None], np.frombuffer(text.encode(), np.uint8), DROPPED)


def lines(parts: Sequence[UInt8Array]) -> bytes:
    """Return the lines that the parts make up side by side, each ended by a newline."""
    matrix: UInt8Array = np.hstack([*parts, constant("\n", len(parts[0]))])
    kept: UInt8Array = matrix[matrix != DROPPED]
    return kept.tobytes()
