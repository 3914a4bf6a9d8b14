"""What the controller thinks of its clutches: from the service's lines, from a scenario, and what it makes of it."""

import math

import pytest

from diag_service.diagnosis.records import Condition, dump, shift_record
from ecu_emulator.diagnostics.clutches import (
    OnBoardFriction,
    fluid_test,
    read_line,
    scenario_friction,
    values_of,
)
from ecu_emulator.diagnostics.memory import TestResult as Result
from ecu_emulator.errors import ConfigError
from ecu_emulator.scenario.scenario import EstimateFrom, FluidVerdict
from ecu_emulator.scenario.scenario_file import parse_scenario
from tests.support.builders import shift_result

GOOD = OnBoardFriction(fluid=FluidVerdict.GOOD)
WORN = OnBoardFriction(fluid=FluidVerdict.CHANGE_FLUID)
UNKNOWN = OnBoardFriction()


def test_a_line_of_the_service_is_an_estimate() -> None:
    result = shift_result()
    found = read_line(dump(shift_record(result)).encode())
    assert found is not None
    clutch, estimate = found
    friction = result.verdict.friction
    assert friction is not None
    assert clutch == result.verdict.clutch
    assert (estimate.mu_c, estimate.std_mu_s) == (friction.mu_c, friction.std_mu_s)
    assert estimate.fluid == result.verdict.condition.name.lower()
    assert {one.name.lower() for one in Condition} == set(FluidVerdict)


def test_what_is_not_known_is_no_value() -> None:
    values = values_of({1: OnBoardFriction(mu_c=0.13), 2: UNKNOWN})
    assert values == {"clutch1_mu_c": 0.13}


@pytest.mark.parametrize(
    "line",
    [
        b"", b"\n", b"{", b"[]", b"3", b"null", b"\xff\xfe", b'{"schema":"clutchdiag/summary/v1"}', b"[" * 100_000,
        b'{"schema":"clutchdiag/shift/v1"}', b'{"schema":"clutchdiag/shift/v1","verdict":3}',
        b'{"schema":"clutchdiag/shift/v1","verdict":{"clutch":3,"condition":"good","friction":null}}',
        b'{"schema":"clutchdiag/shift/v1","verdict":{"clutch":1,"condition":"fine","friction":null}}',
        b'{"schema":"clutchdiag/shift/v1","verdict":{"clutch":1,"condition":"good","friction":{"mu_c":"x"}}}',
    ],
)  # fmt: skip
def test_what_is_no_result_is_passed_over(line: bytes) -> None:
    assert read_line(line) is None


@pytest.mark.parametrize(
    ("estimates", "failed", "result"),
    [
        ({}, (), None),
        ({1: UNKNOWN}, (), None),
        ({1: GOOD, 2: UNKNOWN}, (), Result.PASSED),
        ({1: OnBoardFriction(fluid=FluidVerdict.WATCH)}, (), Result.PASSED),
        ({1: GOOD, 2: WORN}, (), Result.FAILED),
        ({1: GOOD, 2: WORN}, ("P0811",), Result.FAILED),
        ({1: GOOD, 2: WORN}, ("P0841",), None),  # what comes of a sensor that is not believed is not believed
    ],
)
def test_one_worn_clutch_fails_the_test_of_the_fluid(
    estimates: dict[int, OnBoardFriction], failed: tuple[str, ...], result: Result | None
) -> None:
    assert fluid_test(estimates, failed) is result


def test_a_scenario_may_have_an_estimate_of_its_own_or_none() -> None:
    plain = parse_scenario('name = "a"', "text").on_board
    assert plain.estimate is EstimateFrom.SERVICE
    text = 'name = "a"\n[on_board]\nestimate = "own"\nfluid = "change_fluid"\nmu_c = 0.12\n'
    estimate = scenario_friction(parse_scenario(text, "text").on_board)
    assert (estimate.fluid, estimate.mu_c, math.isnan(estimate.mu_s)) == (FluidVerdict.CHANGE_FLUID, 0.12, True)
    assert parse_scenario('name = "a"\n[on_board]\nestimate = "none"', "text").on_board.estimate is EstimateFrom.NONE


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('estimate = "mine"', "on_board.estimate must be one of service, none, own, got 'mine'"),
        ('estimate = "own"', 'on_board.fluid, mu_c and the others belong to estimate = "own", which needs one'),
        ("mu_c = 0.1", "which needs one of them"),
        ('estimate = "own"\nmu_c = 1.0', "on_board.mu_c must be above 0 and at most 0.5, got 1.0"),
        ('estimate = "own"\nfluid = "bad"', "on_board.fluid must be one of no_verdict, good, watch, change_fluid"),
        ("friction = 1", "on_board.friction is unknown"),
    ],
)
def test_what_cannot_be_an_estimate_is_named(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_scenario(f'name = "a"\n[on_board]\n{text}', "text")
