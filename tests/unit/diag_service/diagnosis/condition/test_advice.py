"""The sentence on one clutch: what its friction is and how sure that is; what to do is no matter of one clutch."""

import re
from dataclasses import replace
from typing import Final

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Causes, ClutchVerdict, Condition, FluidFill, LikelyCause
from diag_service.diagnosis.condition.condition import ConditionMemory, PairClutch, judge, no_verdict
from diag_service.diagnosis.condition.verdict import likely
from diag_service.diagnosis.summary import Gap, order_by, unjudged
from tests.support.builders import friction_trend, shift_result
from tests.unit.diag_service.diagnosis.condition.test_condition import believed

CALIBRATION = nominal_calibration()


def verdict_on(
    mu_c: float, mu_s: float, *, previous: Condition = Condition.NO_VERDICT, **known: float
) -> ClutchVerdict:
    state = believed(mu_c, mu_s, std=known.get("std", 0.001), shift_count=int(known.get("shift_count", 5)))
    return judge(ConditionMemory(conditions=(previous, previous)), PairClutch.of(state, 2, CALIBRATION))[1]


@pytest.mark.parametrize(
    ("mu_c", "mu_s", "sentence"),
    [
        (0.140, 0.119, "Clutch 2: its friction is sound (over 99 % sure)."),
        (0.133, 0.125, "Clutch 2: more than half of its margin against shudder is gone (99 % sure)."),
        (0.119, 0.137, "Clutch 2: it can shudder (over 99 % sure)."),
        (0.105, 0.085, "Clutch 2: its friction is below 80 % of new (98 % sure)."),
    ],
)
def test_a_verdict_says_why_and_how_sure_it_is_and_gives_no_order(mu_c: float, mu_s: float, sentence: str) -> None:
    assert verdict_on(mu_c, mu_s).advice == sentence


def test_a_verdict_that_merely_stands_says_what_to_do_and_what_calls_it_off() -> None:
    told = (
        "(26 % sure now, at least 95 % before: measure again on another drive; the verdict stands until that falls "
        "below 20 %)."
    )
    assert str(verdict_on(0.1295, 0.1285, previous=Condition.CHANGE_FLUID).advice).endswith(told)


@pytest.mark.parametrize(
    ("probability", "said"),
    [(0.0, "under 0.1 %"), (0.0004, "under 0.1 %"), (0.0006, "0.1 %"), (0.206, "20.6 %"), (1.0, "over 99.9 %")],
)
def test_nothing_is_said_to_be_certain_or_impossible(probability: float, said: str) -> None:
    assert likely(probability) == f"{said} likely"


def test_a_fluid_of_which_nobody_is_sure_is_not_called_sound_without_saying_so() -> None:
    verdict = verdict_on(0.1315, 0.1205, std=0.0004)  # half of the margin left, and known as well as it ever is
    assert verdict.condition is Condition.GOOD
    assert verdict.advice is not None
    assert order_by((shift_result(), replace(shift_result(), verdict=replace(verdict, clutch=1))), None).sentence == (
        "Nothing to do now, but measure again after more drives: the fluid seems sound."
    )
    (percent,) = re.findall(r"\((\d+) % sure\)", verdict.advice)
    assert 20 < int(percent) < 80


@pytest.mark.parametrize(
    ("verdict", "sentence"),
    [
        (verdict_on(0.14, 0.119, shift_count=1), "fewer than 3 of its shifts could be used"),
        (verdict_on(0.14, 0.119, std=0.02), "its friction is not known well enough yet"),
        (no_verdict(2, "clutch pressures"), "the signals of this vehicle do not tell its friction"),
        (unjudged(shift_result(), (Gap.LOG_CUT,)).verdict, "only a part of the drive was seen"),
    ],
)
def test_where_there_is_no_verdict_the_sentence_says_what_would_help(verdict: ClutchVerdict, sentence: str) -> None:
    assert verdict.condition is Condition.NO_VERDICT
    assert verdict.advice is not None
    assert verdict.advice.startswith("Clutch 2: ")
    assert sentence in verdict.advice


NOT_NOTED: Final = (
    "Was the fluid changed? Friction is as after a fill that nobody noted; diag-service fluid-changed notes it."
)


@pytest.mark.parametrize(
    ("change", "causes", "fluid", "notes"),
    [
        (0.17, None, None, (NOT_NOTED,)),
        (0.06, None, None, ()),  # as friction may rise by itself
        (-0.17, None, None, ()),
        (0.17, None, FluidFill(vehicle="car1", filled_at="2025-12-01T00:00:00.000000Z"), ()),
        (0.01, "renewed-fluid", None, (NOT_NOTED,)),
        (0.17, "torque-sensor", None, ()),  # a sensor that drifted feigns it
    ],
)
def test_a_fill_that_nobody_noted_is_asked_about(
    change: float, causes: str | None, fluid: FluidFill | None, notes: tuple[str, ...]
) -> None:
    since = replace(friction_trend(), change_mu_c_ratio=change, std_change_mu_c_ratio=0.015)
    told = None if causes is None else why(causes, 0.93)
    results = [shift_result(number, to_gear=1 + number) for number in (1, 2)]
    results = [replace(one, verdict=replace(one.verdict, trend=since, causes=told)) for one in results]
    order = order_by(results, fluid)
    assert order.notes == notes
    assert order.text.endswith(notes or "sure).")


def why(cause: str, probability: float, aged: float = 0.05) -> Causes:
    likely = (
        LikelyCause(cause="sound", clutch=None, probability=0.95 - probability, evidence=""),
        LikelyCause(cause=cause, clutch=2, probability=probability, evidence=""),
        LikelyCause(cause="aged-fluid", clutch=None, probability=aged, evidence=""),
    )
    return Causes(event_count=60, likely=likely, advice="", test=None)


@pytest.mark.parametrize(
    ("mu", "causes", "sentence"),
    [
        ((0.105, 0.085), None, "Change the fluid now."),
        ((0.105, 0.085), why("glazed-lining", 0.54),
         "See to another cause than the fluid first: glazed lining of clutch 2 (54 % likely)."),
        ((0.105, 0.085), why("glazed-lining", 0.46), "Change the fluid now."),
        ((0.105, 0.085), why("water", 0.94), "See to this first: water in the fluid (94 % likely)."),
        ((0.140, 0.119), why("wrong-fluid", 0.93), "See to this first: another fluid than specified (93 % likely)."),
        ((0.140, 0.119), why("aged-fluid", 1.0), "Nothing to do now: the fluid is sound."),
        ((0.105, 0.085), why("weak-pump", 0.97, aged=0.99),
         "See to another cause than the fluid first: weak pump of clutch 2 (97 % likely)."),
        ((0.140, 0.119), why("weak-pump", 0.85), "Nothing to do now: the fluid is sound."),
        ((0.140, 0.119), why("return-spring", 0.997),
         "Have something else than the fluid looked at: return spring of clutch 2 (over 99 % likely)."),
    ],
)  # fmt: skip
def test_new_fluid_is_not_ordered_for_what_it_does_not_mend(
    mu: tuple[float, float], causes: Causes | None, sentence: str
) -> None:
    verdict = replace(verdict_on(*mu), causes=causes)
    both = [replace(shift_result(), verdict=replace(verdict, clutch=clutch)) for clutch in (1, 2)]
    assert order_by(both, None).sentence == sentence
