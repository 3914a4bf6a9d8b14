"""Channels that a log names, as numbers."""

import re
from dataclasses import dataclass, field

import numpy as np

from diag_service.records import Int64Array, UInt8Array

MOST_CHANNELS = 256
FNV_SEED = 0xCBF2_9CE4_8422_2325
FNV_FACTOR = 0x100_0000_01B3
DIGITS_AT_END = re.compile(rb"\d{1,3}$")


@dataclass(slots=True)
class ChannelNames:
    """Names of channels and their numbers: the digits at the end of the name, or what is free if those are taken.

    The arrays are for compiled readers, which know a name by its hash. Past 256 names all further ones share the last
    number: so many are damage.
    """

    hashes: Int64Array = field(default_factory=lambda: np.zeros(MOST_CHANNELS, np.int64))
    numbers: UInt8Array = field(default_factory=lambda: np.zeros(MOST_CHANNELS, np.uint8))
    _count: int = 0

    def __len__(self) -> int:
        return self._count

    def add(self, name: bytes) -> None:
        """Give a new name a number."""
        index = min(self._count, MOST_CHANNELS - 1)
        found = DIGITS_AT_END.search(name)
        taken = set(self.numbers[:index].tolist())
        wanted = int(found[0]) if found else 0
        free = (number for number in (wanted, *range(MOST_CHANNELS)) if number < MOST_CHANNELS and number not in taken)
        self.hashes[index] = name_hash(name)
        self.numbers[index] = next(free, MOST_CHANNELS - 1)
        self._count = index + 1


def name_hash(name: bytes) -> int:
    """Return the FNV-1a hash of a name as a signed number of 64 bits."""
    value = FNV_SEED
    for character in name:
        value = (value ^ character) * FNV_FACTOR & 0xFFFF_FFFF_FFFF_FFFF
    return value - (1 << 64) if value >> 63 else value
