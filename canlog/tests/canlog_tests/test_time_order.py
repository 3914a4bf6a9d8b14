"""Late frames are put in order, the same for any cutting; other recordings stay where they are."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.frames import COLUMNS, FrameBatch, join
from canlog.time_order import HELD_FRAMES, LATE_NS, TimeOrder, in_order

MS = 1_000_000


def frames(t_ns: list[int]) -> FrameBatch:
    """Return frames at some times, each with its place as payload."""
    count = len(t_ns)
    place = np.arange(count, dtype=">u8").view(np.uint8).reshape(count, 8)
    return FrameBatch(
        t_ns=np.array(t_ns, np.int64),
        can_id=np.arange(count, dtype=np.uint32) % 5,
        length=np.full(count, 8, np.uint8),
        data=place,
    )


def ordered(batch: FrameBatch, cuts: list[int]) -> tuple[FrameBatch, TimeOrder]:
    order = TimeOrder()
    batches = [batch[first:end] for first, end in pairwise([0, *cuts, len(batch)])]
    return join(list(order.ordered(iter(batches)))), order


def same(batch: FrameBatch, other: FrameBatch) -> bool:
    return all(np.array_equal(getattr(batch, name), getattr(other, name)) for name in COLUMNS)


@given(
    times=st.lists(st.integers(0, 3_000), min_size=1, max_size=60),
    delays=st.lists(st.integers(0, 99), min_size=60, max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=6),
)
def test_no_cutting_changes_what_comes_out(times: list[int], delays: list[int], cuts: list[int]) -> None:
    """Times in ms; delays say where a frame stands, so that no frame is later than the limit."""
    places = np.array(sorted(times)) + np.array(delays[: len(times)])
    late = frames([MS * sorted(times)[row] for row in np.argsort(places, kind="stable")])
    whole, order = ordered(late, [])
    cut, other = ordered(late, sorted(min(at, len(late)) for at in cuts))
    assert same(whole, cut)
    assert whole.t_ns.tolist() == sorted(late.t_ns.tolist())
    assert (order.late_count, order.most_late_ns) == (other.late_count, other.most_late_ns)
    assert order.most_late_ns <= LATE_NS


def test_frames_of_one_time_keep_their_order_unless_one_of_them_was_late() -> None:
    assert same(in_order(frames([5, 5, 5, 6]))[0], frames([5, 5, 5, 6]))
    late, late_ns = in_order(frames([5, 6, 6, 5, 5]))
    assert late.t_ns.tolist() == [5, 5, 5, 6, 6]
    assert late.can_id.tolist() == [0, 3, 4, 1, 2]
    assert late_ns.tolist() == [1, 1]
    reverse = in_order(frames([5, 6, 6, 5, 5])[np.array([4, 2, 3, 1, 0])])[0]
    assert reverse.can_id.tolist() == [0, 3, 4, 2, 1]  # those at 6 were in time: as they stand


@pytest.mark.parametrize("cuts", [[], [3], [2, 4, 5]])
def test_a_longer_step_back_is_another_recording(cuts: list[int]) -> None:
    times = [1_000 * MS, 1_002 * MS, 1_001 * MS, 500 * MS, 499 * MS, 501 * MS]
    whole, order = ordered(frames(times), cuts)
    assert [t_ns // MS for t_ns in whole.t_ns.tolist()] == [1_000, 1_001, 1_002, 499, 500, 501]
    assert (order.late_count, order.most_late_ns) == (2, MS)


def test_what_is_held_back_is_bounded() -> None:
    order, batch = TimeOrder(), frames([7] * 40_000)
    sizes = [len(part) for part in order.ordered(iter([batch] * 5))]
    assert sum(sizes) == 200_000
    assert max(sizes) <= HELD_FRAMES


def test_few_frames_wait_for_more_but_for_whoever_waits_for_them() -> None:
    batch = frames([LATE_NS * number for number in range(100)])
    parts = [batch[begin : begin + 10] for begin in range(0, 100, 10)]
    at_once, together = TimeOrder(), TimeOrder(40)
    assert [len(one) for one in at_once.ordered(iter(parts))] == [8, *[10] * 9, 2]
    assert [len(one) for one in together.ordered(iter(parts))] == [48, 40, 12]
    late = frames([5, 3, *(LATE_NS * number for number in range(1, 60))])
    assert join(list(TimeOrder(40).ordered(iter([late[:30], late[30:]])))).t_ns.tolist() == sorted(late.t_ns.tolist())
