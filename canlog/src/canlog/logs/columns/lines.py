"""The lines of tables: what columns can hold, and how a line is split at its separators and read by their roles."""

import base64
import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from decimal import ROUND_HALF_UP, Decimal
from enum import IntEnum, IntFlag

from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    Frame,
)
from canlog.logs.text_kernels import IS_LENGTH, LENGTH_OF_CODE, MALFORMED, OTHER, SKIPPED


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
    FLAGS = 14  # hexadecimal bits, as CLX000 loggers have them [the bit of a frame that the recorder sent]
    STAMP = 15  # digits of a time to the millisecond, without its larger parts [year of those without]
    WORD = 16  # a word of the layout, behind it a channel's digit [first of three letters of words for events]
    BASE64 = 17  # all bytes
    CLOCK = 18  # hours:minutes:seconds:count [microseconds of one]
    LENGTH_CODE = 19  # the code that CAN FD has for lengths


class Meaning(IntFlag):
    """What a word or a switch means for a frame: flags of its identifier, flags of its own, or no frame at all."""

    NOTHING = 0
    EXTENDED = EXTENDED_FLAG
    REMOTE = REMOTE_FLAG
    ERROR = ERROR_FLAG
    FD = FD_FLAG
    BIT_RATE_SWITCH = BRS_FLAG
    ERROR_STATE = ESI_FLAG
    EVENT = 0x100  # the line is an event, no frame
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


MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
NS_PER_US, SECOND_US, HOUR_US = 1_000, 1_000_000, 3_600_000_000
LAST_US = 9_200_000_000_000_000
MOST_CHANNEL, MOST_LENGTH = 255, 255
CODES = len(LENGTH_OF_CODE)
BUS_CHANGE_ID = 0xFFFF_FFFF  # how PCAN writes one
EVENT_LETTERS = 3
EXTENDED_BIT = 0x1  # of the type of a frame, as CLX000 loggers write it
EXTENDED_BITS, STANDARD_BITS = 29, 11  # of an identifier: a number that means yes, and one that means no
UNKNOWN = b"-"  # in an exact layout
REMOTE_WORD = b"remote"  # "Remote request DLC = 8", as IXXAT writes it
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
HOUR_DIGITS, DAY_DIGITS, MONTH_DIGITS, YEAR_DIGITS = 9, 11, 13, 17  # of a stamp in milliseconds up to these parts

# First letters of fields that mean yes, by the role of their column: true, yes, x, and its name, such as Ext or Tx;
# and the flag that yes sets.
SWITCHES = {
    Role.EXTENDED: (b"tyxe", EXTENDED_FLAG),
    Role.REMOTE: (b"tyxr", REMOTE_FLAG),
    Role.ERROR: (b"tyxe", ERROR_FLAG),
    Role.FD: (b"tyxf", FD_FLAG),
    Role.BIT_RATE_SWITCH: (b"tyxb", BRS_FLAG),
    Role.ERROR_STATE: (b"tyxe", ESI_FLAG),
    Role.DIRECTION: (b"tyos", TX_FLAG),  # out, sent
}
SWITCH_WORDS = frozenset({b"0", b"1", b"false", b"true"})

_MARGIN = b" \t\r"
_NUMBER = re.compile(rb"[+-]?\d{1,18}(?:\.\d*)?(?:[eE][+-]?\d{1,3})?")
_SMALL = re.compile(rb"\d{1,3}|\[\d{1,3}\]")
_HEXADECIMAL = re.compile(rb"[0-9A-Fa-f]{1,8}")
_IDENTIFIER = {HEXADECIMAL: re.compile(rb"[0-9A-Fa-f]{1,10}"), 10: re.compile(rb"\d{1,10}")}
_CHANNEL = re.compile(rb"\d{1,3}\Z")
_CLOCK = re.compile(rb"(\d{1,4}):(\d{1,4}):(\d{1,4})(?:[.,:](\d{1,9}))?")
_COUNTED_CLOCK = re.compile(rb"(\d{1,4}):(\d{1,4}):(\d{1,4}):(\d{1,6})")
_DATE = re.compile(rb"(\d{4})([-/])(\d\d)\2(\d\d)[Tt -](\d[\d:.,]*)(?:[Zz]|([+-])(\d\d):?(\d\d))?")
_BETWEEN = rb"[\x00-\x20,:\-._\[\]]"  # what may stand between two bytes
_BYTE = {
    HEXADECIMAL: rb"(?:0[xX](?=.))?(?:[0-9A-Fa-f]{2}|[0-9A-Fa-f](?![^\x00-\x20,:\-._\[\]]))",
    10: rb"(?:0[xX][0-9A-Fa-f]{1,2}|\d{1,3})(?![^\x00-\x20,:\-._\[\]])",
}
_BYTES = {base: re.compile(rb"%s*(?:%s%s*)*" % (_BETWEEN, byte, _BETWEEN), re.DOTALL) for base, byte in _BYTE.items()}


class _MalformedError(ValueError):
    """A field is not what its role must be."""


@dataclass(slots=True)
class FileClock:
    """The clock of a file; its times count from ``base_us``, each from the one before if they are relative."""

    base_us: int = 0
    now_us: int = 0
    wrap_us: int = 0
    laps_us: int = 0
    is_relative: bool = False

    def advance(self, time_us: int, *, is_exact: bool) -> int:
        """Return the time since the epoch; a clock that begins again goes on where it ended."""
        if self.is_relative:
            self.now_us += time_us
            return self.base_us + self.now_us
        if self.wrap_us and is_exact:  # it begins again about midnight; elsewhere it jumped
            if time_us < HOUR_US and self.now_us >= self.wrap_us - HOUR_US:
                self.laps_us += self.wrap_us
            self.now_us = time_us
        elif self.wrap_us:
            if time_us + self.wrap_us // 2 < self.now_us:
                self.laps_us += self.wrap_us
            elif time_us > self.now_us + self.wrap_us // 2 and self.laps_us:
                return self.base_us + self.laps_us - self.wrap_us + time_us  # a frame from before the lap, late
            self.now_us = time_us
        return self.base_us + self.laps_us + time_us


@dataclass(slots=True)
class _Line:
    """What has been read of a line."""

    time_us: int = 0
    identifier: int | None = None
    meaning: int = 0
    length: int | None = None
    channel: int = 0
    data: bytearray = field(default_factory=bytearray)

    def is_full(self) -> bool:
        return self.length is not None and self.length <= min(len(self.data), PAYLOAD_BYTES)


class LineReader:
    """Reads the lines of one file by a layout."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._columns = [(column.role, column.parameter) for column in layout.columns]
        self._channels = {name.encode(): number for number, name in reversed(list(enumerate(layout.channel_names)))}
        self._words = {word.encode(): int(meaning) for word, meaning in layout.words.items()}
        self._separator = None if layout.separator == BLANKS else bytes([layout.separator])

    def read(self, text: bytes, clock: FileClock) -> Frame | int:
        """Return the frame of a line, or what else it is."""
        stripped = text.strip(_MARGIN)
        if not stripped:
            return SKIPPED
        if stripped[0] in self._layout.comment_starts:
            return OTHER if self._layout.is_exact else SKIPPED
        line = _Line()
        try:
            self._read_fields(self._split(text), line)
            if line.meaning & EVENT:
                clock.now_us += line.time_us if clock.is_relative else 0
                return SKIPPED
            self._check_length(line)
            return self._frame(line, clock)
        except (_MalformedError, ValueError, csv.Error):
            return MALFORMED

    def _split(self, text: bytes) -> list[bytes]:
        """Return the fields of a line, without quotes and blanks around them."""
        if self._separator is None:
            return text.split()
        if b'"' not in text:
            return [field.strip(_MARGIN) for field in text.split(self._separator)]
        quoted = csv.reader([text.decode("latin-1")], delimiter=self._separator.decode(), skipinitialspace=True)
        return [field.strip().encode("latin-1") for field in next(quoted, [])]

    def _read_fields(self, fields: Sequence[bytes], line: _Line) -> None:
        """Read all fields, or those up to a word of an event."""
        layout, columns, column = self._layout, self._columns, 0
        last = len(columns) - 1
        for place, text in enumerate(fields):
            if layout.is_exact and line.meaning & ERROR_FLAG:
                column = self._column_of(text, column, line)
            if layout.is_exact and column == last and columns[last][0] is Role.DATA:
                self._read_exact_data(fields[place:], columns[last][1], line)
                column += 1
                break
            role, parameter = self._role_of(column, text, line)
            if layout.is_exact:
                self._read_exact_field(text, role, parameter, line)
            else:
                self._read_field(text, role, parameter, line)
            column += 1
            if line.meaning & EVENT:
                return
        is_short = column < len(columns) - (columns[last][0] in {Role.DATA, Role.BASE64})
        if layout.is_exact and is_short:
            raise _MalformedError

    def _role_of(self, column: int, text: bytes, line: _Line) -> tuple[Role, int]:
        """Return what a field is, and the parameter of that."""
        role, parameter = self._columns[min(column, len(self._columns) - 1)]
        if column < len(self._columns):  # a label may stand where bytes would be
            return (Role.IGNORED if role is Role.BYTE and line.is_full() else role), parameter
        if not text:
            return Role.IGNORED, 0
        if self._layout.is_exact or role not in {Role.DATA, Role.BYTE}:
            raise _MalformedError
        is_comment = role is Role.BYTE or line.is_full()  # else bytes of one column, spread over others
        return (Role.IGNORED if is_comment else Role.BYTE), parameter

    def _column_of(self, text: bytes, column: int, line: _Line) -> int:
        """Return which column a field of an error frame is: TRC 2.0 leaves out its identifier and its length."""
        while column < len(self._columns):
            role = self._columns[column][0]
            if role is Role.ID and text[:2].lower() in {b"rx", b"tx"}:
                line.identifier = line.length = 0
            elif role is not Role.LENGTH or line.length != 0:
                break
            column += 1
        return column

    def _read_exact_field(self, text: bytes, role: Role, parameter: int, line: _Line) -> None:  # noqa: C901, PLR0912 - one for each role
        """Read one field of an exact layout."""
        if role is Role.BASE64:
            line.data += base64.b64decode(text, validate=True)
        elif not text:
            if role not in {Role.IGNORED, Role.DIRECTION}:
                raise _MalformedError
        elif role is Role.WORD:
            self._read_word(text, parameter, line)
        elif role is Role.CLOCK:
            line.time_us = _counted_clock_us(text, parameter)
        elif role is Role.DIRECTION:
            line.meaning |= TX_FLAG if text[:1] in b"tT" else 0
        elif role in SWITCHES:
            if text.lower() not in SWITCH_WORDS:
                raise _MalformedError
            line.meaning |= _switched(text, role)
        elif role is Role.TIME:
            line.time_us = _decimal_us(text, parameter)
        elif text == UNKNOWN and role in {Role.CHANNEL, Role.LENGTH, Role.LENGTH_CODE, Role.ID}:
            pass
        elif role is Role.CHANNEL:
            line.channel = _small_number(text)
        elif role is Role.LENGTH:
            line.length = _small_number(text)
        elif role is Role.LENGTH_CODE:
            code = _small_number(text)
            if code >= CODES:
                raise _MalformedError
            line.length = int(LENGTH_OF_CODE[code]) if line.meaning & FD_FLAG else min(code, PAYLOAD_BYTES)
        elif role is Role.ID:
            self._read_exact_identifier(text, parameter, line)

    def _read_exact_identifier(self, text: bytes, base: int, line: _Line) -> None:
        """Read a decimal identifier, or one of up to eight hexadecimal digits, perhaps behind 0x."""
        if base != HEXADECIMAL:
            line.identifier = _whole(text, base)
            return
        text = text[2:] if text[:2].lower() == b"0x" else text
        if not _HEXADECIMAL.fullmatch(text):
            raise _MalformedError
        line.identifier = int(text, 16)
        if 0 < self._layout.extended_digits <= len(text):
            line.meaning |= EXTENDED_FLAG | (EVENT if line.identifier == BUS_CHANGE_ID else 0)

    def _read_word(self, text: bytes, initial: int, line: _Line) -> None:
        """Read a word of the layout, behind a channel of one digit if there is one."""
        if text[:1].isdigit():
            line.channel, text = text[0] - ord("0"), text[1:]
        word = text.lower()
        meaning = self._words.get(word)
        if meaning is None and initial and word[:1] == bytes([initial]) and len(word) == EVENT_LETTERS:
            meaning = EVENT
        if meaning is None:
            raise _MalformedError
        line.meaning |= meaning

    def _read_exact_data(self, fields: Sequence[bytes], base: int, line: _Line) -> None:
        """Read bytes to the end of the line, before them perhaps a word.

        A hexadecimal byte has two digits; between separators also one, or none where a column is empty.
        """
        is_hexadecimal, is_blank = base == HEXADECIMAL, self._separator is None
        if is_blank and is_hexadecimal and fields and not _HEXADECIMAL.fullmatch(fields[0][:2]):
            self._read_word(fields[0], 0, line)
            fields = fields[1:]
        least = 2 if is_blank and is_hexadecimal else 1
        for text in fields:
            if text or is_blank:
                if not least <= len(text) <= (2 if is_hexadecimal else 3):
                    raise _MalformedError
                line.data.append(_whole(text, base))

    def _read_field(self, text: bytes, role: Role, parameter: int, line: _Line) -> None:  # noqa: C901 - one for each role
        """Read one field of a layout that is not exact."""
        if role is Role.TIME:
            line.time_us = self._time_us(text, parameter)
        elif role is Role.ID:
            if text:  # none of an error frame
                self._read_identifier(text, parameter, line)
        elif role in {Role.DATA, Role.BYTE}:
            self._read_bytes(text, role, parameter, line)
        elif role is Role.LENGTH:
            line.length = _small_number(text) if text else None
        elif role is Role.CHANNEL:
            line.channel = self._channel(text)
        elif role is Role.FLAGS:
            if not _HEXADECIMAL.fullmatch(text):
                raise _MalformedError
            line.meaning |= EXTENDED_FLAG if int(text, 16) & EXTENDED_BIT else 0
            line.meaning |= TX_FLAG if int(text, 16) & parameter else 0
        elif role is Role.STAMP:
            line.time_us = _stamp_us(text, parameter)
        elif role in SWITCHES:
            line.meaning |= _switched(text, role)
        elif role is not Role.IGNORED:
            raise _MalformedError

    def _read_identifier(self, text: bytes, base: int, line: _Line) -> None:
        """Read an identifier; ``x`` behind it makes it an extended one, as Vector writes it."""
        text = text.lower()
        if text.startswith(b"0x") and len(text) > len(b"0x"):
            text, base = text[2:], HEXADECIMAL
        if text.endswith((b"x", b"h")):
            line.meaning |= EXTENDED_FLAG if text.endswith(b"x") else 0
            text, base = text[:-1], (HEXADECIMAL if text.endswith(b"h") else base)
        value = _whole(text, base)
        if value > MAX_EXTENDED_ID and value & EXTENDED_FLAG:  # as Linux numbers them
            value &= ~EXTENDED_FLAG
            line.meaning |= EXTENDED_FLAG
        if 0 < self._layout.extended_digits <= len(text) and base == HEXADECIMAL:
            line.meaning |= EXTENDED_FLAG
        line.identifier = value

    def _read_bytes(self, text: bytes, role: Role, base: int, line: _Line) -> None:
        """Add the bytes of a field; hexadecimal ones may stand without anything between them."""
        if role is Role.DATA and text[: len(REMOTE_WORD)].lower() == REMOTE_WORD:
            line.meaning |= REMOTE_FLAG
            line.length = max(line.length or 0, _number_at_end(text))
            return
        if not _BYTES[base].fullmatch(text):
            raise _MalformedError
        words = [word.lower() for word in re.findall(_BYTE[base], text, re.DOTALL)]
        line.data += bytes(int(word, 16 if word.startswith(b"0x") else base) for word in words)
        if role is Role.BYTE and len(words) > 1:
            raise _MalformedError

    def _channel(self, text: bytes) -> int:
        """Return the place of a name of a bus among known ones; without those the number at its end."""
        if self._channels:
            return self._channels.get(text, len(self._channels))  # new names share the last number
        return _number_at_end(text)

    def _time_us(self, text: bytes, power: int) -> int:
        """Return a time in microseconds: a number of a unit, a time of day, or a date.

        A date is taken as if it were UTC unless an offset stands behind it.
        """
        if match := _DATE.fullmatch(text):
            return _date_us(match)
        if b":" in text:
            return _clock_us(text)
        if self._layout.has_decimal_comma:
            text = text.replace(b",", b".", 1)
        return _decimal_us(text, power)

    def _check_length(self, line: _Line) -> None:
        """Compare the number of bytes with the length in the line."""
        count, length, is_exact = len(line.data), line.length, self._layout.is_exact
        if not is_exact and length and PAYLOAD_BYTES < length < CODES and count == LENGTH_OF_CODE[length]:
            length = count  # it was the code for so many
        length = count if length is None else length
        has_payload = not line.meaning & (REMOTE_FLAG | ERROR_FLAG)
        is_surplus = is_exact and not self._layout.is_padded and count > length
        is_long_remote = not is_exact and length > PAYLOAD_BYTES
        is_odd = (count < length or is_surplus) if has_payload else is_long_remote
        if max(length, count) > FD_PAYLOAD_BYTES or not IS_LENGTH[length] or is_odd:
            raise _MalformedError
        line.length = length
        line.data = line.data[:length] if has_payload else bytearray()

    def _frame(self, line: _Line, clock: FileClock) -> Frame | int:
        """Return the frame that was read, and let the clock go on."""
        meaning, identifier, length, is_exact = line.meaning, line.identifier, line.length or 0, self._layout.is_exact
        if meaning & ERROR_FLAG:
            identifier, length, meaning = ERROR_FLAG, 0, meaning & ~(EXTENDED_FLAG | REMOTE_FLAG)
        elif identifier is None or identifier > MAX_EXTENDED_ID:
            return MALFORMED
        elif identifier > MAX_STANDARD_ID:
            if is_exact and not meaning & EXTENDED_FLAG:
                return MALFORMED
            meaning |= EXTENDED_FLAG
        if is_exact and clock.wrap_us and line.time_us >= clock.wrap_us:
            return MALFORMED
        time_us = clock.advance(line.time_us, is_exact=is_exact)
        if not -LAST_US <= time_us <= LAST_US:
            return MALFORMED
        is_fd = (meaning & FD_FLAG or length > PAYLOAD_BYTES) and not meaning & (REMOTE_FLAG | ERROR_FLAG)
        flags = FD_FLAG | meaning & (BRS_FLAG | ESI_FLAG | TX_FLAG) if is_fd else meaning & TX_FLAG
        can_id = identifier | meaning & (EXTENDED_FLAG | REMOTE_FLAG)
        return Frame(time_us * NS_PER_US, can_id, length, bytes(line.data[:length]), flags, line.channel)


def _whole(text: bytes, base: int) -> int:
    """Return a number of up to ten digits."""
    if not _IDENTIFIER[base].fullmatch(text):
        raise _MalformedError
    return int(text, base)


def _small_number(text: bytes) -> int:
    """Return a number up to that of any length, perhaps in brackets."""
    if not _SMALL.fullmatch(text) or (value := int(text.strip(b"[]"))) > MOST_LENGTH:
        raise _MalformedError
    return value


def _number_at_end(text: bytes) -> int:
    digits = _CHANNEL.search(text)
    return value if digits and (value := int(digits[0])) <= MOST_CHANNEL else 0


def _switched(text: bytes, role: Role) -> int:
    """Return the flag of a column if a field means yes: 1, true, yes, x, or the name of the flag."""
    letters, flag = SWITCHES[role]
    if text[:1].isdigit():
        return flag if _SMALL.fullmatch(text) and 0 < int(text) <= MOST_LENGTH and int(text) != STANDARD_BITS else 0
    return flag if text and text[:1].lower() in letters else 0


def _decimal_us(text: bytes, power: int) -> int:
    """Return a decimal number, perhaps with sign and exponent, as microseconds: times ten to this power, rounded."""
    if not _NUMBER.fullmatch(text):
        raise _MalformedError
    value = Decimal(text.decode()).scaleb(power)
    if abs(value) > LAST_US:
        raise _MalformedError
    return int(value.to_integral_value(ROUND_HALF_UP))


def _clock_us(text: bytes) -> int:
    """Return ``hours:minutes:seconds.fraction`` in microseconds."""
    match = _CLOCK.fullmatch(text)
    hours, minutes, seconds = map(int, match.groups()[:3]) if match else (0, 60, 0)
    if not match or max(minutes, seconds) >= 60:
        raise _MalformedError
    return ((hours * 60 + minutes) * 60 + seconds) * SECOND_US + int((match[4] or b"").ljust(6, b"0")[:6])


def _counted_clock_us(text: bytes, unit_us: int) -> int:
    """Return ``hours:minutes:seconds:count``, a count of so many microseconds, padded with zeros or not."""
    match = _COUNTED_CLOCK.fullmatch(text)
    hours, minutes, seconds, count = map(int, match.groups()) if match else (0, 60, 0, 0)
    if max(minutes, seconds) >= 60 or count * unit_us >= SECOND_US:
        raise _MalformedError
    return ((hours * 60 + minutes) * 60 + seconds) * SECOND_US + count * unit_us


def _date_us(match: re.Match[bytes]) -> int:
    """Return ``2026-01-31T23:59:59.5+01:00``, or with a blank and without an offset, in microseconds."""
    year, month, day = (int(match[number]) for number in (1, 3, 4))
    offset_s = (int(match[7]) * 60 + int(match[8])) * 60 * (-1 if match[6] == b"-" else 1) if match[6] else 0
    days = (datetime(year, month, day, tzinfo=UTC) - EPOCH).days
    return days * 86_400 * SECOND_US + _clock_us(match[5]) - offset_s * SECOND_US


def _stamp_us(text: bytes, year: int) -> int:
    """Return ``20260131T235959.999`` in microseconds, whatever stands between its digits, as if it were UTC.

    Larger parts may be missing: the year, which is then ``year``; the month, then it is the time since the month
    began; the day, the hour, and so on.
    """
    digits = re.sub(rb"\D", b"", text)
    count = len(digits)
    if count not in {3, 5, 7, HOUR_DIGITS, DAY_DIGITS, MONTH_DIGITS, YEAR_DIGITS}:
        raise _MalformedError
    value = int(digits)
    second, minute, hour, rest = value // 1_000 % 100, value // 100_000 % 100, value // 10**7 % 100, value // 10**9
    if second > 60 or minute > 59 or hour > 23:
        raise _MalformedError
    days = rest % 100 - 1 if count == DAY_DIGITS else 0
    if count > DAY_DIGITS:
        year = rest // 10_000 if count == YEAR_DIGITS else year
        days = (datetime(year, rest // 100 % 100, rest % 100, tzinfo=UTC) - EPOCH).days
    if days < 0 and count == DAY_DIGITS:
        raise _MalformedError
    return (((days * 24 + hour) * 60 + minute) * 60 + second) * SECOND_US + value % 1_000 * 1_000
