"""Rev detection on hand-made signals."""

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.shifts.run_ups import HIGH_RAD_S, LOW_RAD_S, MARGIN_NS, RunUpFinder
from tests.support.run_ups import CLOSED_PA, RUN_UP_ROWS, STEP_NS, Piece, idle, run_up, whole_batch


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
