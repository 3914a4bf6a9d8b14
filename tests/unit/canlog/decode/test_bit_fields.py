"""Where a signal lies: the bits that the database gives it, and no others, make its raw value."""

from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message, Signal

from canlog.decode.signals import BitField, PayloadWords, place_signal
from tests.support.wire import DATABASE

CORNERS: Final = cantools.database.load_file(Path(__file__).parents[3] / "data" / "corners.dbc", strict=False)
assert isinstance(CORNERS, Database)
FIELDS: Final = [
    pytest.param(message, signal, id=f"{message.name}.{signal.name}")
    for message in (*CORNERS.messages, *DATABASE.messages)
    for signal in message.signals
]


def raws(field: BitField, payloads: list[bytes]) -> list[int]:
    data = np.frombuffer(b"".join(payloads), np.uint8).reshape(len(payloads), -1)
    return [int(raw) for raw in field.raw(PayloadWords(data))]


def bits_of(signal: Signal) -> int:
    """Return the bits of a signal, counted as the format does: little-endian upwards, big-endian from the highest."""
    if signal.byte_order == "little_endian":
        return sum(1 << (signal.start + step) for step in range(signal.length))
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    return sum(1 << (8 * (place // 8) + 7 - place % 8) for place in range(first, first + signal.length))


@pytest.mark.parametrize(("message", "signal"), FIELDS)
def test_the_bits_of_a_signal_make_its_value_and_no_others(message: Message, signal: Signal) -> None:
    field, size = place_signal(message, signal), message.length
    for seed in range(3):
        payload = int.from_bytes(np.random.default_rng(seed).bytes(size), "little")
        bits = [1 << place for place in range(8 * size)]
        raw, *flipped = raws(field, [word.to_bytes(size, "little") for word in (payload, *(payload ^ b for b in bits))])
        assert sum(bit for bit, other in zip(bits, flipped, strict=True) if other != raw) == bits_of(signal)
