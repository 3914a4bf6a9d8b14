"""Shifts without the pair of gear signals: from target and slip, from the current gear alone, from speeds."""

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from diag_service.diagnosis.columns import ColumnBatch, GearRatios, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.gear_tracking import tracker_for
from diag_service.diagnosis.shifts.shifts import DriveFinder, ShiftFinder

if TYPE_CHECKING:
    from diag_service.diagnosis.shifts.tracking import EventFinder

STEP_NS = 10_000_000
RATIOS = GearRatios(over=Signal.OUTPUT_SPEED, ratios=(4.0, 2.5, 1.5))
ENGINE_RAD_S = 200.0
TARGET_SIGNALS = frozenset({Signal.TARGET_GEAR, Signal.ENGINE_SPEED, Signal.INPUT_SPEED})
Bounds = tuple[int, int, int, int, EndReason]


def columns_of(**values: FloatArray) -> ColumnBatch:
    rows = np.arange(len(next(iter(values.values()))), dtype=np.int64)
    return ColumnBatch(
        columns={
            Signal(name): Series(t_ns=rows * STEP_NS, sequence=rows, value=np.asarray(value, np.float64))
            for name, value in values.items()
        },
        watermark_ns=int(rows[-1]) * STEP_NS,
    )


def bounds(events: list[Event]) -> list[Bounds]:
    """Return gears, first and last row, and how it ended."""
    return [
        (event.from_gear, event.to_gear, event.start_ns // STEP_NS, event.end_ns // STEP_NS, event.end_reason)
        for event in events
    ]


def shifts(finder: ShiftFinder, batch: ColumnBatch) -> list[Bounds]:
    return bounds(finder.feed(batch) + finder.flush())


def by_target(target: FloatArray, slip: FloatArray) -> list[Bounds]:
    batch = columns_of(
        target_gear=target, engine_speed_rad_s=np.full(len(slip), ENGINE_RAD_S), input_speed_rad_s=ENGINE_RAD_S - slip
    )
    return shifts(ShiftFinder(tracker_for(TARGET_SIGNALS)), batch)


def test_a_target_and_the_slip_bound_a_shift() -> None:
    target = np.repeat((1.0, 2.0), (50, 150))
    slip = np.repeat((0.0, 40.0, 1.0, 40.0, 0.0), (60, 20, 2, 30, 88))  # closes for two samples only: not the end
    assert by_target(target, slip) == [(1, 2, 50, 112, EndReason.COMPLETE)]


def test_the_ratio_of_speeds_bounds_a_shift() -> None:
    ratio = np.concatenate((np.full(50, 4.0), np.linspace(4.0, 2.5, 40), np.full(60, 2.5)))
    finder = ShiftFinder(tracker_for(frozenset({Signal.ENGINE_SPEED, Signal.OUTPUT_SPEED}), RATIOS))
    batch = columns_of(engine_speed_rad_s=np.full(150, ENGINE_RAD_S), output_speed_rad_s=ENGINE_RAD_S / ratio)
    ((from_gear, to_gear, start, end, reason),) = shifts(finder, batch)
    assert (from_gear, to_gear, reason) == (1, 2, EndReason.COMPLETE)
    assert start == pytest.approx(54, abs=1)  # 4 % off the first ratio
    assert end == pytest.approx(86, abs=2)


def test_the_current_gear_alone_tells_when_a_gear_was_left_and_reached() -> None:
    gears = np.repeat((3.0, 0.0, 4.0, 5.0), (50, 60, 80, 80))
    assert shifts(ShiftFinder(), columns_of(current_gear=gears)) == [
        (3, 4, 50, 110, EndReason.COMPLETE),
        (4, 5, 190, 190, EndReason.COMPLETE),
    ]


SPEEDS = frozenset({Signal.ENGINE_SPEED, Signal.OUTPUT_SPEED})


def launched(over: FloatArray, engine: FloatArray, target: FloatArray | None = None) -> list[tuple[str, Bounds]]:
    """Return what speeds, ratios and the target gear, where there is one, tell of a drive."""
    told = {} if target is None else {"target_gear": target}
    signals = SPEEDS | {Signal(name) for name in told}
    batch = columns_of(output_speed_rad_s=over, engine_speed_rad_s=engine, **told)
    finder = DriveFinder(signals, nominal_calibration(), RATIOS)
    events = finder.feed(batch) + finder.flush()
    return [(event.kind.value, found) for event, found in zip(events, bounds(events), strict=True)]


def set_in_motion(gear: int, *, idle_rows: int = 100, rows: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return output and engine speed of a car that stands, and whose clutch then locks in half of the rows."""
    over = np.concatenate((np.zeros(idle_rows), np.linspace(0.0, 200.0 / RATIOS.ratios[gear - 1], rows)))
    engine = np.maximum(over * RATIOS.ratios[gear - 1], np.repeat((80.0, 100.0), (idle_rows, rows)))
    return over, engine


def test_speeds_alone_tell_a_launch() -> None:
    ((kind, (from_gear, to_gear, start, end, reason)),) = launched(*set_in_motion(1))
    assert (kind, from_gear, to_gear, start, reason) == ("launch", 1, 1, 100, EndReason.COMPLETE)
    assert end == pytest.approx(200, abs=5)


def test_a_target_and_ratios_bound_a_shift() -> None:
    over = np.full(200, 50.0)
    engine = np.concatenate((np.full(70, 200.0), np.linspace(200.0, 125.0, 40), np.full(90, 125.0)))
    ((kind, (from_gear, to_gear, start, end, reason)),) = launched(over, engine, np.repeat((1.0, 2.0), (50, 150)))
    assert (kind, from_gear, to_gear, start, reason) == ("shift", 1, 2, 50, EndReason.COMPLETE)
    assert end == pytest.approx(109, abs=3)


runs = st.lists(st.tuples(st.integers(0, 3), st.sampled_from((0.0, 3.0, 40.0)), st.integers(1, 90)), max_size=14)
cuts = st.lists(st.integers(1, 1200), max_size=10)


@given(runs=runs.filter(bool), cuts=cuts, kind=st.sampled_from(("target", "ratio", "current", "drive")))
def test_cutting_the_stream_anywhere_changes_no_shift(
    runs: list[tuple[int, float, int]], cuts: list[int], kind: str
) -> None:
    gears = np.array([gear for gear, _, count in runs for _ in range(count)], np.float64)
    slip = np.array([slip for _, slip, count in runs for _ in range(count)])
    tracker_signals = {
        "target": TARGET_SIGNALS,
        "ratio": frozenset({Signal.ENGINE_SPEED, Signal.OUTPUT_SPEED}),
        "current": frozenset({Signal.CURRENT_GEAR, Signal.TARGET_GEAR}),
        "drive": SPEEDS | {Signal.TARGET_GEAR},
    }[kind]
    whole = columns_of(
        **{"current_gear" if kind == "current" else "target_gear": gears},
        engine_speed_rad_s=np.full(len(gears), ENGINE_RAD_S),
        input_speed_rad_s=ENGINE_RAD_S - slip,
        output_speed_rad_s=ENGINE_RAD_S / np.array((40.0, *RATIOS.ratios))[gears.astype(int)],
    )

    def found(rows: list[int]) -> list[Bounds]:
        finder: EventFinder = ShiftFinder(tracker_for(tracker_signals, RATIOS if kind == "ratio" else None))
        if kind == "drive":
            finder = DriveFinder(tracker_signals, nominal_calibration(), RATIOS)
        events: list[Event] = []
        for start, stop in pairwise(rows):
            cut = {name: one.between(start * STEP_NS, stop * STEP_NS) for name, one in whole.columns.items()}
            events += finder.feed(ColumnBatch(columns=cut, watermark_ns=(stop - 1) * STEP_NS))
        return bounds(events + finder.flush())

    ends = [0, len(gears)]
    assert found(sorted({*ends, *(cut for cut in cuts if cut < len(gears))})) == found(ends)
