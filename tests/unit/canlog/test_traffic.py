"""Traffic measured: rates, jitter, gaps, jumps and load, the same for any cutting of the stream."""

from itertools import pairwise

import numpy as np
import pytest

from canlog.arrays import Int64Array
from canlog.frames import FrameBatch
from canlog.traffic import IdTraffic, TrafficMeter, TrafficReport
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
