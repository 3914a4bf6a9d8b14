"""The store's rules, in memory; what disks do to it is in tests/integration/test_store_file.py."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import pytest

from clutch_results.records import FluidFill, StoredResult, dump, shift_record
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_contract import Outcome, Receipt, key_of
from tests.support.builders import shift_result

VERSIONS = Versions(algorithm="algorithm-1", calibration="1+0123456789ab")


def state(mark: object = 1) -> VehicleState:
    return VehicleState(filter_state={"mark": mark}, condition={"conditions": []}, versions=VERSIONS)


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


def test_a_known_key_changes_nothing(store: ResultStore) -> None:
    store.add(shift_result(1), state("first"))
    louder = replace(shift_result(1), produced_at="2027-01-01T00:00:00.000000Z")
    assert not store.add(louder, state("second"))
    assert list(store.results("car1")) == [shift_result(1)]
    assert store.state("car1") == state("first")


@pytest.mark.parametrize(
    "other",
    [
        shift_result(2),
        shift_result(1, vehicle="car2"),
        shift_result(1, stream="another"),
        replace(shift_result(1), algorithm_version="algorithm-2"),
        replace(shift_result(1), calibration_version="2+0123456789ab"),
    ],
)
def test_every_part_of_the_key_counts(store: ResultStore, other: object) -> None:
    assert isinstance(other, type(shift_result()))
    store.add(shift_result(1), state())
    assert store.add(other, state())


def test_live_sequence_numbers_are_never_used_again(store: ResultStore) -> None:
    assert store.next_seq() == 1
    store.add(shift_result(1, stream=store.stream), state())
    assert store.next_seq() == 2
    store.add(shift_result(7, stream="a log"), state())
    assert store.next_seq() == 2


def test_the_outbox_is_ordered_and_forgets_what_was_acknowledged(store: ResultStore) -> None:
    for seq in (1, 2, 3):
        store.add(shift_result(seq), state())
    store.add(shift_result(1, vehicle="car2"), state())
    rows = waiting(store, limit=2)
    assert [row.key.seq for row in rows] == [1, 2]
    assert rows[0] == StoredResult(
        position=1,
        key=key_of(shift_record(shift_result(1))),
        clutch=2,
        produced_at=shift_result(1).produced_at,
        text=dump(shift_record(shift_result(1))),
    )
    store.mark_published([rows[0].position])
    assert [row.key.seq for row in waiting(store)] == [2, 3]
    assert store.unpublished_count("car1") == 2
    assert store.unpublished_count("car2") == 1


def test_the_last_of_each_stream_was_made_like_the_one_stored_last(store: ResultStore) -> None:
    older, other = shift_result(1, to_gear=2, stream="older"), shift_result(9, to_gear=2)
    for one in (shift_result(5, to_gear=2), older, shift_result(2, to_gear=3, stream="older")):
        store.add(one, state())
    assert [(row.key.stream, row.key.seq) for row in store.ends("car1")] == [
        (other.stream, 5),
        ("older", 1),
        ("older", 2),
    ]
    store.add(replace(other, algorithm_version="another"), state())
    assert [row.key.algorithm_version for row in store.ends("car1")] == ["another"]
    own = Versions(algorithm=older.algorithm_version, calibration=older.calibration_version)
    assert [row.key.seq for row in store.ends("car1", own)] == [5, 1, 2]


def test_a_backend_settles_by_key_what_is_here(store: ResultStore) -> None:
    for seq in (1, 2, 3):
        store.add(shift_result(seq), state())
    keys = [key_of(shift_record(shift_result(seq))) for seq in (1, 2, 3)]
    elsewhere = replace(keys[0], stream="another")
    receipts = [
        Receipt(key=keys[0]),
        Receipt(key=elsewhere),
        Receipt(key=keys[2], outcome=Outcome.QUARANTINED, reason="quality: must be at most 1"),
    ]
    assert store.note_receipts(receipts) == [1, 3]
    assert store.note_receipts(receipts) == [1, 3]  # a repetition changes nothing
    assert [row.key.seq for row in waiting(store)] == [2]


def waiting(store: ResultStore, *, after: int = 0, before: int = 2**62, limit: int = 99) -> list[StoredResult]:
    return store.waiting("car1", after=after, before=before, limit=limit)


def fill(day: int, vehicle: str = "car1") -> FluidFill:
    return FluidFill(vehicle=vehicle, filled_at=f"2026-01-{day:02d}T00:00:00.000000Z", product=f"fluid {day}")


def test_the_fluid_of_a_moment_is_that_of_the_last_fill_before_it(store: ResultStore) -> None:
    assert store.fluid_at("car1", fill(9).filled_at) is None
    assert store.add_fills([fill(9), fill(3), fill(5, "car2")]) == 3
    assert store.fills("car1") == [fill(3), fill(9)]
    assert store.fluid_at("car1", fill(2).filled_at) is None
    assert store.fluid_at("car1", fill(3).filled_at) == fill(3)
    assert store.fluid_at("car1", fill(8).filled_at) == fill(3)
    assert store.fluid_at("car1", fill(20).filled_at) == fill(9)
