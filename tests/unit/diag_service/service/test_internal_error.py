"""A fault of the program over one event: the event is left out and kept, and all others are diagnosed as before."""

import logging
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Condition, Reason, Status
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.posterior import Posterior
from diag_service.diagnosis.lockup.state import LockupState
from diag_service.diagnosis.shifts.tracking import EventFinder
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.session import Session
from diag_service.service.stages import Belief, Diagnosis, DualClutch, Element, Stages
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import KeptEvents, ResultStore, kept_event
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.shifts_of_a_drive import first_shifts
from tests.support.wire import received

CALIBRATION = nominal_calibration()
SECOND = 2


@cache
def events() -> tuple[Event, ...]:
    stages = Stages(Decoder(load_contract(), load_profile()), CALIBRATION)
    return tuple(stages.segment(received(next(Drive(drive_scenario()).stretches(10.0)).frames)))


class Failing:
    """A pair of clutches that fails over one event as no test can foresee."""

    algorithm_version: ClassVar[str] = DualClutch.algorithm_version
    state_kind: ClassVar[type[Posterior] | type[LockupState]] = DualClutch.state_kind

    def __init__(self, element: Element, number: int, fault: Exception) -> None:
        self._element, self._number, self._fault = element, number, fault

    def finder(self) -> EventFinder:
        return self._element.finder()

    def with_new_fluid(self, belief: Belief, filled_at: str) -> Belief:
        return self._element.with_new_fluid(belief, filled_at)

    def conclude(self, belief: Belief, event: Event) -> Diagnosis:
        if event.number == self._number:
            raise self._fault
        return self._element.conclude(belief, event)


def results_of(
    kept: KeptEvents, *, fails: Callable[[Element], Element] = lambda element: element, without: int | None = None
) -> MemoryReporter:
    """Return what a session reports of the events of a drive."""
    config, reporter = DiagnosisConfig(vehicle="car1", calibration=CALIBRATION), MemoryReporter()
    with closing(ResultStore.in_memory()) as store:
        decoder = Decoder(load_contract(), load_profile())
        session = Session(config, decoder, store, "a" * 64, reporter, kept_events=kept)
        session.stages.element = fails(session.stages.element)
        for event in events():
            if event.number != without:
                session.process(event)
    return reporter


def test_one_event_fails_and_the_others_are_diagnosed_as_if_it_had_not_been(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept, fault = KeptEvents(tmp_path / "car.sqlite.events"), IndexError("index 0 is out of bounds")
    with caplog.at_level(logging.ERROR):
        failed = results_of(kept, fails=lambda element: Failing(element, SECOND, fault))
    sound = results_of(KeptEvents(None), without=SECOND)
    (left_out,) = [result for result in failed.results if result.seq == SECOND]
    assert (left_out.estimate.status, left_out.estimate.reasons) == (Status.REJECTED, (Reason.INTERNAL_ERROR,))
    assert left_out.verdict.condition is Condition.NO_VERDICT
    others = [result for result in failed.results if result.seq != SECOND]
    assert len(others) >= 2
    assert others == sound.results
    (path,) = (tmp_path / "car.sqlite.events").iterdir()
    (record,) = caplog.records
    assert record.getMessage() == (
        "event 2 is left out: unexpected IndexError: index 0 is out of bounds; "
        f"its signals are in {path}, for a report of the fault"
    )


def test_an_event_that_was_kept_is_read_as_it_was(tmp_path: Path) -> None:
    event = events()[0]
    path = KeptEvents(tmp_path / "kept").keep(event, "Traceback: it failed")
    assert path is not None
    read, fault = kept_event(path)
    assert fault == "Traceback: it failed"
    assert replace(read, columns={}) == replace(event, columns={})
    assert read.columns.keys() == event.columns.keys()
    for signal, series in event.columns.items():
        for part in ("t_ns", "sequence", "value"):
            assert np.array_equal(getattr(read.columns[signal], part), getattr(series, part))
        assert read.columns[signal].period_ns == series.period_ns
    assert path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(("most_files", "files_that_fit"), [(3, 100), (100, 3)])
def test_the_oldest_leave(most_files: int, files_that_fit: int, tmp_path: Path) -> None:
    event = events()[0]
    sample = KeptEvents(tmp_path / "one").keep(event, "")
    assert sample is not None
    most_bytes = round((files_that_fit + 0.5) * sample.stat().st_size)
    kept = KeptEvents(tmp_path / "kept", most_files=most_files, most_bytes=most_bytes)
    paths = [kept.keep(replace(event, number=number), "") for number in range(1, 8)]
    assert sorted((tmp_path / "kept").iterdir()) == sorted(path for path in paths[-3:] if path)


def test_a_folder_that_cannot_be_made_stops_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "kept").write_text("a file")
    assert KeptEvents(tmp_path / "kept").keep(events()[0], "") is None
    assert "cannot be kept" in caplog.text


def test_what_the_user_can_mend_is_no_fault_of_the_program() -> None:
    with pytest.raises(ConfigError, match="no such clutch"):
        results_of(KeptEvents(None), fails=lambda element: Failing(element, SECOND, ConfigError("no such clutch")))


def test_samples_without_a_stretch_in_common_are_a_reason() -> None:
    shift = first_shifts()[0]
    columns = {
        signal: replace(
            series,
            t_ns=shift.start_ns + np.array([2_200_000, 2_900_000]),
            sequence=np.array([-1, -1]),
            value=series.value[:2],
        )
        for signal, series in shift.columns.items()
        if len(series.t_ns) > 1
    }
    brief = replace(shift, end_ns=shift.start_ns + 3_000_000, columns=columns)
    estimate = Stages(Decoder(load_contract(), load_profile()), CALIBRATION).conclude(brief).estimate
    assert (estimate.status, estimate.reasons) == (Status.REJECTED, (Reason.NO_COMMON_TIME,))
