"""A live session on a disk that fills up: nothing stops, nothing is told that is not stored, what waits is bounded."""

from collections.abc import Iterator
from contextlib import closing

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.records import ShiftResult
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.errors import StoreFullError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.session import MAX_PENDING_COUNT, Session
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore, VehicleState

NOW = "2026-01-01T00:00:00.000000Z"


class FillingStore(ResultStore):
    """A store whose disk can be full."""

    is_full = False

    def add(self, result: ShiftResult, state: VehicleState | None) -> bool:
        if self.is_full:
            raise StoreFullError("cannot use store x: database or disk is full")
        return super().add(result, state)


@pytest.fixture(name="store")
def _store() -> Iterator[FillingStore]:
    with closing(FillingStore.in_memory()) as store:
        yield store


def session_on(
    store: ResultStore, stream: str | None = None, *, max_pending_count: int = MAX_PENDING_COUNT
) -> tuple[Session, MemoryReporter]:
    config, reporter = DiagnosisConfig(vehicle="car1", calibration=nominal_calibration()), MemoryReporter()
    decoder = Decoder(load_contract(), load_profile())
    session = Session(
        config, decoder, store, stream, reporter, utc_now=lambda: NOW, max_pending_count=max_pending_count
    )
    return session, reporter


def event(number: int) -> Event:
    """Return a shift without signals: rejected, and a result all the same."""
    return Event(
        number=number,
        from_gear=1,
        to_gear=2,
        start_ns=number * 10**9,
        end_ns=number * 10**9 + 1,
        end_reason=EndReason.COMPLETE,
        columns={},
        bad_frame_count=0,
    )


def told(reporter: MemoryReporter) -> list[int]:
    return [result.seq for result in reporter.results]


def test_results_wait_and_are_told_when_they_are_stored(store: FillingStore, caplog: pytest.LogCaptureFixture) -> None:
    session, reporter = session_on(store)
    session.process(event(1))
    store.is_full = True
    session.process(event(2))
    session.process(event(3))
    assert told(reporter) == [1]
    store.is_full = False
    session.process(event(4))
    assert told(reporter) == [1, 2, 3, 4]
    assert [result.seq for result in store.results("car1")] == [1, 2, 3, 4]
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [
        "cannot use store x: database or disk is full; results wait in memory"
    ]


def test_the_end_of_a_run_is_a_last_attempt(store: FillingStore) -> None:
    session, reporter = session_on(store)
    store.is_full = True
    session.process(event(1))
    with pytest.raises(StoreFullError):
        session.finish(FrameCounts(), None)
    assert reporter.summaries == []
    store.is_full = False
    session.finish(FrameCounts(), None)
    assert (told(reporter), len(reporter.summaries)) == ([1], 1)
