"""Where a signal lies: the bits of its mask, and no others, make its raw value."""

from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message, Signal

from canlog.decode.bit_fields import BitField, PayloadWords, place_signal
from tests.wire import DATABASE

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


@pytest.mark.parametrize(("message", "signal"), FIELDS)
def test_masked_bits_make_the_value_and_no_others(message: Message, signal: Signal) -> None:
    field, size = place_signal(message, signal), message.length
    mask = int.from_bytes(field.payload_mask.ljust(size, b"\0"), "little")
    assert mask.bit_length() <= 8 * size
    for seed in range(3):
        payload = int.from_bytes(np.random.default_rng(seed).bytes(size), "little")
        bits = [1 << place for place in range(8 * size)]
        raw, *flipped = raws(field, [word.to_bytes(size, "little") for word in (payload, *(payload ^ b for b in bits))])
        changing = sum(bit for bit, other in zip(bits, flipped, strict=True) if other != raw)
        assert changing & ~mask == 0
        if not field.spill:
            assert changing == mask
