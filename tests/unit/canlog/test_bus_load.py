"""What frames take of a bus: one estimate for logs and live buses, near what bit by bit was on the wire."""

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from canlog.live import SupervisedSource
from canlog.logs import read_log
from canlog.traffic import TrafficMeter, frame_bits
from tests.unit.canlog.live.test_supervisor import Script, ShortSource, numbered, parts_of

RECORDINGS: Final = Path(__file__).parents[2] / "golden" / "recordings"
CRC_POLYNOMIAL: Final = 0x4599  # ISO 11898-1, 15 bits
TAIL_BITS: Final = 13
BITRATE: Final = 500_000
EVERY: Final = 97  # frames of a recording; the neighbour of a frame is of another message


def number_bits(number: int, count: int) -> list[int]:
    return [number >> place & 1 for place in reversed(range(count))]


def sent_bits(can_id: int, payload: bytes) -> int:
    """Return the exact length of a classic data frame on the wire, space behind it included, bit by bit."""
    if can_id & EXTENDED_FLAG:
        head = [0, *number_bits(can_id >> 18 & 0x7FF, 11), 1, 1, *number_bits(can_id & 0x3FFFF, 18), 0, 0, 0]
    else:
        head = [0, *number_bits(can_id & 0x7FF, 11), 0, 0, 0]
    bits = [*head, *number_bits(len(payload), 4), *(bit for byte in payload for bit in number_bits(byte, 8))]
    crc = 0
    for bit in bits:
        crc = crc << 1 ^ CRC_POLYNOMIAL if bit ^ crc >> 14 & 1 else crc << 1
        crc &= 0x7FFF
    bits += number_bits(crc, 15)
    stuffed, last, run = 0, -1, 0
    for bit in bits:
        last, run = bit, run + 1 if bit == last else 1
        if run == 5:
            stuffed, last, run = stuffed + 1, 1 - bit, 1
    return len(bits) + stuffed + TAIL_BITS


@pytest.mark.parametrize("name", ["ideal", "foreign", "j1939", "faults"])
def test_the_estimate_is_near_what_was_on_the_wire(name: str) -> None:
    batch = next(read_log(RECORDINGS / f"{name}.log.xz"))[::EVERY]
    batch = batch[(batch.can_id & np.uint32(ERROR_FLAG | REMOTE_FLAG)) == 0]
    payloads = [row.tobytes()[:length] for row, length in zip(batch.data, batch.length.tolist(), strict=True)]
    exact = sum(sent_bits(can_id, payload) for can_id, payload in zip(batch.can_id.tolist(), payloads, strict=True))
    assert float(frame_bits(batch).sum()) == pytest.approx(exact, rel=0.04)


async def test_a_live_bus_and_a_log_of_it_have_the_same_load() -> None:
    batches = [numbered(*range(0, 10**9, 10**7)), numbered(10**9, flags=EXTENDED_FLAG)]
    source = SupervisedSource(Script(), ShortSource(*batches))
    await parts_of(source, 2)
    meter = TrafficMeter(BITRATE)
    for batch in batches:
        meter.add(batch)
    assert source.bit_count / BITRATE == pytest.approx(meter.report().bus_load_ratio)  # over one second
