"""What people read of a prognosis: a range, never a single distance."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import Passage, Prognosis, prognose
from diag_service.diagnosis.prognosis.passage import DISTANCE_M
from diag_service.diagnosis.prognosis.prognosis import Outlook, Reach
from diag_service.diagnosis.prognosis.sentence import outlook_line
from tests.support.pasts import REFERENCE, ageing, past

NEVER = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))


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


def prognosis(outlook: Outlook, watch: Reach | None = None, change: Reach | None = None) -> Prognosis:
    return Prognosis(
        clutch=2,
        outlook=outlook,
        row_count=3,
        odometer_m=1.0e7,
        service_distance_m=1.5e7,
        fluid_starts=(),
        assumptions=(),
        watch=watch,
        change_fluid=change,
    )


def test_few_results_are_named() -> None:
    expected = "Clutch 2: no prognosis yet: it takes 8 usable results with this fluid, there are 3."
    assert outlook_line(prognosis(Outlook.TOO_FEW)) == expected


def test_without_a_trend_there_is_a_least_distance() -> None:
    far = reach(6.34e7, None, 0.01)
    expected = "Clutch 2: no trend yet; a change of the fluid is at least 63,000 km away (90 % sure)."
    assert outlook_line(prognosis(Outlook.NO_TREND, far, far)) == expected
    beyond = outlook_line(prognosis(Outlook.NO_TREND, far, reach(None, None, 0.0)))
    assert "at least 300,000 km" in beyond
    due = outlook_line(prognosis(Outlook.NO_TREND, far, reach(0.0, 1.0e7, 0.6)))
    assert "may be due for a change already" in due


@pytest.mark.parametrize(
    ("watch", "change", "expected"),
    [
        (
            reach(1.2e6, 9.87e6, 0.97),
            reach(1.81e7, 4.44e7, 0.049),
            (
                "the fluid ages; change it in 18,000 to 44,000 km (80 % sure), "
                "watch it in 1,200 to 9,900 km (80 % sure); 5 % that the change is due within the next 15,000 km."
            ),
        ),
        (
            reach(0.0, 0.0, 1.0),
            reach(0.0, 5.0e6, 0.999),
            (
                "the fluid ages; change it within 5,000 km (90 % sure), watch it now; "
                "more than 99 % that the change is due within the next 15,000 km."
            ),
        ),
        (
            reach(5.0e7, None, 0.0),
            reach(None, None, 0.0),
            (
                "the fluid ages; change it in more than 300,000 km, watch it in more than 50,000 km (90 % sure); "
                "less than 1 % that the change is due within the next 15,000 km."
            ),
        ),
    ],
)
def test_an_ageing_fluid_has_ranges(watch: Reach, change: Reach, expected: str) -> None:
    assert outlook_line(prognosis(Outlook.AGEING, watch, change)) == f"Clutch 2: {expected}"


def test_real_prognoses_have_a_sentence() -> None:
    for count in (5, 20, 200):
        found = prognose(1, past(ageing(200, until=0.3), step_m=2.0e5).first(count), REFERENCE)
        line = outlook_line(replace(found, service_distance_m=2.0e7))
        assert line.startswith("Clutch 1: ")
        assert line.endswith(".")
        assert "None" not in line
