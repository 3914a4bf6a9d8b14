"""Messages longer than a frame: whole from whole logs, right or left out from logs with holes, never invented."""

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.isotp import Reassembler, Transfer
from tests.support.transport_traffic import MAKERS, PAIRS, Sent, batch_of, generator

LOST_RATIO = 0.05


def found_in(frames: list[Sent], cuts: list[int]) -> list[Transfer]:
    """Return the messages in some frames that come in batches cut anywhere."""
    reassembler, found = Reassembler(PAIRS), list[Transfer]()
    edges = sorted({0, len(frames), *(cut % (len(frames) + 1) for cut in cuts)})
    for first, last in pairwise(edges):
        found += reassembler.feed(batch_of(frames[first:last]))
    return found


@pytest.mark.parametrize("name", MAKERS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1 << 30), cuts=st.lists(st.integers(0, 1 << 20), max_size=4))
def test_every_message_of_a_whole_log_is_put_together(name: str, seed: int, cuts: list[int]) -> None:
    traffic = MAKERS[name](generator(seed), 24)
    found = found_in(list(traffic.frames), cuts)
    assert [(one.can_id, one.data) for one in found] == list(traffic.messages)
    assert all(one.first_ns <= one.last_ns for one in found)


@pytest.mark.parametrize("name", MAKERS)
@settings(max_examples=25, deadline=None, derandomize=True)  # chance: numbers of two messages may fit each other
@given(seed=st.integers(0, 1 << 30))
def test_with_lost_frames_every_message_is_right_or_left_out(name: str, seed: int) -> None:
    rng = generator(seed)
    traffic = MAKERS[name](rng, 40)
    kept = [one for one in traffic.frames if rng.random() >= LOST_RATIO]
    left = set(kept)
    broken = {one.message for one in traffic.frames if not one.is_answer and one not in left}
    whole = Counter(message for number, message in enumerate(traffic.messages) if number not in broken)
    right = Counter((one.can_id, one.data) for one in found_in(kept, [seed]))
    assert whole <= right <= Counter(traffic.messages)
