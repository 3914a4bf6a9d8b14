"""A run without a store is told of as one with an empty store is, and leaves nothing behind."""

from contextlib import closing

from diag_service.store import NoStore, ResultStore, SessionStore, Versions
from tests.support.builders import shift_result

NOW = "2027-01-01T00:00:00.000000Z"


def told_by(store: SessionStore) -> tuple[object, ...]:
    """Return what a session hears of a vehicle before its first result."""
    versions = Versions(algorithm="a", calibration="c")
    known = store.find("car1", store.stream, 1, versions), store.state("car1"), store.fluid_at("car1", NOW)
    return known, list(store.latest("car1")), store.keeps_state, store.next_seq()


def test_it_is_as_an_empty_one() -> None:
    with closing(ResultStore.in_memory()) as empty:
        assert told_by(NoStore()) == told_by(empty)


def test_numbers_go_on_and_results_do_not_stay() -> None:
    store: SessionStore = NoStore()
    assert store.stream != NoStore().stream
    for seq in (1, 2, 5, 3):
        result = shift_result(seq, stream=store.stream)
        assert store.add(result, None)
        versions = Versions(algorithm=result.algorithm_version, calibration=result.calibration_version)
        assert store.find(result.vehicle, store.stream, seq, versions) is None
    assert store.next_seq() == 6
