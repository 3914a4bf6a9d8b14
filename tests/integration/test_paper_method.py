"""The paper's method end to end: on the plant's own signals, on CAN frames, and from the command line."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Reason
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.friction.paper import PaperCollection, nominal_driveline
from studies.reproduce.drives import PaperCase, PaperDrive, drive, static_tables
from studies.reproduce.study import Setup, noiseless_errors
from studies.reproduce.variants import known_film_errors
from tests.integration.test_estimation import shifts
from tests.support.in_process import ended
from tests.support.service import Ended

if TYPE_CHECKING:
    from canlog.arrays import Series

CALIBRATION, DRIVELINE = nominal_calibration(), nominal_driveline()


@cache
def cycle(case: PaperCase = PaperCase.IDEAL) -> PaperDrive:
    return drive(case, cycles=1, seed=7)


@pytest.mark.parametrize("case", list(PaperCase))
def test_without_noise_the_errors_of_one_cycle_are_the_film_table_s(case: PaperCase) -> None:
    setup = Setup(tables=static_tables())
    by_table, by_film = noiseless_errors([cycle(case)], setup), known_film_errors([cycle(case)], setup)
    for key, errors in by_table.percent.items():
        assert abs(errors[0]) < (15.0 if case is PaperCase.CASE_2 else 12.0), key
    for key, errors in by_film.percent.items():
        assert abs(errors[0]) < (0.05 if key[2] == "mu_c" else 1.5), key
    assert all(by_table.mean((case, clutch, "mu_c")) < -2.0 for clutch in (1, 2))  # film lag


def test_shifts_are_pooled_and_unusable_ones_say_why() -> None:
    collection = PaperCollection(CALIBRATION, DRIVELINE)
    found = [collection.add(event) for event in shifts()]
    assert all(shift.reason is None for shift in found)
    for clutch in collection.pooled():
        assert clutch.shift_count == 10
        assert clutch.estimate is not None
        assert clutch.estimate.mu_c == pytest.approx(0.140, rel=0.25)
        assert clutch.estimate.mu_s == pytest.approx(0.119, rel=0.21)  # the gate's own width
    blind = shifts()[0]
    columns: dict[Signal, Series] = {key: one for key, one in blind.columns.items() if key is not Signal.WHEEL_FL_SPEED}
    refused = collection.add(replace(blind, columns=columns))
    assert (refused.reason, refused.estimate) == (Reason.SIGNAL_MISSING, None)
    assert [clutch.shift_count for clutch in collection.pooled()] == [10, 10]


def analyze(log: Path, *options: str) -> Ended:
    return ended("analyze", log, "--estimator", "paper", *options)


def test_the_command_line_prints_shifts_and_both_clutches(drive_log: Path) -> None:
    answer = analyze(drive_log, "--json")
    assert answer.status == 0, answer.err
    records = answer.records
    assert {record["schema"] for record in records} == {"clutchdiag/paper/v1"}
    assert [(one["from_gear"], one["to_gear"]) for one in records if one["scope"] == "shift"] == [
        (1, 2),
        (2, 3),
        (3, 4),
    ]
    pooled = {one["clutch"]: one for one in records if one["scope"] == "pooled"}
    assert pooled[2]["mu_c"] == pytest.approx(0.14, rel=0.35)
    assert pooled[2]["mu_c_samples"] > 5
