"""What people read of a prognosis: a range, never a single distance, and nothing that contradicts the order."""

import numpy as np
import pytest

from clutch_results.prognosis import Passage, Prognosis
from clutch_results.prognosis.channels import DISTANCE_M
from clutch_results.prognosis.prognosis import Outlook, Reach
from clutch_results.prognosis.sentence import outlook_line
from fleet_contract.orders import Action

NEVER = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))
UNKNOWN = "How far the fluid will go cannot be said yet."


def reach(p10_m: float | None, p90_m: float | None, chance: float) -> Reach:
    return Reach(p10_m=p10_m, p50_m=None, p90_m=p90_m, probability_before_service=chance, passage=NEVER)


def prognosis(outlook: Outlook, change: Reach | None = None, *, clutch: int = 2, left_out_count: int = 0) -> Prognosis:
    return Prognosis(
        clutch=clutch,
        outlook=outlook,
        row_count=3,
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
