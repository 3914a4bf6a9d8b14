"""Arbitrary CAN traffic for tests of buses and logs, and the same frames as either end holds them."""

import numpy as np

from canlog.frames import FrameBatch, join
from ecu_emulator.bus.frames import EncodedFrames

START_NS = 1_767_225_600_123_456_000  # 2026-01-01T00:00:00.123456Z: not on a whole millisecond


def random_frames(count: int, seed: int = 1, mean_gap_s: float = 0.0015) -> EncodedFrames:
    """Return frames of all lengths, a fifth of them extended, at times in whole microseconds that do not decrease."""
    rng = np.random.default_rng(seed)
    can_id = rng.integers(0, 0x800, count).astype(np.uint32)
    is_extended = rng.random(count) < 0.2
    extended_id = rng.integers(0, 0x2000_0000, count).astype(np.uint32) | np.uint32(0x8000_0000)
    length = rng.integers(0, 9, count).astype(np.uint8)
    data = rng.integers(0, 256, (count, 8)).astype(np.uint8)
    data[np.arange(8) >= length[:, None]] = 0
    return EncodedFrames(
        t_s=np.cumsum(rng.integers(0, int(2e6 * mean_gap_s), count)) / 1e6,
        can_id=np.where(is_extended, extended_id, can_id),
        length=length,
        data=data,
    )


def as_received(frames: EncodedFrames, start_ns: int = START_NS) -> FrameBatch:
    """Return the batch that a log of these frames holds."""
    return FrameBatch(
        t_ns=start_ns + np.rint(frames.t_s * 1e6).astype(np.int64) * 1000,
        can_id=frames.can_id,
        length=frames.length,
        data=frames.data,
    )


def assert_same(actual: FrameBatch | list[FrameBatch], expected: FrameBatch) -> None:
    """Compare times, identifiers, lengths and payloads, bit for bit."""
    batch = join(actual) if isinstance(actual, list) else actual
    assert_same_contents(batch, expected)
    assert np.array_equal(batch.t_ns, expected.t_ns)


def assert_same_contents(batch: FrameBatch, expected: FrameBatch) -> None:
    """Compare everything but the times."""
    assert len(batch) == len(expected)
    assert np.array_equal(batch.can_id, expected.can_id)
    assert np.array_equal(batch.length, expected.length)
    assert np.array_equal(batch.data, expected.data)
    assert np.array_equal(batch.flags, expected.flags)
    columns = (batch.t_ns, batch.can_id, batch.length, batch.data, batch.flags, batch.channel)
    assert [column.dtype.name for column in columns] == ["int64", "uint32", "uint8", "uint8", "uint8", "uint8"]
