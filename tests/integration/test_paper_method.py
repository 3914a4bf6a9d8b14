"""The paper's method end to end: on the plant's own signals, on CAN frames, and from the command line."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from clutch_model.calibration import SensorBias, nominal_calibration
from clutch_model.pack import film_law
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.friction.paper import PaperCollection, nominal_driveline
from diag_service.diagnosis.friction.paper.friction_data import NOISY_GATES
from diag_service.diagnosis.friction.paper.method import GRID_STRIDE, paper_signals
from diag_service.diagnosis.quality.data_quality import usable_signals
from diag_service.diagnosis.records import Reason
from ecu_emulator.drive.build import drive_settings
from ecu_emulator.plant import Col
from studies.reproduce.bound import bounds_percent, is_followed, piston_pressure_pa, stretches
from studies.reproduce.differences import central_difference
from studies.reproduce.drives import PERIOD_S, Case, PaperDrive, drive, noisy, static_tables
from studies.reproduce.study import Setup, matched_differentiators, noiseless_errors, noisy_errors
from studies.reproduce.variants import known_film_errors
from tests.integration.test_estimation import shifts
from tests.support.builders import drive_scenario
from tests.support.cycles import drive_rows
from tests.support.in_process import ended
from tests.support.service import Ended
from tests.support.wire import START_NS

if TYPE_CHECKING:
    from canlog.arrays import Series

CALIBRATION, DRIVELINE = nominal_calibration(), nominal_driveline()
PUNCTUAL = replace(CALIBRATION, bias=SensorBias())  # as the emulated vehicle: no reading is late


@cache
def cycle(case: Case = Case.IDEAL) -> PaperDrive:
    return drive(case, cycles=1, seed=7)


@pytest.mark.parametrize("case", list(Case))
def test_without_noise_the_errors_of_one_cycle_are_the_film_table_s(case: Case) -> None:
    setup = Setup(tables=static_tables())
    by_table, by_film = noiseless_errors([cycle(case)], setup), known_film_errors([cycle(case)], setup)
    for key, errors in by_table.percent.items():
        assert abs(errors[0]) < (15.0 if case is Case.CASE_2 else 12.0), key
    for key, errors in by_film.percent.items():
        assert abs(errors[0]) < (0.05 if key[2] == "mu_c" else 1.5), key
    assert all(by_table.mean((case, clutch, "mu_c")) < -2.0 for clutch in (1, 2))  # film lag


def test_with_noise_the_ideal_set_stays_near_the_paper_s_level() -> None:
    setup = Setup(tables=static_tables(), differentiators=matched_differentiators(cycle()), gates=NOISY_GATES)
    errors = noisy_errors([cycle()], setup, range(6))
    assert max(abs(errors.mean(key)) for key in errors.percent) < 15.0
    whole = noisy(cycle().signals, 1)
    assert np.std(whole.hub_rad_s - cycle().signals.hub_rad_s) == pytest.approx(
        0.10 * np.sqrt(np.mean(cycle().signals.hub_rad_s ** 2)), rel=0.02
    )


@pytest.mark.parametrize("clutch", [1, 2])
def test_the_bound_s_model_gives_the_true_pressure(clutch: int) -> None:
    law = film_law(cycle().truth.clutches[clutch - 1])
    found = stretches(cycle(), clutch)
    assert sum(len(one.film_m) for one in found) > 2000
    followed = [is_followed(one, law) for one in found]
    assert np.mean(np.concatenate(followed)) > 0.95  # the rest: a clutch that is let go
    for one, rows in zip(found, followed, strict=True):
        seen_pa = piston_pressure_pa(one.film_m, central_difference(one.film_m, PERIOD_S).rate, one.viscosity, law)
        assert np.median(np.abs(seen_pa - one.pressure_pa)[rows]) < 10.0


def test_the_bound_is_of_the_known_size() -> None:
    bounds = bounds_percent(cycle())
    expected = {(1, "mu_c"): 0.14, (1, "mu_s"): 0.32, (2, "mu_c"): 0.10, (2, "mu_s"): 0.23}  # three cycles
    for (_, clutch, parameter), bound in bounds.items():
        assert bound == pytest.approx(np.sqrt(3.0) * expected[clutch, parameter], rel=0.3)


def test_the_vehicle_route_finds_the_torques() -> None:
    rows = drive_rows(drive_settings(drive_scenario(seed=77)))
    misses_nm = []
    for event in shifts():
        signals, gathered = paper_signals(event, PUNCTUAL, DRIVELINE), usable_signals(event, PUNCTUAL)
        assert not isinstance(signals, Reason)
        assert not isinstance(gathered, Reason)
        grid_s = gathered.grid_s[::GRID_STRIDE] + (event.start_ns - START_NS) * 1e-9
        true = rows[np.rint(grid_s / PERIOD_S).astype(int)][signals.is_shifting]
        misses_nm.append(signals.flywheel_nm[signals.is_shifting] - true[:, Col.FLYWHEEL_TORQUE])
        shaft_nm = signals.shaft_nm[:, signals.is_shifting].T - true[:, [Col.SHAFT1_TORQUE, Col.SHAFT2_TORQUE]]
        assert np.sqrt(np.mean(shaft_nm**2)) < 20.0
    assert np.sqrt(np.mean(np.concatenate(misses_nm) ** 2)) < 3.0  # less than the noise of the engine torque


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


def test_the_table_for_people_states_no_uncertainty(drive_log: Path) -> None:
    answer = analyze(drive_log)
    assert answer.status == 0, answer.err
    assert answer.out.count("n/a") == 2
    assert "no verdict" in answer.out
    assert "rejected" in answer.out


@pytest.mark.parametrize("option", [("--store", "results.sqlite"), ("--broker", "mqtt://127.0.0.1")])
def test_results_without_uncertainty_are_not_kept(drive_log: Path, tmp_path: Path, option: tuple[str, str]) -> None:
    value = str(tmp_path / option[1]) if option[0] == "--store" else option[1]
    answer = analyze(drive_log, option[0], value)
    assert answer.status == 2
    assert answer.err.startswith("diag-service: error: the paper's method states no uncertainty")
    assert answer.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
