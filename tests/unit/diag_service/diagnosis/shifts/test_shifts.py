"""Shift detection on hand-made gear signals."""

import pytest

from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason
from diag_service.diagnosis.shifts.shifts import POST_NS, PRE_NS, ShiftFinder
from tests.support.gears import STEP_NS, gear_batch


def test_a_shift_is_reported_with_its_history() -> None:
    gears = [(1, 1)] * 100 + [(1, 2)] * 90 + [(2, 2)] * 100
    events = ShiftFinder().feed(gear_batch(gears))
    assert [(event.from_gear, event.to_gear, event.number) for event in events] == [(1, 2, 1)]
    event = events[0]
    assert event.end_reason is EndReason.COMPLETE
    assert event.start_ns == 100 * STEP_NS
    assert event.end_ns == 190 * STEP_NS
    cut = event.columns[Signal.TARGET_GEAR].t_ns
    assert cut[0] == event.start_ns - PRE_NS
    assert cut[-1] == event.end_ns + POST_NS - STEP_NS


def test_a_shift_is_not_reported_before_its_signals_are_complete() -> None:
    gears = [(1, 1)] * 10 + [(1, 2)] * 90 + [(2, 2)] * 100
    finder = ShiftFinder()
    reported = [len(finder.feed(gear_batch(gears[row : row + 1], first_row=row))) for row in range(len(gears))]
    assert reported.index(1) == 100 + POST_NS // STEP_NS + 1
    assert sum(reported) == 1


def test_a_change_of_mind_abandons_the_first_shift() -> None:
    gears = [(2, 2)] * 50 + [(2, 3)] * 30 + [(2, 1)] * 80 + [(1, 1)] * 50
    events = ShiftFinder().feed(gear_batch(gears))
    assert [(event.to_gear, event.end_reason) for event in events] == [
        (3, EndReason.ABANDONED),
        (1, EndReason.COMPLETE),
    ]


def test_the_end_of_the_stream_interrupts_an_open_shift() -> None:
    finder = ShiftFinder()
    assert finder.feed(gear_batch([(1, 1)] * 50 + [(1, 2)] * 30)) == []
    assert [event.end_reason for event in finder.flush()] == [EndReason.INTERRUPTED]
    assert finder.flush() == []


def test_a_jump_of_bus_time_interrupts_an_open_shift_and_starts_afresh() -> None:
    finder = ShiftFinder()
    finder.feed(gear_batch([(1, 1)] * 50 + [(1, 2)] * 30))
    second = gear_batch([(1, 1)] * 50 + [(1, 2)] * 80 + [(2, 2)] * 50, breaks_before=True)
    assert [(event.number, event.end_reason) for event in finder.feed(second)] == [
        (1, EndReason.INTERRUPTED),
        (2, EndReason.COMPLETE),
    ]


@pytest.mark.parametrize("cut", [1, 7, 300])
def test_a_shift_that_was_on_before_the_stream_is_no_complete_one(cut: int) -> None:
    gears = [(1, 2)] * 40 + [(2, 2)] * 60 + [(2, 3)] * 80 + [(3, 3)] * 60
    finder = ShiftFinder()
    events = [
        event
        for row in range(0, len(gears), cut)
        for event in finder.feed(gear_batch(gears[row : row + cut], first_row=row))
    ]
    assert [event.end_reason for event in events] == [EndReason.INTERRUPTED, EndReason.COMPLETE]
