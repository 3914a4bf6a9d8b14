"""Channels that a log names, as numbers."""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.logs.word_kernels import WORD_BYTES, UInt64Array

MOST_CHANNELS = 256
FNV_SEED = 0xCBF2_9CE4_8422_2325
FNV_FACTOR = 0x100_0000_01B3
NO_NAME = 0xFFFF_FFFF_FFFF_FFFF  # as a word: eight bytes that no text has
DIGITS_AT_END = re.compile(rb"\d{1,3}$")


class NameWords(NamedTuple):
    """Names for compiled readers, arrays of shape (256,): as hashes, and short ones as the words a line has them in."""

    numbers: UInt8Array
    hashes: Int64Array
    words: UInt64Array  # the name and the blank behind it
    masks: UInt64Array  # of the bytes that these are; a name too long for a word has no byte that a line could match
    bytes: Int64Array  # how many these are


def _no_names() -> NameWords:
    count = MOST_CHANNELS
    return NameWords(
        numbers=np.zeros(count, np.uint8),
        hashes=np.zeros(count, np.int64),
        words=np.full(count, NO_NAME, np.uint64),
        masks=np.full(count, NO_NAME, np.uint64),
        bytes=np.zeros(count, np.int64),
    )


@dataclass(slots=True)
class ChannelNames:
    """Names of channels and their numbers: the digits at the end of the name, or what is free if those are taken.

    Past 256 names all further ones share the last number: so many are damage.
    """

    words: NameWords = field(default_factory=_no_names)
    _count: int = 0

    def __len__(self) -> int:
        return self._count

    def add(self, name: bytes) -> None:
        """Give a new name a number."""
        index = min(self._count, MOST_CHANNELS - 1)
        found = DIGITS_AT_END.search(name)
        taken = set(self.words.numbers[:index].tolist())
        wanted = int(found[0]) if found else 0
        free = (number for number in (wanted, *range(MOST_CHANNELS)) if number < MOST_CHANNELS and number not in taken)
        self.words.hashes[index] = name_hash(name)
        self.words.numbers[index] = next(free, MOST_CHANNELS - 1)
        self.words.words[index] = self.words.masks[index] = NO_NAME
        if len(name) < WORD_BYTES:
            spelled = name + b" "
            self.words.words[index] = int.from_bytes(spelled, "little")
            self.words.masks[index] = 256 ** len(spelled) - 1
            self.words.bytes[index] = len(spelled)
        self._count = index + 1


def name_hash(name: bytes) -> int:
    """Return the FNV-1a hash of a name as a signed number of 64 bits."""
    value = FNV_SEED
    for character in name:
        value = (value ^ character) * FNV_FACTOR & 0xFFFF_FFFF_FFFF_FFFF
    return value - (1 << 64) if value >> 63 else value
