"""What the columns of a table can hold, and how a table is laid out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG


class Role(IntEnum):
    """What a column holds; in brackets what its parameter is."""

    IGNORED = 0
    TIME = 1  # a number [power of ten of its unit, in microseconds], a time of day or a date
    ID = 2  # hexadecimal or decimal [base]
    DATA = 3  # all bytes [base]; between them what separates columns, if the layout is exact and that is no blank
    BYTE = 4  # one byte [base]
    LENGTH = 5  # bytes, or the code that CAN FD has for so many
    CHANNEL = 6  # a number, or a name with one at its end
    EXTENDED = 7
    REMOTE = 8
    ERROR = 9
    FD = 10
    BIT_RATE_SWITCH = 11
    ERROR_STATE = 12
    DIRECTION = 13  # Tx or anything else
    FLAGS = 14  # hexadecimal bits, as CLX000 loggers have them [the one that says that the recorder sent the frame]
    STAMP = 15  # digits of a time to the millisecond, without its larger parts [year of those without]
    WORD = 16  # a word of the layout, behind it a channel's digit [first of three letters of words for events]
    BASE64 = 17  # all bytes
    CLOCK = 18  # hours:minutes:seconds:count [microseconds of one]
    LENGTH_CODE = 19  # the code that CAN FD has for lengths


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
HEXADECIMAL, DECIMAL = 16, 10
BLANKS, COMMA = ord(" "), ord(",")
MINUTE_US, DAY_US = 60_000_000, 86_400_000_000


@dataclass(frozen=True, slots=True)
class Column:
    role: Role = Role.IGNORED
    parameter: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How the lines of a table are laid out.

    From ``extended_digits`` hexadecimal digits on an identifier is an extended one; 0: digits do not tell. The lines up
    to ``header_lines`` hold no frames. ``wrap_us`` is after how long the clock begins again; 0: never.

    An ``is_exact`` layout has one way of writing each thing: every column is there and holds what its role says, there
    are as many bytes as the length says, and kinds of frames are told, not seen by identifiers. Its comments are read
    by ``read_comment``; others are passed over. ``words``, in lower case, may also stand before its bytes;
    ``is_padded`` lets more bytes follow than the length says.
    """

    columns: tuple[Column, ...]
    separator: int
    comment_starts: bytes = b"#"
    header_lines: int = 0
    extended_digits: int = 0
    has_decimal_comma: bool = False
    wrap_us: int = 0
    names: tuple[str, ...] = field(default=())  # of the columns, as the header has them
    channel_names: tuple[str, ...] = ()  # numbered from 0; empty: the digits at their ends are their numbers
    words: Mapping[str, Meaning] = field(default_factory=dict)
    is_exact: bool = False
    is_padded: bool = False

    def has(self, role: Role) -> bool:
        return any(column.role is role for column in self.columns)
