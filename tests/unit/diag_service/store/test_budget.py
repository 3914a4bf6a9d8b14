"""The disk budget: what goes first, what is never given up, and the count of it."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from clutch_results.records import ShiftResult
from diag_service.store import ResultStore, VehicleState, Versions
from tests.support.builders import rejected, shift_result

STATE = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
BUDGET_BYTES = 600_000


@pytest.fixture(name="store")
def _store(tmp_path: Path) -> Iterator[ResultStore]:
    with closing(ResultStore.open(tmp_path / "car.sqlite", BUDGET_BYTES)) as store:
        yield store


def long_result(seq: int, *, is_empty: bool = False) -> ShiftResult:
    """Return a result of some 20 kB, so that a few fill the budget."""
    result = shift_result(seq)
    result = replace(result, verdict=replace(result.verdict, reason="x" * 20_000))
    return rejected(result) if is_empty else result


def kept(store: ResultStore) -> list[int]:
    return [result.seq for result in store.results("car1")]


def test_what_is_delivered_goes_first_then_what_is_empty_then_the_oldest(store: ResultStore) -> None:
    for seq in range(1, 21):
        store.add(long_result(seq, is_empty=11 <= seq <= 15), STATE)
    store.mark_published(range(6, 11))
    seq = 20
    while not store.dropped_counts()["delivered"]:
        store.add(long_result(seq := seq + 1), STATE)
    assert kept(store) == [*range(1, 6), *range(11, seq + 1)]
    while not store.dropped_counts()["empty"]:
        store.add(long_result(seq := seq + 1), STATE)
    assert kept(store) == [*range(1, 6), *range(16, seq + 1)]
    assert store.dropped_counts()["undelivered"] == 0
    for _ in range(100):
        store.add(long_result(seq := seq + 1), STATE)
    counts = store.dropped_counts()
    assert (counts["delivered"], counts["empty"]) == (5, 5)
    assert counts["undelivered"] == seq - 10 - len(kept(store))
    assert kept(store)[-1] == seq
    assert store.used_bytes() <= BUDGET_BYTES


def test_the_newest_result_of_each_clutch_stays(tmp_path: Path) -> None:
    with closing(ResultStore.open(tmp_path / "small.sqlite", 1)) as store:
        for seq in range(1, 10):
            store.add(shift_result(seq, to_gear=2 + seq % 2), STATE)
            store.mark_published([seq])
        assert kept(store) == [8, 9]
        assert store.next_seq() == 1  # those were of a stream of their own
