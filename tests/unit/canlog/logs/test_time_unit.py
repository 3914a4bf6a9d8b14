"""The load that times mean: what no bus can have tells a wrong unit."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.frames import EXTENDED_FLAG, FD_FLAG, FrameBatch
from canlog.logs.log_counts import MICROSECONDS, MILLISECONDS, SECONDS, bus_load_ratio, is_plausible, likely_unit
from tests.support.batches import frames_at


def batch_of(gap_us: float, count: int = 100, *, length: int = 8, can_id: int = 0x123, flags: int = 0) -> FrameBatch:
    t_ns = np.rint(np.arange(count) * gap_us * 1e3)
    return frames_at(t_ns, can_id, length, np.zeros(64 if flags else 8), flags=flags)


def test_the_load_of_known_traffic() -> None:
    assert bus_load_ratio(batch_of(111.0)) == pytest.approx(1.0)  # 47 bits and 64 of payload
    assert bus_load_ratio(batch_of(131.0, can_id=EXTENDED_FLAG)) == pytest.approx(1.0)
    assert bus_load_ratio(batch_of(87.5, length=64, flags=FD_FLAG)) == pytest.approx(1.0)
    assert bus_load_ratio(batch_of(0.0)) == float("inf")
    assert bus_load_ratio(batch_of(0.001, count=9)) == 0.0


def test_channels_do_not_add_up() -> None:
    one = batch_of(150.0)
    two = replace(one[np.repeat(np.arange(len(one)), 2)], channel=np.tile(np.array([0, 1], np.uint8), len(one)))
    assert bus_load_ratio(two) == pytest.approx(bus_load_ratio(one))


@pytest.mark.parametrize(
    ("gap_us", "unit"),
    [
        (111.0, MICROSECONDS), (1e6, MICROSECONDS), (60.0, MICROSECONDS), (10.0, MILLISECONDS), (0.2, MILLISECONDS),
        (0.01, SECONDS), (0.001, SECONDS),
    ],
)  # fmt: skip
def test_the_finest_unit_with_which_the_load_is_possible(gap_us: float, unit: int) -> None:
    found, notes = likely_unit(batch_of(gap_us, count=2_000))
    assert found == unit
    assert bool(notes) == (unit != MICROSECONDS)


def test_times_that_stand_still_have_no_unit() -> None:
    assert likely_unit(batch_of(0.0)) == (MICROSECONDS, [])
    assert not is_plausible(bus_load_ratio(batch_of(0.0)))
