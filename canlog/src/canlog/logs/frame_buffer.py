"""Columns that compiled readers fill row by row, and the names of their channels."""

import re
from typing import NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array, UInt32Array
from canlog.frames import FD_FLAG, FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.jit import part
from canlog.logs.text_kernels import skip_word

MOST_CHANNELS = 256
FNV_SEED, FNV_FACTOR = 0x0BF2_9CE4_8422_2325, 0x100_0000_01B3  # of FNV-1a with 64 bits
HASH_MASK = 2**60 - 1  # the bits of it that are kept: as many as signed numbers hold, in kernels and in Python
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
        self.words = NameWords(
            numbers=np.zeros(MOST_CHANNELS, np.uint8),
            hashes=np.zeros(MOST_CHANNELS, np.int64),
        )
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, name: bytes) -> None:
        """Give a new name a number."""
        index = min(self._count, MOST_CHANNELS - 1)
        found = DIGITS_AT_END.search(name)
        taken = set(self.words.numbers[:index].tolist())
        wanted = int(found[0]) if found else 0
        free = (number for number in (wanted, *range(MOST_CHANNELS)) if number < MOST_CHANNELS and number not in taken)
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


LEAST_HANDED_OVER = 0.75  # of a buffer: what is not used of it is kept as long as the batch


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

    def handed_over(self, count: int) -> FrameBatch:
        """Return the first rows as ``batch`` does, without a copy if they are most of the buffer: it gets new ones."""
        if count < LEAST_HANDED_OVER * len(self.rows.t_ns):
            return self.batch(count)
        batch = self.batch(count, is_copied=False)
        self.rows = new_rows(*self.rows.data.shape)
        return batch

    def batch(self, count: int, *, is_copied: bool = True) -> FrameBatch:
        """Return the first rows, no wider than they need."""
        rows, width = self.rows, self.rows.data.shape[1]
        if width > PAYLOAD_BYTES and not (rows.flags[:count] & np.uint8(FD_FLAG)).any():
            width = PAYLOAD_BYTES
        return FrameBatch(
            t_ns=np.array(rows.t_ns[:count], copy=is_copied),
            can_id=np.array(rows.can_id[:count], copy=is_copied),
            length=np.array(rows.length[:count], copy=is_copied),
            data=np.array(rows.data[:count, :width], copy=is_copied or width < rows.data.shape[1]),
            flags=np.array(rows.flags[:count], copy=is_copied),
            channel=np.array(rows.channel[:count], copy=is_copied),
        )


@part
def channel_number(text: UInt8Array, at: int, names: NameWords, known: int) -> int:
    """Return the number of the channel whose name stands here, -1 if it is new."""
    name = name_hash(text, at, skip_word(text, at))
    for index in range(known):
        if names.hashes[index] == name:
            return int(names.numbers[index])
    return -1
