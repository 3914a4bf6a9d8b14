"""Which frames of a batch carry which signals: those of one page of one message together."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from canlog.arrays import Int64Array, UInt8Array
from canlog.database.addressing import rows_by_slot
from canlog.decode.bit_fields import PayloadWords
from canlog.decode.codec import Codec
from canlog.decode.signal_table import Selector, SignalTable


@dataclass(frozen=True, slots=True)
class Carriers:
    """The frames that carry some signals of a message, and all of these signals."""

    slot: int  # of the message in the codec
    frames: Int64Array  # (n,) of the batch, rising
    words: PayloadWords  # (n,)
    signals: Mapping[str, SignalTable]


@dataclass(frozen=True, slots=True)
class CutOff:
    """Values of a signal that lie behind the end of short frames."""

    slot: int
    name: str
    count: int


def carriers(
    codec: Codec, slot: Int64Array, data: UInt8Array, length: UInt8Array | Int64Array
) -> Iterator[Carriers | CutOff]:
    """Yield what payloads carry, message by message; ``slot`` is what ``Codec.match`` says of each.

    ``data`` has a row of bytes for each, of which ``length`` were sent.
    """
    for number, rows in rows_by_slot(slot, len(codec.tables)):
        size = codec.tables[number].message.length
        sizes = length[rows]
        groups: dict[tuple[tuple[Selector, ...], int], dict[str, SignalTable]] = {}
        is_whole = bool(sizes.min() >= size)
        for name, table in codec.tables[number].signals.items():
            needed = 0 if is_whole else table.needed_bytes
            groups.setdefault((table.selectors, needed), {})[name] = table
        shared = PayloadWords(data, rows)  # by all that need no selection
        for (selectors, needed), signals in groups.items():
            frames, words = rows, shared
            if needed and needed > int(sizes.min()):
                frames = rows[sizes >= needed]
                words = PayloadWords(data, frames)
            if selectors:
                frames = frames[next(iter(signals.values())).presence(words)]
                words = PayloadWords(data, frames)
            yield Carriers(number, frames, words, signals)
        if not is_whole:
            short = rows[sizes < size]
            for each in np.unique(length[short]).tolist():
                words = PayloadWords(data, short[length[short] == each])
                yield from _cut_off(number, codec.tables[number].signals, words, each)


def _cut_off(slot: int, signals: Mapping[str, SignalTable], words: PayloadWords, size: int) -> Iterator[CutOff]:
    """Yield what payloads of some size do not hold."""
    for name, table in signals.items():
        if not table.fits(size):
            yield CutOff(slot, name, table.cut_off_count(words, size))
