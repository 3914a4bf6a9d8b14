"""The operating curve: its points, its reading of verdicts, its page."""

import csv
from dataclasses import replace
from io import StringIO

import pytest

from benchmarks.operating_curve import (
    CONDITIONS,
    LEVELS,
    LONG_CYCLES,
    SLOPES,
    Axis,
    Case,
    Horizon,
    Outcome,
    cases_of,
    comma_separated,
    document,
    friction_of,
    outcomes,
    picture,
    scenario_of,
    shares_of,
    table,
    verdict_at,
)
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import Condition
from diag_service.service.stages import Diagnosis
from ecu_emulator.drive.build import build_vehicle
from tests.support.builders import shift_estimate, shift_result


def diagnosis(number: int, clutch: int, condition: Condition) -> Diagnosis:
    calibration = nominal_calibration()
    return Diagnosis(
        estimate=shift_estimate(number),
        verdict=replace(shift_result().verdict, clutch=clutch, condition=condition),
        state=Posterior.fresh(calibration),
        memory=ConditionMemory.fresh(),
    )


def outcome(value: float, condition: Condition, horizon: Horizon = Horizon.ONE_CYCLE) -> Outcome:
    return Outcome(axis=Axis.SLOPE, value=value, horizon=horizon, condition=condition)


COUNTED = shares_of([
    *[outcome(0.021, Condition.GOOD)] * 3,
    outcome(0.021, Condition.WATCH),
    outcome(-0.005, Condition.CHANGE_FLUID),
])  # fmt: skip


def test_a_point_of_the_slope_keeps_mu_c_and_one_of_the_level_the_ratio() -> None:
    mu_c, mu_s = friction_of(Axis.SLOPE, -0.005)
    assert (mu_c, mu_s) == pytest.approx((0.140, 0.145))
    mu_c, mu_s = friction_of(Axis.LEVEL, 0.8)
    assert (mu_c, mu_s) == pytest.approx((0.112, 0.0952))


def test_the_drive_of_a_case_has_its_friction_and_production_scatter() -> None:
    vehicle = build_vehicle(scenario_of(Case(axis=Axis.SLOPE, value=-0.005, seed=3, cycles=1)))
    for clutch in vehicle.calibration.clutches:
        assert (clutch.friction.mu_c, clutch.friction.mu_s) == pytest.approx((0.140, 0.145))
    assert any(vehicle.drawn.values())


def test_no_vehicle_comes_twice_and_every_point_is_driven() -> None:
    cases = cases_of(seeds=2, long_seeds=1, first_seed=500)
    assert [case.seed for case in cases] == list(range(500, 500 + len(cases)))
    assert {case.value for case in cases if case.axis is Axis.SLOPE and case.cycles < LONG_CYCLES} == set(SLOPES)
    assert {case.value for case in cases if case.axis is Axis.LEVEL and case.cycles < LONG_CYCLES} == set(LEVELS)
    new_fluid = [case for case in cases if case.value in {1.0, 0.021} and case.cycles < LONG_CYCLES]
    assert len(new_fluid) == 2 * 3 * 2


def test_a_verdict_is_read_at_its_horizon_and_on_its_clutch() -> None:
    diagnoses = [
        diagnosis(1, 2, Condition.NO_VERDICT),
        diagnosis(2, 1, Condition.WATCH),
        diagnosis(9, 2, Condition.GOOD),
        diagnosis(11, 2, Condition.CHANGE_FLUID),
    ]
    assert verdict_at(diagnoses, 2, Horizon.ONE_SHIFT) is Condition.NO_VERDICT
    assert verdict_at(diagnoses, 2, Horizon.ONE_CYCLE) is Condition.GOOD
    assert verdict_at(diagnoses, 2, Horizon.THREE_CYCLES) is Condition.CHANGE_FLUID
    assert verdict_at(diagnoses, 1, Horizon.THREE_CYCLES) is Condition.WATCH
    assert verdict_at([], 1, Horizon.ONE_CYCLE) is Condition.NO_VERDICT


def test_the_table_shows_percents_and_leaves_gaps_where_nothing_was_driven() -> None:
    lines = list(table(COUNTED, Axis.SLOPE))
    assert "| 0.021 |  | 0 / 75 / 25 / 0 (4) |  |  |" in lines
    assert "| -0.005 |  | 0 / 0 / 0 / 100 (1) |  |  |" in lines
    assert len(lines) == 2 + len(SLOPES)


def test_the_counts_survive_the_csv() -> None:
    rows = list(csv.DictReader(StringIO(comma_separated(COUNTED))))
    assert [row["value"] for row in rows] == ["-0.005", "0.021"]
    assert (rows[1]["good"], rows[1]["watch"], rows[1]["change_fluid"]) == ("3", "1", "0")


def test_the_page_and_the_picture_are_the_same_for_the_same_numbers() -> None:
    assert document(COUNTED, 5, 100) == document(COUNTED, 5, 100)
    assert "5 drives" in document(COUNTED, 5, 100)
    assert "seeds 100 to 104" in document(COUNTED, 5, 100)
    drawn = picture(COUNTED)
    assert drawn == picture(COUNTED)
    assert all(condition.name.lower() in drawn for condition in CONDITIONS)


def test_new_fluid_is_good_after_a_cycle() -> None:
    after = outcomes(Case(axis=Axis.LEVEL, value=1.0, seed=11, cycles=1))
    assert {one.condition for one in after if one.horizon is Horizon.ONE_SHIFT} == {Condition.NO_VERDICT}
    assert {one.condition for one in after if one.horizon is Horizon.ONE_CYCLE} == {Condition.GOOD}
