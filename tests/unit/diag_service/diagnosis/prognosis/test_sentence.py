"""What people read of a prognosis: a range, never a single distance, and nothing that contradicts the order."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import Passage, Prognosis, prognose
from diag_service.diagnosis.prognosis.channels import DISTANCE_M
from diag_service.diagnosis.prognosis.prognosis import Outlook, Reach
from diag_service.diagnosis.prognosis.sentence import outlook_line
from fleet_contract.orders import Action
from tests.support.pasts import REFERENCE, ageing, past

NEVER = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))
UNKNOWN = "How far the fluid will go cannot be said yet."


def reach(p10_m: float | None, p90_m: float | None, chance: float) -> Reach:
    return Reach(
        p10_m=p10_m,
        p50_m=None,
        p90_m=p90_m,
        p10_events=None,
        p50_events=None,
        p90_events=None,
        probability_before_service=chance,
        passage=NEVER,
    )


def prognosis(outlook: Outlook, change: Reach | None = None, *, clutch: int = 2, left_out_count: int = 0) -> Prognosis:
    return Prognosis(
        clutch=clutch,
        outlook=outlook,
        row_count=3,
        left_out_count=left_out_count,
        odometer_m=1.0e7,
        service_distance_m=1.5e7,
        fluid_starts=(),
        assumptions=(),
        watch=change,
        change_fluid=change,
    )


def said(*founds: Prognosis, action: Action = Action.NOTHING) -> str:
    return outlook_line(founds, action)


def test_few_results_are_named() -> None:
    few = prognosis(Outlook.TOO_FEW, clutch=1), prognosis(Outlook.TOO_FEW)
    expected = (
        "No prognosis yet: it takes 8 usable results of a clutch with this fluid; clutch 1 has 3, clutch 2 has 3."
    )
    assert said(*few) == said(*few, action=Action.NEW_FLUID) == expected


def test_without_a_trend_there_is_a_least_distance() -> None:
    expected = "No trend yet: left in, the fluid lasts at least 63,000 km (90 % sure)."
    assert said(prognosis(Outlook.NO_TREND, reach(6.34e7, None, 0.01))) == expected
    assert "at least 300,000 km" in said(prognosis(Outlook.NO_TREND, reach(None, None, 0.0)))
    assert said(prognosis(Outlook.NO_TREND, reach(0.0, 1.0e7, 0.6))) == UNKNOWN


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (reach(1.81e7, 4.44e7, 0.049), "in 18,000 to 44,000 km (80 % sure); 5 %"),
        (reach(0.0, 5.0e6, 0.999), "within 5,000 km (90 % sure); more than 99 %"),
        (reach(None, None, 0.0), "in more than 300,000 km; less than 1 %"),
        (reach(5.0e7, None, 0.0), "in more than 50,000 km (90 % sure); less than 1 %"),
    ],
)
def test_an_ageing_fluid_has_ranges(change: Reach, expected: str) -> None:
    text = f"The fluid ages: left in, it reaches its limit {expected} that this is within the next 15,000 km."
    assert said(prognosis(Outlook.AGEING, change), action=Action.MEASURE_AGAIN) == text


def test_an_order_that_waits_for_the_service_is_not_all_where_the_limit_comes_before() -> None:
    soon = prognosis(Outlook.AGEING, reach(0.0, 5.0e6, 0.98))
    late = prognosis(Outlook.AGEING, reach(1.81e7, 4.44e7, 0.049))
    left = "Left in, it reaches its limit within 5,000 km (90 % sure); 98 % that this is within the next 15,000 km."
    assert said(soon) == f"But the fluid ages: plan its change before the next service. {left}"
    assert said(soon, action=Action.CHANGE_AT_SERVICE) == (
        f"The fluid ages: better change it before the next service. {left}"
    )
    for action in (Action.NOTHING, Action.CHANGE_AT_SERVICE):
        assert said(late, action=action).startswith("The fluid ages: left in, it reaches its limit in 18,000 to")


def test_a_prognosis_says_nothing_of_now_which_is_the_matter_of_the_order() -> None:
    for change in (reach(0.0, 0.0, 1.0), reach(0.0, None, 0.5)):
        assert said(prognosis(Outlook.AGEING, change)) == UNKNOWN
    ageing_one = prognosis(Outlook.AGEING, reach(1.81e7, 4.44e7, 0.049))
    assert said(ageing_one, action=Action.CHANGE_NOW) == "No prognosis: the fluid is to be changed now."


def test_of_two_clutches_in_one_oil_the_sooner_end_counts() -> None:
    late, soon = reach(9.0e7, 2.0e8, 0.0), reach(1.81e7, 4.44e7, 0.049)
    both = prognosis(Outlook.AGEING, late, clutch=1), prognosis(Outlook.AGEING, soon)
    assert said(*both) == said(both[1])
    steady = prognosis(Outlook.NO_TREND, reach(0.0, None, 0.3), clutch=1)
    assert said(steady, both[1]) == said(both[1])


def test_new_fluid_without_a_result_is_not_judged_by_the_results_of_the_old_one() -> None:
    known = past(ageing(200, until=0.3), step_m=2.0e5)
    assert prognose(1, known, REFERENCE).row_count == 200
    filled = prognose(1, replace(known, is_fluid_newer=True), REFERENCE)
    assert (filled.outlook, filled.row_count) == (Outlook.TOO_FEW, 0)
    assert prognose(1, replace(known, is_fluid_newer=True).first(100), REFERENCE).row_count == 100
