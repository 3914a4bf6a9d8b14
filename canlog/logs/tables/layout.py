"""How a line of a text log is laid out: columns, what stands in them, and what its words mean."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

import numpy as np

from canlog.arrays import Int64Array


class Role(IntEnum):
    """What a column holds; in brackets what its parameter is."""

    IGNORED = 0
    TIME = 1  # a decimal number [power of ten of its unit, in microseconds]
    CLOCK = 2  # hours:minutes:seconds:count [microseconds of one]
    CHANNEL = 3  # a number, or "-"
    ID = 4  # hexadecimal, or "-" [digits of a standard identifier; 0: a word tells the kind]
    WORD = 5  # one of the layout's words, a digit before it being the channel [first letter of words for events]
    SWITCH = 6  # 0, 1, false or true [meaning of a 1]
    LENGTH = 7  # bytes, or "-"
    LENGTH_CODE = 8  # the code that CAN FD has for lengths
    DATA = 9  # bytes in hexadecimal, each a column of its own; the last role of a layout
    BASE64 = 10  # all bytes in one
    DECIMAL_ID = 11
    DECIMAL_DATA = 12  # as DATA, in decimal numbers
    DIRECTION = 13  # Tx or anything else


class Meaning(IntFlag):
    """What a word or a switch says about a frame."""

    NOTHING = 0
    EXTENDED = 1
    REMOTE = 2
    ERROR = 4
    FD = 8
    BIT_RATE_SWITCH = 16
    ERROR_STATE = 32
    EVENT = 64  # the line holds no frame and is not meant to
    SENT = 128  # by the recorder itself


SECONDS, MILLISECONDS, MICROSECONDS = 6, 3, 0
BLANKS, COMMA = ord(" "), ord(",")
PACKED_BYTES = 8  # of a word: its first characters tell it apart


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column."""

    role: Role
    parameter: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """One kind of line.

    ``words`` are in lower case. ``comment_starts`` are the characters that begin lines without a frame, which the
    format itself reads. ``is_padded`` lets more bytes follow than the length says.
    """

    columns: tuple[Column, ...]
    separator: int = BLANKS
    words: Mapping[str, Meaning] = field(default_factory=dict)
    comment_starts: bytes = b""
    is_padded: bool = False

    @property
    def tells_length(self) -> bool:
        """Whether a line says how long its payload is."""
        return any(column.role in {Role.LENGTH, Role.LENGTH_CODE} for column in self.columns)

    @property
    def has_columns_of_bytes(self) -> bool:
        """Whether every byte of a payload stands by itself."""
        return self.columns[-1].role in {Role.DATA, Role.DECIMAL_DATA}

    def program(self) -> Int64Array:
        """Return the columns as numbers, shape (n, 2), for the compiled reader."""
        return np.array([(column.role, column.parameter) for column in self.columns], np.int64)

    def vocabulary(self) -> Int64Array:
        """Return words and meanings as numbers, shape (n, 2)."""
        known = [(packed(word), int(meaning)) for word, meaning in self.words.items()]
        return np.array(known, np.int64).reshape(-1, 2)


def packed(word: str) -> int:
    """Return a short word as one number, as the compiled reader packs it."""
    value = 0
    for character in word.encode()[:PACKED_BYTES]:
        value = (value << 7) | character
    return value
