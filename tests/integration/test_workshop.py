"""The workshop routine on the wire: performed by the emulated car, recognised by the service."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario import WorkshopRoutine
from ecu_emulator.truth import TruthLog
from tests.support.builders import drive_scenario
from tests.support.traffic import as_received


@lru_cache(maxsize=4)
def drive(name: str, open_revs: int, closed_revs: int, seed: int) -> tuple[list[Event], list[Event], TruthLog]:
    """Return what the service finds in a drive of one cycle, and the truth."""
    routine = WorkshopRoutine(open_revs=open_revs, closed_revs=closed_revs)
    frames, truth = frames_of(replace(drive_scenario(name, seed=seed), routine=routine))
    decoder = Decoder(load_contract(), load_profile())
    run_ups, shifts = RunUpFinder(nominal_calibration()), ShiftFinder()
    found_run_ups: list[Event] = []
    found_shifts: list[Event] = []
    for columns in decoder.feed(as_received(frames)):
        found_run_ups += run_ups.feed(columns)
        found_shifts += shifts.feed(columns)
    return found_run_ups + run_ups.flush(), found_shifts + shifts.flush(), truth


@pytest.mark.parametrize(("name", "seed"), [("noise_only", 1), ("ideal", 7)])
def test_as_many_run_ups_are_found_as_were_performed(name: str, seed: int) -> None:
    run_ups, _, truth = drive(name, 4, 3, seed)
    assert [run_up.are_clutches_closed for run_up in run_ups] == [False] * 4 + [True] * 3
    assert [run_up.are_clutches_closed for run_up in run_ups] == [rev.are_clutches_closed for rev in truth.revs]
    assert all(run_up.end_reason is EndReason.COMPLETE and run_up.bad_frame_count == 0 for run_up in run_ups)


def test_neither_run_ups_nor_the_start_are_shifts() -> None:
    _, shifts, truth = drive("noise_only", 4, 3, 1)
    assert [(shift.from_gear, shift.to_gear) for shift in shifts] == [
        (shift.from_gear, shift.to_gear) for shift in truth.shifts
    ]
    assert len(shifts) == 10
    assert all(shift.end_reason is EndReason.COMPLETE for shift in shifts)


def test_the_input_shafts_show_which_part_it_is() -> None:
    """Closed clutches carry the input shafts along; open ones drag them behind."""
    for run_up in drive("noise_only", 4, 3, 1)[0]:
        columns = {signal: series.between(run_up.start_ns, run_up.end_ns) for signal, series in run_up.columns.items()}
        hub_rad_s = columns[Signal.HUB_SPEED].value
        for signal in (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED):
            slip_rad_s = np.abs(hub_rad_s - columns[signal].value)
            assert (slip_rad_s.max() < 2.0) == run_up.are_clutches_closed
