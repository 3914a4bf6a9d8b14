"""Traffic measured: rates, jitter, gaps and load, the same for any cutting of the stream."""

from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from canlog.arrays import Int64Array
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.live import SupervisedSource
from canlog.logs import read_log
from canlog.traffic import IdTraffic, TrafficMeter, TrafficReport, frame_bits
from canlog_tests.live.test_supervisor import Script, ShortSource, numbered, parts_of
from tests.support.batches import frames_at

MS = 1_000_000
START_NS = 1_700_000_000_000_000_000


def frames(t_ns: Int64Array, can_id: int = 0x100, length: int = 8, flags: int = 0, channel: int = 0) -> FrameBatch:
    return frames_at(START_NS + np.asarray(t_ns), can_id, length, flags=flags, channel=channel)


def measured(*batches: FrameBatch, bitrate: int = 500_000) -> TrafficReport:
    meter = TrafficMeter(bitrate)
    for batch in batches:
        meter.add(batch)
    return meter.report()


def only_id(*batches: FrameBatch) -> IdTraffic:
    (found,) = measured(*batches).ids
    return found


def test_a_steady_message() -> None:
    found = only_id(frames(np.arange(1000) * 10 * MS))
    assert (found.count, found.length, found.gap_count, found.longest_gap_s) == (1000, 8, 0, 0.0)
    assert found.rate_hz == pytest.approx(100.0)
    assert found.period_s == pytest.approx(0.010)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-8)


def test_missing_frames_are_gaps_and_no_jitter() -> None:
    kept = np.delete(np.arange(1000), [*range(200, 205), *range(500, 510)])
    found = only_id(frames(kept * 10 * MS))
    assert found.gap_count == 2
    assert found.longest_gap_s == pytest.approx(0.110)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_cutting_the_stream_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 400
    steps = rng.choice([0, MS, 10 * MS, 400 * MS, 2000 * MS, -50 * MS], count, p=[0.1, 0.4, 0.4, 0.05, 0.03, 0.02])
    batch = frames_at(START_NS + np.cumsum(steps), rng.integers(1, 5, count), rng.integers(0, 9, count))
    cuts = [0, *sorted(set(rng.integers(1, count, 12).tolist())), count]
    whole = measured(batch)
    pieces = measured(*(batch[first:last] for first, last in pairwise(cuts)))
    assert pieces.bus_load_ratio == pytest.approx(whole.bus_load_ratio)
    assert pieces.peak_load_ratio == pytest.approx(whole.peak_load_ratio)
    assert pieces.jumps == whole.jumps
    for one, other in zip(pieces.ids, whole.ids, strict=True):
        assert (one.can_id, one.count, one.gap_count, one.longest_gap_s) == (
            other.can_id,
            other.count,
            other.gap_count,
            other.longest_gap_s,
        )
        assert one.rate_hz == pytest.approx(other.rate_hz)
        assert one.jitter_s == pytest.approx(other.jitter_s, abs=1e-8)


RECORDINGS: Final = Path(__file__).parents[3] / "tests" / "golden" / "recordings"
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
