"""What is foretold of a clutch from its past: outlooks, distances with their doubt, fluids, assumptions."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.condition.verdict import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from diag_service.diagnosis.prognosis import History, Outlook, Prognosis, prognose
from diag_service.diagnosis.prognosis.prognosis import Reach
from tests.support.pasts import REFERENCE, ageing, past

STEP_M = 1.0e5
COUNT = 400  # 40,000 km


def reach(found: Prognosis) -> Reach:
    assert found.change_fluid is not None
    return found.change_fluid


def distance_m(value: float | None) -> float:
    assert value is not None
    return value


@pytest.mark.parametrize("seed", range(4))
def test_an_even_fall_reaches_its_limit_inside_the_interval(seed: int) -> None:
    found = prognose(1, past(ageing(COUNT, until=0.4), step_m=STEP_M, seed=seed), REFERENCE)
    assert found.outlook is Outlook.AGEING
    change, watch = reach(found), found.watch
    assert watch is not None
    truth_m = 0.4 / 0.6 * STEP_M * COUNT
    assert distance_m(change.p10_m) < truth_m < distance_m(change.p90_m)
    assert distance_m(change.p10_m) < distance_m(change.p50_m) < distance_m(change.p90_m)
    assert distance_m(watch.p90_m) < 5.0e6  # half of the margin was gone 6,000 km ago
    assert distance_m(change.p50_events) == pytest.approx(distance_m(change.p50_m) * 2.0 / STEP_M)


def test_the_limits_are_those_of_the_verdict() -> None:
    falling = np.linspace(1.0, CHANGE_LEVEL_RATIO - 0.02, COUNT)
    found = prognose(1, past(np.ones(COUNT), level=falling, step_m=STEP_M), REFERENCE)
    assert found.level is not None
    assert reach(found).passage.within(0.0) > 0.7
    watch = np.linspace(1.0, WATCH_LEVEL_RATIO - 0.03, COUNT)
    found = prognose(1, past(np.ones(COUNT), level=watch, step_m=STEP_M), REFERENCE)
    assert found.watch is not None
    assert found.watch.passage.within(0.0) > 0.7
    assert reach(found).passage.within(0.0) < 0.1


@pytest.mark.parametrize("is_noted", [True, False])
def test_after_new_fluid_the_future_is_long_again_and_the_lining_is_told(is_noted: bool) -> None:
    margin = np.concatenate((ageing(300, until=0.3), np.linspace(1.0, 0.9, 60)))
    level = np.concatenate((np.linspace(1.0, 0.92, 300), np.linspace(0.97, 0.96, 60)))
    filled = past(margin, level=level, step_m=STEP_M, fills=(300,) if is_noted else ())
    before, after = prognose(1, filled.first(300), REFERENCE), prognose(1, filled, REFERENCE)
    assert distance_m(reach(before).p50_m) < 2.5e7 < distance_m(reach(after).p50_m)
    assert [start.is_noted for start in after.fluid_starts] == [True, is_noted]
    assert after.lining is not None
    assert abs(after.lining.mean + 0.03) < 3.0 * after.lining.std < 0.03
    told = [line for line in after.assumptions if "not noted" in line]
    assert len(told) == (0 if is_noted else 1)


def test_a_fluid_of_unknown_age_is_not_taken_for_new() -> None:
    worn = replace(past(np.full(40, 0.4), step_m=1.0e4), new_fluids=())
    new = past(np.ones(40), step_m=1.0e4)
    found = prognose(1, worn, REFERENCE)
    assert found.margin is not None
    assert found.margin.now.mean == pytest.approx(0.4, abs=0.1)
    assert distance_m(reach(found).p10_m) < distance_m(reach(prognose(1, new, REFERENCE)).p10_m)


def with_late_knee(share: float, *, factor: float = 3.5, knee: float = 0.77, count: int = 800) -> tuple[History, float]:
    """Return the past at a share of a life whose wear becomes some times as fast, and what is left of it [m]."""
    at = np.arange(count) / count
    worn = at + (factor - 1.0) * np.maximum(at - knee, 0.0)
    margin = 1.0 - worn / (1.0 + (factor - 1.0) * (1.0 - knee))
    return past(margin, step_m=STEP_M).first(int(share * count)), (1.0 - share) * count * STEP_M


@pytest.mark.parametrize("share", [0.5, 0.65, 0.75])
def test_a_late_knee_to_come_is_inside_the_interval(share: float) -> None:
    history, left_m = with_late_knee(share)
    early_m, late_m = reach(prognose(1, history, REFERENCE)).passage.quantiles_m(np.array([0.05, 0.95]))
    assert early_m < left_m < late_m


@pytest.mark.parametrize("step_m", [5.0e4, 2.0e5])
def test_more_wear_over_the_same_distance_makes_a_life_shorter(step_m: float) -> None:
    medians_m = [
        distance_m(reach(prognose(1, past(ageing(COUNT, until=until), step_m=step_m), REFERENCE)).p50_m)
        for until in (0.7, 0.5, 0.3, 0.1)
    ]
    assert medians_m == sorted(medians_m, reverse=True)
