"""What people read of a prognosis: a range, never a single distance, and nothing that contradicts the order."""

import numpy as np
import pytest

from clutch_results.prognosis import Passage, Prognosis
from clutch_results.prognosis.channels import DISTANCE_M
from clutch_results.prognosis.prognosis import Outlook, Reach
from clutch_results.prognosis.sentence import distance_left, least_left_m, outlook_line
from fleet_contract.orders import Action

NEVER = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))
UNKNOWN = "How far the fluid will go cannot be said yet."


def reach(p10_m: float | None, p90_m: float | None, chance: float) -> Reach:
    return Reach(p10_m=p10_m, p50_m=None, p90_m=p90_m, probability_before_service=chance, passage=NEVER)


def prognosis(
    outlook: Outlook, change: Reach | None = None, *, clutch: int = 2, left_out_count: int = 0, row_count: int = 3
) -> Prognosis:
    return Prognosis(
        clutch=clutch,
        outlook=outlook,
        row_count=row_count,
        left_out_count=left_out_count,
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


def test_a_fill_that_is_noted_late_says_why_results_enough_foretell_nothing() -> None:
    enough = prognosis(Outlook.NO_TREND, reach(2.2e7, None, 0.0), clutch=1, row_count=10)
    few = prognosis(Outlook.TOO_FEW)
    assert said(enough, few, action=Action.NEW_FLUID) == (
        "No prognosis before the next drive: what is known of the clutches rests on the earlier fluid, too, for "
        "the fill was noted after 10 usable results of clutch 1 with the new one."
    )


def test_the_distance_that_is_left_at_least_is_that_of_the_headline() -> None:
    lasting = prognosis(Outlook.NO_TREND, reach(2.2e7, None, 0.0))
    ageing = prognosis(Outlook.AGEING, reach(1.81e7, 4.44e7, 0.049))
    unknown = prognosis(Outlook.NO_TREND, reach(0.0, None, 0.0))
    for known, action, least_m, words in (
        ((lasting,), Action.NOTHING, 2.2e7, "at least 22,000 km left (90 % sure)"),
        ((lasting, ageing), Action.NOTHING, 1.81e7, "18,000 to 44,000 km left (80 % sure)"),
        (
            (prognosis(Outlook.NO_TREND, reach(None, None, 0.0)),),
            Action.NOTHING,
            3.0e8,
            "at least 300,000 km left (90 % sure)",
        ),
        ((lasting,), Action.CHANGE_NOW, 0.0, "0 km left"),
        ((lasting,), Action.NEW_FLUID, None, "km left: not known yet"),
        ((lasting,), Action.FIND_CAUSE, None, "km left: not known yet"),
        ((unknown,), Action.NOTHING, None, "km left: not known yet"),
        ((prognosis(Outlook.TOO_FEW),), Action.NOTHING, None, "km left: not known yet"),
    ):
        assert least_left_m(known, action) == least_m
        assert distance_left(known, action) == words


def test_a_vehicle_without_results_has_none_to_count() -> None:
    assert said() == "No prognosis yet: it takes 8 usable results of a clutch with this fluid."


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


def test_a_prognosis_says_nothing_of_now_which_is_the_matter_of_the_order() -> None:
    for change in (reach(0.0, 0.0, 1.0), reach(0.0, None, 0.5)):
        assert said(prognosis(Outlook.AGEING, change)) == UNKNOWN
    ageing_one = prognosis(Outlook.AGEING, reach(1.81e7, 4.44e7, 0.049))
    assert said(ageing_one, action=Action.CHANGE_NOW) == "No prognosis: the fluid is to be changed now."
