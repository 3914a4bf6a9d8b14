"""The course of the verdicts on an ageing fluid: what is shown of it, and what would be wrong."""

from itertools import repeat

import pytest
from rich.console import Console

from benchmarks.ageing_picture import Point
from demo.ageing import ageing_table, course_complaints
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


def test_the_table_has_each_change_of_the_verdict_and_names_its_bands() -> None:
    console = Console(width=110, record=True)
    console.print(ageing_table(course(*RUNS)))
    shown = console.export_text()
    rows = [line.split() for line in shown.splitlines() if line.strip()[:1].isdigit()]
    assert [int(row[0]) for row in rows] == [1, 3, 15, 23, 28, 30, 36]
    assert "± two standard deviations" in shown
    assert "mu_C ± 2 std" in shown
    assert f"{FRICTION.mu_c:.4f} ± {2.0 * FRICTION.std_mu_c:.4f}" in shown
