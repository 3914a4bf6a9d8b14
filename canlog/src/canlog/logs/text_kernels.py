"""What compiled readers share: digits, blanks and payloads of a text, the rows they fill, names of channels.

Every text that is parsed ends with a newline, and no step passes over one, so none needs the length of the text.
"""

import re
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.jit import part

# What one line comes to. The last three stop a kernel: the frame is too long for the rows, the line is none that the
# kernel reads, its channel has no number yet.
FRAME, SKIPPED, MALFORMED, TOO_LONG, OTHER, NEW_CHANNEL = range(6)

# Progress of a kernel: its place in the text, what stopped it, counts.
POSITION, LINES, ROWS, STOP, SKIPPED_LINES, MALFORMED_LINES, FIRST_MALFORMED, PROGRESS_FIELDS = range(8)

NEWLINE, TAB, RETURN, BLANK, SLASH = 10, 9, 13, 32, 47
LONGEST_NUMBER = 18  # digits that fit 64 bits

HEX_VALUE: npt.NDArray[np.int8] = np.full(256, -1, np.int8)

_1, _2, _3, _4, _5, _6, _7 = (np.uint64(number) for number in range(1, 8))
_8, _16, _24, _32, _40, _48, _56 = (np.uint64(8 * number) for number in range(1, 8))


@part
def half(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of two bytes."""
    place = np.uint64(at)  # unsigned: no look from the end of the array
    return int(np.int64(raw[place]) | np.int64(raw[place + _1]) << 8)


@part
def word(raw: UInt8Array, at: int) -> np.uint64:
    """Return eight bytes from anywhere, little-endian, in one load."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    low |= np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24
    high = np.uint64(raw[place + _4]) << _32 | np.uint64(raw[place + _5]) << _40
    high |= np.uint64(raw[place + _6]) << _48 | np.uint64(raw[place + _7]) << _56
    return low | high


@part
def lower(raw: UInt8Array, at: int) -> int:
    """Return a little-endian number of four bytes."""
    place = np.uint64(at)
    low = np.uint64(raw[place]) | np.uint64(raw[place + _1]) << _8
    return int(np.int64(low | np.uint64(raw[place + _2]) << _16 | np.uint64(raw[place + _3]) << _24))


for _digit in range(16):
    HEX_VALUE[ord(f"{_digit:x}")] = HEX_VALUE[ord(f"{_digit:X}")] = _digit

# Two characters at a time: their value as hexadecimal and as decimal digits, -1 for any others.
_HEX_PAIRS = 16 * HEX_VALUE[:, None].astype(np.int16) + HEX_VALUE[None, :]
_ARE_HEX = (HEX_VALUE[:, None] >= 0) & (HEX_VALUE[None, :] >= 0)
HEX_PAIR: npt.NDArray[np.int16] = np.where(_ARE_HEX, _HEX_PAIRS, np.int16(-1))
LENGTH_OF_CODE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.int64)
IS_LENGTH: npt.NDArray[np.bool_] = np.isin(np.arange(65), LENGTH_OF_CODE)


@part
def skip_blanks(text: UInt8Array, at: int) -> int:
    """Return the position of the next character that is neither space, tabulator nor carriage return."""
    while text[at] == BLANK or text[at] == TAB or text[at] == RETURN:
        at += 1
    return at


@part
def skip_word(text: UInt8Array, at: int) -> int:
    """Return the position behind the characters that are neither blank nor the end of the line."""
    while text[at] > BLANK:
        at += 1
    return at


@part
def skip_line(text: UInt8Array, at: int) -> int:
    while text[at] != NEWLINE:
        at += 1
    return at + 1


@part
def decimal(text: UInt8Array, at: int, most_digits: int) -> tuple[int, int]:
    """Read a number of up to so many digits; return it and the position behind it, which is ``at`` if there is none."""
    value, begin = 0, at
    while 48 <= text[at] <= 57 and at - begin < most_digits:
        value = value * 10 + text[at] - 48
        at += 1
    return value, at


@part
def decimal_parts(text: UInt8Array, at: int, whole: int, most_digits: int) -> tuple[int, int]:
    """Read digits behind a decimal point as parts of a whole, a power of ten; further digits are ignored."""
    value, begin = 0, at
    while 48 <= text[at] <= 57 and at - begin < most_digits:
        whole //= 10
        value += whole * (text[at] - 48)
        at += 1
    return value, at


@part
def digits(text: UInt8Array, at: int, base: int, most_digits: int) -> tuple[int, int]:
    """Read a number of up to so many digits in a base up to 16, as ``decimal``."""
    value, begin = 0, at
    while 0 <= HEX_VALUE[text[at]] < base and at - begin < most_digits:
        value = value * base + HEX_VALUE[text[at]]
        at += 1
    return value, at


@part
def whole_number(text: UInt8Array, at: int, base: int, most_digits: int) -> tuple[int, int]:
    """Read a number as ``digits`` does that ends before a blank, a comment or the line's end; -1, and stay, if not."""
    begin = at
    value, at = digits(text, begin, base, most_digits)
    is_ended = text[at] <= BLANK or (text[at] == SLASH and text[at + 1] == SLASH)
    return (value, at) if at > begin and is_ended else (-1, begin)


@part
def clear(data: UInt8Array, row: int, first: int) -> None:
    """Make the bytes of a row zero from a first one on; a slice takes ten times as long to compile."""
    for place in range(first, data.shape[1]):
        data[row, place] = 0


@part
def hex_bytes(text: UInt8Array, at: int, row: int, data: UInt8Array, limit: int, separator: int) -> tuple[int, int]:
    """Read bytes of two digits into a row until something else comes; return how many and the position behind them.

    Between two bytes the separator may stand. More bytes than the limit are not read; the rest of the row is zeros.
    """
    count = 0
    while count < limit and text[at] != NEWLINE:
        value = HEX_PAIR[text[at], text[at + 1]]
        if value < 0:
            break
        data[row, count] = value
        count += 1
        at += 2
        if text[at] == separator and HEX_VALUE[text[at + 1]] >= 0:
            at += 1
    clear(data, row, count)
    return count, at


@part
def count_line(progress: Int64Array, outcome: int, line: int) -> None:
    if outcome == SKIPPED:
        progress[SKIPPED_LINES] += 1
    elif outcome == MALFORMED:
        if progress[MALFORMED_LINES] == 0:
            progress[FIRST_MALFORMED] = line
        progress[MALFORMED_LINES] += 1


MOST_CHANNELS = 256
FNV_SEED, FNV_FACTOR = 0x0BF2_9CE4_8422_2325, 0x100_0000_01B3  # of FNV-1a with 64 bits
HASH_MASK = 2**60 - 1  # as many bits as signed numbers hold, in kernels and in Python
DIGITS_AT_END = re.compile(rb"\d{1,3}$")


class NameWords(NamedTuple):
    """Names for compiled readers, arrays of shape (256,)."""

    numbers: UInt8Array
    hashes: Int64Array


class ChannelNames:
    """Names of channels and their numbers: the digits at the end of the name, or what is free if those are taken.

    Past 256 names all further ones share the last number: so many are damage.
    """

    def __init__(self) -> None:
        self.words = NameWords(numbers=np.zeros(MOST_CHANNELS, np.uint8), hashes=np.zeros(MOST_CHANNELS, np.int64))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, name: bytes) -> None:
        """Give a new name a number."""
        index = min(self._count, MOST_CHANNELS - 1)
        digits_at_end = DIGITS_AT_END.search(name)
        numbers = set(self.words.numbers[:index].tolist())
        wanted = int(digits_at_end[0]) if digits_at_end else 0
        free = (
            number for number in (wanted, *range(MOST_CHANNELS)) if number < MOST_CHANNELS and number not in numbers
        )
        self.words.hashes[index] = name_hash(np.frombuffer(name, np.uint8), 0, len(name))
        self.words.numbers[index] = next(free, MOST_CHANNELS - 1)
        self._count = index + 1

    def number(self, name: bytes) -> int:
        """Return the number of a channel, which a new one gets."""
        text = np.frombuffer(name + b"\n", np.uint8)
        if channel_number(text, 0, self.words, len(self)) < 0:
            self.add(name)
        return max(channel_number(text, 0, self.words, len(self)), 0)


@part
def name_hash(text: UInt8Array, begin: int, stop: int) -> int:
    """Return the lower bits of the FNV-1a hash of the name that stands between two positions."""
    value = FNV_SEED
    for at in range(begin, stop):
        value = ((value ^ int(text[at])) * FNV_FACTOR) & HASH_MASK
    return value


class FrameRows(NamedTuple):
    """The columns of a buffer, as kernels take them: a row per frame."""

    t_ns: Int64Array
    can_id: UInt32Array
    length: UInt8Array
    flags: UInt8Array
    channel: UInt8Array
    data: UInt8Array  # (rows, 8), or (rows, 64) once a longer payload was met


def new_rows(count: int, width: int) -> FrameRows:
    """Return columns with anything in them."""
    return FrameRows(
        t_ns=np.empty(count, np.int64),
        can_id=np.empty(count, np.uint32),
        length=np.empty(count, np.uint8),
        flags=np.empty(count, np.uint8),
        channel=np.empty(count, np.uint8),
        data=np.empty((count, width), np.uint8),
    )


class FrameBuffer:
    """Columns that are reused for every block: freshly mapped memory is slow."""

    def __init__(self, count: int) -> None:
        self.rows = new_rows(count, PAYLOAD_BYTES)

    def reserve(self, count: int, used: int) -> None:
        """Make room for at least this many frames; what was in rows past those in use is lost."""
        if len(self.rows.t_ns) < count:
            larger = new_rows(count + used, self.rows.data.shape[1])
            for name in FrameRows._fields:
                getattr(larger, name)[:used] = getattr(self.rows, name)[:used]
            self.rows = larger

    def widen(self, used: int) -> None:
        """Make room for payloads of CAN FD, from now on."""
        data = np.empty((len(self.rows.t_ns), FD_PAYLOAD_BYTES), np.uint8)
        data[:used] = 0
        data[:used, : self.rows.data.shape[1]] = self.rows.data[:used]
        self.rows = self.rows._replace(data=data)

    def batch(self, count: int) -> FrameBatch:
        """Return the first rows, no wider than they need."""
        rows, width = self.rows, self.rows.data.shape[1]
        if width > PAYLOAD_BYTES and not (rows.flags[:count] & np.uint8(FD_FLAG)).any():
            width = PAYLOAD_BYTES
        return FrameBatch(
            t_ns=rows.t_ns[:count].copy(),
            can_id=rows.can_id[:count].copy(),
            length=rows.length[:count].copy(),
            data=rows.data[:count, :width].copy(),
            flags=rows.flags[:count].copy(),
            channel=rows.channel[:count].copy(),
        )


@part
def channel_number(text: UInt8Array, at: int, names: NameWords, known: int) -> int:
    """Return the number of the channel whose name stands here, -1 if it is new."""
    name = name_hash(text, at, skip_word(text, at))
    for index in range(known):
        if names.hashes[index] == name:
            return int(names.numbers[index])
    return -1
