"""The rows of the latest samples: what is appended is found again until it is forgotten, however often rows move."""

import numpy as np
import pytest

from canlog.arrays import Series
from canlog.frames import BEFORE_ALL_NS
from diag_service.diagnosis.columns import BlockLayout, SampleBlock, Signal
from diag_service.diagnosis.shifts.history import FIRST_CAPACITY, SampleRings

SIGNALS = (Signal.ENGINE_SPEED, Signal.ENGINE_TORQUE, Signal.CURRENT_GEAR)


def series(first: int, count: int) -> Series:
    rows = np.arange(first, first + count, dtype=np.int64)
    return Series(t_ns=10 * rows, sequence=rows, value=rows.astype(np.float64) / 2.0, period_ns=10)


def block(layout: BlockLayout, first: int, counts: tuple[int, ...]) -> SampleBlock:
    room = layout.room(max(counts))
    for row, count in enumerate(counts):
        own = series(first, count)
        room.filled[row] = count
        room.t_ns[row, :count], room.sequence[row, :count], room.value[row, :count] = own.t_ns, own.sequence, own.value
    return SampleBlock(layout, room)


def assert_holds(rings: SampleRings, signal: Signal, first: int, stop: int) -> None:
    found, wanted = rings.between(signal, 10 * first, 10 * stop), series(first, stop - first)
    assert found.t_ns.tolist() == wanted.t_ns.tolist()
    assert found.sequence.tolist() == wanted.sequence.tolist()
    assert found.value.tolist() == wanted.value.tolist()
    assert found.period_ns == 10


@pytest.mark.parametrize("as_blocks", [True, False])
def test_a_window_moves_along_a_long_stream_in_bounded_memory(as_blocks: bool) -> None:
    rings, layout, window = SampleRings(), BlockLayout(SIGNALS, (10, 10, 10)), FIRST_CAPACITY // 4
    for first in range(0, 20 * FIRST_CAPACITY, 5):
        columns = {signal: series(first, 5) for signal in SIGNALS}
        rings.append(block(layout, first, (5, 5, 5)) if as_blocks else columns)
        rings.drop_before(10 * (first + 5 - window))
        for signal in SIGNALS:
            assert_holds(rings, signal, max(0, first + 5 - window), first + 5)
    assert rings.sample_count == len(SIGNALS) * window


def test_rows_grow_as_they_must() -> None:
    rings, layout = SampleRings(), BlockLayout(SIGNALS[:2], (10, 10))
    rings.append({SIGNALS[2]: series(0, 10 * FIRST_CAPACITY)})
    for first in range(0, 3 * FIRST_CAPACITY, 100):
        rings.append(block(layout, first, (100, 100)))
    assert_holds(rings, SIGNALS[2], 0, 10 * FIRST_CAPACITY)
    assert_holds(rings, SIGNALS[0], 0, 3 * FIRST_CAPACITY)


def test_a_signal_is_known_from_its_first_sample_on_and_stays_known() -> None:
    rings, layout = SampleRings(), BlockLayout(SIGNALS, (10, 10, 10))
    rings.append(block(layout, 0, (3, 0, 1)))
    assert list(rings.cut(0, 0)) == [SIGNALS[0], SIGNALS[2]]
    for first in range(3, 2 * FIRST_CAPACITY):
        rings.drop_before(10 * first)
        rings.append(block(layout, first, (1, 0, 0)))
    assert list(rings.cut(0, 0)) == [SIGNALS[0], SIGNALS[2]]
    assert len(rings.between(SIGNALS[2], 0, 10**9).t_ns) == len(rings.between(SIGNALS[1], 0, 10**9).t_ns) == 0
    rings.clear()
    assert not rings.cut(0, 0)


@pytest.mark.parametrize("as_blocks", [True, False])
def test_the_last_change_of_a_value_is_known(as_blocks: bool) -> None:
    rings, layout, gear = SampleRings(), BlockLayout(SIGNALS[2:], (10,)), SIGNALS[2]
    assert rings.changed_ns(gear) == BEFORE_ALL_NS
    changes, values = [], [3.0, 3.0, 4.0, 4.0, 4.0, 3.0, 3.0]
    for row, value in enumerate(values):
        room = layout.room(1)
        room.filled[0], room.t_ns[0, 0], room.sequence[0, 0], room.value[0, 0] = 1, 10 * row, row, value
        one = SampleBlock(layout, room)
        rings.append(one if as_blocks else dict(one))
        rings.drop_before(10 * row)  # what it is compared with may have been forgotten
        changes.append(rings.changed_ns(gear))
    assert changes == [0, 0, 20, 20, 20, 50, 50]
    rings.clear()
    assert rings.changed_ns(gear) == BEFORE_ALL_NS


def test_a_cut_has_what_lies_between_and_is_not_touched_later() -> None:
    rings, layout = SampleRings(), BlockLayout(SIGNALS, (10, 10, 10))
    rings.append(block(layout, 0, (20, 20, 0)))
    cut = rings.cut(50, 151)
    assert list(cut) == list(SIGNALS[:2])
    for signal, found in cut.items():
        wanted = rings.between(signal, 50, 151)
        assert found.t_ns.tolist() == wanted.t_ns.tolist() == [10 * row for row in range(5, 16)]
        assert found.value.tolist() == wanted.value.tolist()
        assert found.sequence.tolist() == wanted.sequence.tolist()
    for first in range(20, 4 * FIRST_CAPACITY):
        rings.drop_before(10 * (first - 5))
        rings.append(block(layout, first, (1, 1, 0)))
    assert all(found.t_ns.tolist() == [10 * row for row in range(5, 16)] for found in cut.values())
