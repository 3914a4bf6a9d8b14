"""The mismatch table: every row is a vehicle that can be built, figures and marks are right."""

from dataclasses import fields, replace

import pytest

from benchmarks.mismatch import (
    NOISE_ONLY,
    SCATTERED,
    Case,
    Outcome,
    cases_of,
    document,
    line_of,
    outcomes,
    scenario_of,
    table,
)
from benchmarks.mismatch_rows import BY_NAME, MATCHED, ROWS, Mismatch
from ecu_emulator.drive.build import build_vehicle
from ecu_emulator.scenario.scenario import Effects, FluidCondition, Scenario
from tests.support.builders import drive_scenario

NAME = "w_S x 1.5"


def outcome(scenario: str, parameter: str, error: float, *, std: float = 0.02) -> Outcome:
    return Outcome(
        row=NAME,
        scenario=scenario,
        parameter=parameter,
        error_ratio=error,
        random_std_ratio=0.005,
        std_ratio=std,
        used_shifts=0.9,
        is_wrong=error > 0.005 and parameter == "mu_c",
    )


RESULTS = [
    outcome(NOISE_ONLY, "mu_c", 0.003),
    outcome(NOISE_ONLY, "mu_c", -0.001),
    outcome(NOISE_ONLY, "mu_s", 0.04),
    outcome(NOISE_ONLY, "mu_s", 0.03),
    outcome(SCATTERED, "mu_c", 0.01),
    outcome(SCATTERED, "mu_c", -0.01),
    outcome(SCATTERED, "mu_s", 0.05),
    outcome(SCATTERED, "mu_s", 0.03),
]


def test_names_are_unique_and_the_first_row_is_the_matched_one() -> None:
    assert len(BY_NAME) == len(ROWS)
    assert ROWS[0] is MATCHED
    assert MATCHED.applied(drive_scenario()) == drive_scenario()


@pytest.mark.parametrize("row", ROWS[1:], ids=lambda row: row.name)
def test_a_row_changes_effects_or_sensors_and_makes_a_vehicle(row: Mismatch) -> None:
    plain = drive_scenario()
    applied = row.applied(plain)
    changed = {
        member.name for member in fields(Scenario) if getattr(applied, member.name) != getattr(plain, member.name)
    }
    assert changed in ({"effects"}, {"sensors"}, {"truth"})
    build_vehicle(applied)


def test_lags_reach_the_sensors_named_and_no_other() -> None:
    sensors = BY_NAME["torque lag 25 ms"].applied(drive_scenario()).sensors
    lagging = {quantity: sensor.lag_s for quantity, sensor in sensors.items() if sensor.lag_s}
    assert lagging == {"engine_torque_nm": 0.025}


def test_all_rows_are_driven_over_the_same_seeds() -> None:
    cases = cases_of(ROWS, seeds=3, first_seed=50)
    assert len(cases) == len(ROWS) * 2 * 3
    seeds: dict[tuple[str, str], set[int]] = {(case.row, case.scenario): set() for case in cases}
    for case in cases:
        seeds[case.row, case.scenario].add(case.seed)
    assert all(driven == {50, 51, 52} for driven in seeds.values())


def test_a_case_has_its_effect_seed_and_fluid() -> None:
    scenario = scenario_of(Case(row=NAME, scenario=SCATTERED, seed=7, fluid=FluidCondition.CASE_2))
    assert scenario.effects == Effects(stribeck_speed_ratio=1.5)
    assert (scenario.seed, scenario.fluid.condition) == (7, FluidCondition.CASE_2)


def test_figures_of_a_row() -> None:
    line = line_of(NAME, RESULTS)
    assert line.bias_percent == pytest.approx((0.1, 3.5))
    assert line.rms_percent == pytest.approx(((0.05) ** 0.5, (12.5) ** 0.5))
    assert line.random_coverage == 0.5
    assert line.total_coverage == (1.0, 0.5)
    assert line.unused_shifts == pytest.approx(0.1)
    assert line.wrong_verdicts == 1
    assert not line.holds


def test_a_row_whose_interval_does_not_hold_is_marked_and_explained() -> None:
    failing = line_of(NAME, RESULTS)
    holding = line_of(NAME, [replace(one, std_ratio=0.03) for one in RESULTS])
    assert "**w_S x 1.5** (below 90 %)" in list(table([failing]))[-1]
    assert "| w_S x 1.5 |" in list(table([holding]))[-1]
    assert f"- **{NAME}**: 50 % instead of 90 %." in document([failing], 2, 50)
    assert BY_NAME[NAME].way in document([failing], 2, 50)
    assert "In every row at least 90 %" in document([holding], 2, 50)


def test_a_drive_without_mismatch_is_estimated_well() -> None:
    case = Case(row=MATCHED.name, scenario=NOISE_ONLY, seed=12, fluid=FluidCondition.IDEAL)
    results = outcomes(case)
    assert len(results) == 4
    assert all(abs(one.error_ratio) < 0.03 for one in results)
    assert all(one.used_shifts == pytest.approx(1.0) for one in results)
