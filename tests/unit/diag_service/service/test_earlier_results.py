"""What a live run knows of its clutches before their first shift: the last word of earlier runs."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import pytest

from clutch_results.records import Condition, FluidFill, ShiftResult
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import PROFILE_PATH, load_profile
from diag_service.service.session import Session
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore
from tests.support.builders import shift_result
from tests.support.histories import CALIBRATION, STATE, VERSIONS, of_version
from tests.unit.diag_service.service.test_live import gear_frames

LATER = "2026-06-01T00:00:00.000000Z"
FILL = FluidFill(vehicle="car1", filled_at="2026-03-01T00:00:00.000000Z")


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    """Yield a store with a worn clutch 2 and a good clutch 1."""
    with closing(ResultStore.in_memory()) as store:
        for result in (worn(shift_result(1)), shift_result(2, to_gear=3)):
            store.add(of_version(result, VERSIONS), STATE)
        yield store


def worn(result: ShiftResult) -> ShiftResult:
    return replace(result, verdict=replace(result.verdict, condition=Condition.CHANGE_FLUID))


def session(store: ResultStore, *, stream: str | None = None, vehicle: str = "car1") -> Session:
    decoder = Decoder(load_contract(), load_profile(PROFILE_PATH))
    config = DiagnosisConfig(vehicle=vehicle, calibration=CALIBRATION)
    return Session(config, decoder, store, stream, MemoryReporter(), utc_now=lambda: LATER)


def verdicts(run: Session) -> list[tuple[int, str]]:
    return [(result.verdict.clutch, result.verdict.condition.name) for result in run.latest]


def test_a_restart_forgets_no_verdict(store: ResultStore) -> None:
    run = session(store)
    assert verdicts(run) == [(1, "GOOD"), (2, "CHANGE_FLUID")]
    assert run.latest[1] == of_version(worn(shift_result(1)), VERSIONS)
    assert run.summary(FrameCounts(), None).latest == ()


def test_new_fluid_before_the_start_takes_the_verdicts_away(store: ResultStore) -> None:
    store.add_fills([FILL])
    run = session(store)
    assert run.fluid == FILL
    assert verdicts(run) == [(1, "NO_VERDICT"), (2, "NO_VERDICT")]
    assert {result.verdict.friction for result in run.latest} == {None}
    assert run.latest[1].estimate == shift_result(1).estimate


def test_new_fluid_during_a_run_is_noted_with_the_next_shift_of_either_clutch() -> None:
    with closing(ResultStore.in_memory()) as store:
        run = session(store)
        first, second = run.stages.segment(gear_frames(3))
        run.process(first)
        assert run.fluid is None
        new = FluidFill(vehicle="car1", filled_at="1970-01-01T00:00:05.000000Z")
        store.add_fills([new])
        run.process(second)
    reasons = {result.verdict.clutch: result.verdict.reason for result in run.latest}
    assert run.fluid == new
    assert (first.to_gear, second.to_gear) == (2, 1)
    assert reasons[2] == "new fluid, of which no shift is known yet"
    assert reasons[1] != reasons[2]
