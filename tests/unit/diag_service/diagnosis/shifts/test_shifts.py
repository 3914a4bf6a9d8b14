"""Shifts and run-ups, found in a stream."""

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.run_ups import HIGH_RAD_S, LOW_RAD_S, MARGIN_NS, RunUpFinder
from diag_service.diagnosis.shifts.shifts import POST_NS, PRE_NS, ShiftFinder
from tests.support.gears import STEP_NS, gear_batch
from tests.support.run_ups import CLOSED_PA, RUN_UP_ROWS, Piece, idle, run_up, whole_batch


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


def found(*pieces: Piece) -> list[Event]:
    finder = RunUpFinder(nominal_calibration())
    return finder.feed(whole_batch(pieces)) + finder.flush()


def test_run_ups_are_numbered_and_say_whether_the_clutches_are_closed() -> None:
    between = idle(pressure_pa=CLOSED_PA)
    events = found(idle(), run_up(), run_up(), between, run_up(CLOSED_PA), between)
    assert [(event.number, event.are_clutches_closed) for event in events] == [(1, False), (2, False), (3, True)]
    assert {event.end_reason for event in events} == {EndReason.COMPLETE}


def test_a_run_up_goes_from_low_speed_to_low_speed_with_a_margin() -> None:
    (event,) = found(idle(), run_up(), idle())
    speed = event.columns[Signal.ENGINE_SPEED]
    inside = speed.between(event.start_ns, event.end_ns).value
    assert inside.min() >= LOW_RAD_S
    assert inside.max() == pytest.approx(400.0)
    assert len(inside) < RUN_UP_ROWS
    assert speed.value[speed.t_ns == event.start_ns - STEP_NS] < LOW_RAD_S
    assert speed.value[speed.t_ns == event.end_ns] < LOW_RAD_S
    for series in event.columns.values():
        assert event.start_ns - MARGIN_NS <= series.t_ns[0] < event.start_ns - MARGIN_NS + STEP_NS
        assert event.end_ns + MARGIN_NS - STEP_NS <= series.t_ns[-1] < event.end_ns + MARGIN_NS


def test_no_run_up_in_gear() -> None:
    assert found(idle(gear=1), run_up(gear=1), idle(gear=1)) == []


def test_a_blip_of_the_pedal_is_no_run_up() -> None:
    assert found(idle(), run_up(top_rad_s=HIGH_RAD_S - 10.0), idle()) == []


@pytest.mark.parametrize("pressure_pa", [(0.0, 5.0e5), (4.0e5, 0.0), (1.5e5, 5.0e5), (1.0e5, 1.0e5)])
def test_clutches_neither_open_nor_closed_make_no_run_up(pressure_pa: tuple[float, float]) -> None:
    assert found(idle(pressure_pa=pressure_pa), run_up(pressure_pa), idle(pressure_pa=pressure_pa)) == []


def test_a_jump_of_bus_time_interrupts_an_open_run_up_and_starts_afresh() -> None:
    finder = RunUpFinder(nominal_calibration())
    assert finder.feed(whole_batch((idle(), Piece(speed_rad_s=run_up().speed_rad_s[:150])))) == []
    events = finder.feed(whole_batch((idle(), run_up(), idle()), breaks_before=True))
    assert [(event.number, event.end_reason) for event in events] == [
        (1, EndReason.INTERRUPTED),
        (2, EndReason.COMPLETE),
    ]
