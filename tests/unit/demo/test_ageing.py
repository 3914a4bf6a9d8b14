"""The course of the verdicts on an ageing fluid: what is shown of it, and what would be wrong."""

from itertools import repeat

import pytest

from benchmarks.ageing_picture import Point
from demo.ageing import course_complaints
from diag_service.diagnosis.records import Condition
from tests.unit.demo.outcomes import FRICTION, good_outcome

TRUTH = good_outcome().truth.shifts[0]
RUNS = ((Condition.NO_VERDICT, 2), (Condition.GOOD, 20), (Condition.WATCH, 5), (Condition.CHANGE_FLUID, 9))


def course(*runs: tuple[Condition, int]) -> list[Point]:
    found = [condition for condition, count in runs for condition in repeat(condition, count)]
    return [Point(truth=TRUTH, running=FRICTION, condition=condition) for condition in found]


def test_a_clutch_that_is_found_out_is_no_complaint() -> None:
    assert course_complaints(course(*RUNS)) == []


@pytest.mark.parametrize("missing", range(1, 4))
def test_a_verdict_that_does_not_come_is_named(missing: int) -> None:
    (found,) = course_complaints(course(*RUNS[:missing], *RUNS[missing + 1 :]))
    assert found.startswith("of the ageing fluid the service said no verdict, ")
    assert found.endswith("not good, watch, change fluid")


def test_a_verdict_that_does_not_last_is_named() -> None:
    assert course_complaints(course(*RUNS, (Condition.WATCH, 1))) != []
    assert course_complaints([]) == ["of the ageing fluid the service said nothing, not good, watch, change fluid"]
