"""How a line of a text log is laid out: columns, what stands in them, and what its words mean."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

from canlog.arrays import BoolArray, Int64Array
from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG


class Role(IntEnum):
    """What a column holds; in brackets what its parameter is."""

    IGNORED = 0
    TIME = 1  # a decimal number [power of ten of its unit, in microseconds]
    CLOCK = 2  # hours:minutes:seconds:count [microseconds of one]
    CHANNEL = 3  # a number, or "-"
    ID = 4  # hexadecimal, or "-" [digits of a standard identifier; 0: a word tells the kind]
    WORD = (
        5  # one of the layout's words, a digit before it being the channel [first of three letters of words for events]
    )
    SWITCH = 6  # 0, 1, false or true [meaning of a 1]
    LENGTH = 7  # bytes, or "-"
    LENGTH_CODE = 8  # the code that CAN FD has for lengths
    DATA = 9  # bytes in hexadecimal, each a column of its own; the last role of a layout
    BASE64 = 10  # all bytes in one
    DECIMAL_ID = 11
    DECIMAL_DATA = 12  # as DATA, in decimal numbers
    DIRECTION = 13  # Tx or anything else


class Meaning(IntFlag):
    """What a word or a switch says about a frame: the flags of its identifier and its own, and one of ours."""

    NOTHING = 0
    EXTENDED = EXTENDED_FLAG
    REMOTE = REMOTE_FLAG
    ERROR = ERROR_FLAG
    FD = FD_FLAG
    BIT_RATE_SWITCH = BRS_FLAG
    ERROR_STATE = ESI_FLAG
    EVENT = 0x100  # the line holds no frame and is not meant to
    SENT = TX_FLAG  # by the recorder itself


EVENT = int(Meaning.EVENT)
SECONDS, MILLISECONDS, MICROSECONDS = 6, 3, 0
BLANKS, COMMA = ord(" "), ord(",")
PACKED_BYTES = 8  # of a word: its first characters tell it apart


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column."""

    role: Role
    parameter: int = 0


class Program(NamedTuple):
    """A layout, as the compiled reader follows it."""

    columns: Int64Array  # (n, 2): role, parameter
    words: Int64Array  # (n, 2): packed, meaning
    is_comment: BoolArray  # (256,): whether a line that begins with this character is one
    separator: int
    is_padded: bool


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

    def program(self) -> Program:
        """Return the layout as numbers."""
        is_comment = np.zeros(256, np.bool_)
        is_comment[list(self.comment_starts)] = True
        return Program(
            columns=np.array([(column.role, column.parameter) for column in self.columns], np.int64),
            words=np.array([(packed_word(word), int(one)) for word, one in self.words.items()], np.int64).reshape(
                -1, 2
            ),
            is_comment=is_comment,
            separator=self.separator,
            is_padded=self.is_padded,
        )


def packed_word(word: str) -> int:
    """Return a short word as one number, as the compiled reader packs it."""
    value = 0
    for character in word.encode()[:PACKED_BYTES]:
        value = (value << 7) | character
    return value
