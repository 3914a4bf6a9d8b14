"""In which order results leave: today's first, then the oldest, each once, none left out."""

from collections.abc import Iterator
from contextlib import closing

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diag_service.delivery.delivery import SendPriority
from diag_service.store import ResultStore, VehicleState, Versions
from tests.support.builders import shift_result

STATE = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


def put(store: ResultStore, first: int, last: int) -> None:
    for seq in range(first, last + 1):
        store.add(shift_result(seq), STATE)


def handed_out(priority: SendPriority, limit: int) -> list[int]:
    return [row.key.seq for row in priority.next(limit)]


def test_what_happens_now_goes_first_but_does_not_stop_the_backlog(store: ResultStore) -> None:
    put(store, 1, 20)
    priority = SendPriority(store, "car1")
    put(store, 21, 30)
    assert handed_out(priority, 8) == [21, 22, 23, 24, 25, 26, 1, 2]
    assert handed_out(priority, 8) == [27, 28, 29, 30, 3, 4, 5, 6]
    assert [row.key.seq for row in priority.next_fresh(8)] == []


@settings(deadline=None)
@given(backlog=st.integers(0, 30), steps=st.lists(st.tuples(st.integers(0, 6), st.integers(1, 9)), max_size=8))
def test_everything_is_handed_out_once(backlog: int, steps: list[tuple[int, int]]) -> None:
    with closing(ResultStore.in_memory()) as store:
        put(store, 1, backlog)
        priority, seen, last = SendPriority(store, "car1"), list[int](), backlog
        for added, limit in steps:
            put(store, last + 1, last + added)
            last += added
            taken = handed_out(priority, limit)
            assert len(taken) <= limit
            seen += taken
        while taken := handed_out(priority, 7):
            seen += taken
        assert sorted(seen) == list(range(1, last + 1))
