"""When alarms begin and end: a value that swings a little raises one alarm, not many."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.alarms.rules import (
    AlarmEvent,
    Limits,
    RuleFinding,
    Subject,
    due_finding,
    heard_last,
    odometer_finding,
    quality_finding,
    score_finding,
    transitions,
)
from tests.support.fleet import NOW
from tests.support.fleet_page import clutch_now

LIMITS = Limits()


def happened(findings: list[RuleFinding]) -> list[AlarmEvent]:
    """Return what becomes of one alarm while findings come one after the other."""
    open_subjects = set[Subject]()
    events = []
    for finding in findings:
        for step in transitions([finding], open_subjects, NOW):
            open_subjects ^= {step.subject}
            events.append(step.event)
    return events


def test_a_probability_that_swings_about_a_limit_raises_one_alarm() -> None:
    swing = [0.1, 0.49, 0.51, 0.49, 0.51, 0.31, 0.29, 0.31, 0.49]
    assert happened([due_finding(clutch_now("a", 1), one, "soon", LIMITS) for one in swing]) == [
        AlarmEvent.RAISED,
        AlarmEvent.CLEARED,
    ]
    lost = [
        due_finding(clutch_now("a", 1), 0.9, "soon", LIMITS),
        due_finding(clutch_now("a", 1), None, "no trend yet", LIMITS),
    ]
    assert happened(lost) == [AlarmEvent.RAISED, AlarmEvent.CLEARED]


@given(st.lists(st.floats(0.0, 1.0), max_size=30))
def test_an_alarm_is_raised_and_cleared_in_turn(chances: list[float]) -> None:
    events = happened([due_finding(clutch_now("a", 1), one, "soon", LIMITS) for one in chances])
    assert events == [AlarmEvent.RAISED, AlarmEvent.CLEARED] * (len(events) // 2) + [AlarmEvent.RAISED] * (
        len(events) % 2
    )


@pytest.mark.parametrize(
    ("unused", "events", "is_wrong"), [(19, 19, None), (25, 50, True), (20, 50, None), (12, 50, False), (0, 0, None)]
)
def test_a_few_events_say_nothing_of_the_data(unused: int, events: int, is_wrong: bool | None) -> None:
    found = quality_finding(clutch_now("a", 2), unused, events, LIMITS)
    assert found.is_wrong is is_wrong
    assert f"{unused} of the last {events} events of clutch 2" in found.reason


def test_a_score_that_falls_is_an_alarm_until_it_is_nearly_back() -> None:
    falls = [None, 3.0, 14.0, 15.5, 12.0, 8.5, None, 7.0, 14.0]
    assert happened([score_finding(clutch_now("a", 1), one, LIMITS) for one in falls]) == [
        AlarmEvent.RAISED,
        AlarmEvent.CLEARED,
    ]
    assert "clutch 1 score 16 points less" in score_finding(clutch_now("a", 1), 15.5, LIMITS).reason


@pytest.mark.parametrize(
    ("readings_m", "is_wrong"), [([], False), ([1e7, 2e7], False), ([1e7, 1e9, 2e7], True), ([4e7, 1e7], True)]
)
def test_an_odometer_that_went_back_or_leapt_is_an_alarm(readings_m: list[float], is_wrong: bool) -> None:
    found = odometer_finding(clutch_now("a", 1), readings_m, LIMITS)
    assert found.is_wrong is is_wrong
    assert happened([found]) == [AlarmEvent.RAISED] * is_wrong


def test_a_clock_that_is_wrong_neither_hides_nor_makes_silence() -> None:
    year_9999, of_a_log, long_ago = (datetime(year, 1, 1, tzinfo=UTC) for year in (9999, 2024, 2025))
    assert heard_last((year_9999, long_ago), NOW) == long_ago
    assert heard_last((of_a_log, NOW), NOW) == NOW
    assert heard_last((year_9999, None), NOW) is None
    assert heard_last((datetime(1970, 1, 2, tzinfo=UTC),), NOW) is None
