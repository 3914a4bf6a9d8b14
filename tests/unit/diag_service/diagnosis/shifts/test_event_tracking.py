"""Events from gears, slip and load together, on hand-made signals."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.arrays import Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import LOCK_NS, MAX_SLIP_NS, DriveFinder

STEP_NS = 10_000_000
LOCK = LOCK_NS // STEP_NS
IDLE = 85.0
FAST = 200.0
PULL_PA = 3e5
CALIBRATION = nominal_calibration()
PRESSED = frozenset({
    Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.HUB_SPEED, Signal.INPUT1_SPEED, Signal.INPUT2_SPEED,
    Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE, Signal.PEDAL, Signal.ENGINE_TORQUE,
})  # fmt: skip
ASKED = frozenset({
    Signal.TARGET_GEAR, Signal.CURRENT_GEAR, Signal.ENGINE_SPEED, Signal.INPUT_SPEED, Signal.CLUTCH_TORQUE,
})  # fmt: skip
Piece = dict[str, float]
Found = tuple[str, int, int, int, int, str]


def piece(
    count: int,
    *,
    gear: int = 1,
    target: int | None = None,
    slip: float = 0.0,
    load: float = 0.0,
    pedal: float = 0.0,
    engine: float = FAST,
    torque: float = 0.0,
    off_slip: float = 60.0,
    off_load: float = 0.0,
) -> Piece:
    """Return some samples: slip and load of the clutch of the gear, and of the other one, which is empty as a rule."""
    target = gear if target is None else target
    shafts = (engine - slip, engine - off_slip)
    loads = (load, off_load)
    first, second = (shafts, loads) if gear % 2 else (shafts[::-1], loads[::-1])
    return {
        "count": count, "current_gear": gear, "target_gear": target, "hub_speed_rad_s": engine,
        "engine_speed_rad_s": engine, "input1_speed_rad_s": first[0], "input2_speed_rad_s": first[1],
        "input_speed_rad_s": engine - slip, "clutch1_pressure_pa": second[0], "clutch2_pressure_pa": second[1],
        "clutch_torque_nm": 80.0 if load else 0.0, "pedal_ratio": pedal, "engine_torque_nm": torque,
    }  # fmt: skip


def standing(count: int = 100) -> Piece:
    return piece(count, slip=IDLE, engine=IDLE)


def launching(count: int, slip: float = 80.0) -> Piece:
    return piece(count, slip=slip, load=PULL_PA, pedal=0.3, engine=150.0, torque=90.0)


def driving(count: int = 100, gear: int = 1, pedal: float = 0.3) -> Piece:
    return piece(count, gear=gear, load=PULL_PA, pedal=pedal, torque=90.0)


def locked(pedal: float = 0.3) -> Piece:
    """Return samples for longer than a clutch must stick until its slip is over."""
    return driving(LOCK + 10, pedal=pedal)


def columns_of(pieces: tuple[Piece, ...], signals: frozenset[Signal] = PRESSED) -> ColumnBatch:
    counts = [int(one["count"]) for one in pieces]
    rows = np.arange(sum(counts), dtype=np.int64)
    columns = {
        signal: Series(
            t_ns=rows * STEP_NS, sequence=rows, value=np.repeat([float(one[signal.value]) for one in pieces], counts)
        )
        for signal in signals
    }
    return ColumnBatch(columns=columns, watermark_ns=int(rows[-1]) * STEP_NS)


def summary(events: list[Event]) -> list[Found]:
    return [
        (one.kind.value, one.from_gear, one.to_gear, one.start_ns // STEP_NS, one.end_ns // STEP_NS, one.end_reason)
        for one in events
    ]


def found(*pieces: Piece, signals: frozenset[Signal] = PRESSED) -> list[Found]:
    finder = DriveFinder(signals, CALIBRATION)
    return summary(finder.feed(columns_of(pieces, signals)) + finder.flush())


@pytest.mark.parametrize("signals", [PRESSED, ASKED], ids=["pressures", "torque of both clutches"])
def test_a_launch_lasts_from_the_first_slip_under_load_until_the_clutch_is_locked(signals: frozenset[Signal]) -> None:
    assert found(standing(), launching(150), locked(), signals=signals) == [
        ("launch", 1, 1, 100, 250 + LOCK, EndReason.COMPLETE)
    ]


def upshift(count: int, gear: int, slip: float) -> Piece:
    """Return samples under power on the way to second gear."""
    return piece(count, gear=gear, target=2, slip=slip, load=PULL_PA, pedal=0.3, torque=90.0)


CREEPING = piece(60, slip=70.0, load=1.5e5, engine=IDLE)


@pytest.mark.parametrize(
    ("pieces", "events"),
    [
        pytest.param((standing(), launching(60), standing()), [("launch", 1, 1, 100, 160, EndReason.ABANDONED)],
                     id="a foot that lifts aborts a launch"),
        pytest.param((standing(), launching(60), piece(40, slip=60.0, pedal=0.3), launching(90), locked()),
                     [("launch", 1, 1, 100, 290 + LOCK, EndReason.COMPLETE)],
                     id="a clutch may carry nothing for a moment while the foot stays"),
        pytest.param((standing(), launching(80), upshift(50, 1, 40.0), driving(gear=2)),
                     [("launch", 1, 1, 100, 180, EndReason.ABANDONED),
                      ("power_on_upshift", 1, 2, 180, 230, EndReason.COMPLETE)],
                     id="a shift interrupts a launch and takes over its slip"),
        pytest.param((standing(), launching(2000), driving()),
                     [("launch", 1, 1, 100, 100 + MAX_SLIP_NS // STEP_NS, EndReason.TOO_LONG)],
                     id="a launch that never ends is bounded"),
        pytest.param((standing(), launching(80)), [("launch", 1, 1, 100, 179, EndReason.INTERRUPTED)],
                     id="the end of the stream interrupts a launch"),
        pytest.param((standing(), CREEPING, launching(100), locked()),
                     [("creep", 1, 1, 100, 160, EndReason.ABANDONED),
                      ("launch", 1, 1, 160, 260 + LOCK, EndReason.COMPLETE)],
                     id="a pedal makes a launch of a creep"),
        pytest.param((standing(), CREEPING, locked(pedal=0.0)), [("launch", 1, 1, 100, 160 + LOCK, EndReason.COMPLETE)],
                     id="a creep that ends in lock was a launch"),
        pytest.param((driving(), piece(60, slip=30.0, load=PULL_PA, pedal=0.8), locked()),
                     [("slip", 1, 1, 100, 160 + LOCK, EndReason.COMPLETE)],
                     id="a locked clutch that lets go in gear is told"),
        pytest.param((standing(), piece(200, gear=0, slip=40.0, load=PULL_PA), standing()), [],
                     id="neutral and open clutches are no events"),
        pytest.param((driving(), upshift(20, 1, 0.0), upshift(50, 2, 50.0), driving(gear=2)),
                     [("power_on_upshift", 1, 2, 100, 170, EndReason.COMPLETE)],
                     id="a change lasts until its slip has ended, where the gears agree already"),
    ],
)  # fmt: skip
def test_events_begin_and_end_where_slip_load_and_gears_say(pieces: tuple[Piece, ...], events: list[Found]) -> None:
    assert found(*pieces) == events


@pytest.mark.parametrize(
    ("from_gear", "to_gear", "pedal", "torque", "kind"),
    [
        (3, 4, 0.3, 90.0, EventKind.POWER_ON_UPSHIFT),
        (3, 4, 0.0, -20.0, EventKind.POWER_OFF_UPSHIFT),
        (3, 4, 0.04, 60.0, EventKind.POWER_ON_UPSHIFT),  # hardly pressed, but the engine drives
        (3, 4, 0.0, 60.0, EventKind.POWER_OFF_UPSHIFT),  # a foot that has just come off
        (4, 3, 0.04, 60.0, EventKind.POWER_ON_DOWNSHIFT),
        (4, 3, 0.04, -20.0, EventKind.COAST_DOWNSHIFT),
        (4, 3, 0.0, -20.0, EventKind.COAST_DOWNSHIFT),
        (4, 3, 0.3, 60.0, EventKind.POWER_ON_DOWNSHIFT),
        (4, 3, 0.9, 60.0, EventKind.KICKDOWN),
        (6, 4, 0.3, 60.0, EventKind.POWER_ON_SKIP),
        (5, 3, 0.0, -20.0, EventKind.COAST_SKIP),
    ],
)
def test_changes_are_told_by_gears_pedal_and_torque(
    from_gear: int, to_gear: int, pedal: float, torque: float, kind: EventKind
) -> None:
    before = piece(100, gear=from_gear, load=PULL_PA, pedal=pedal, torque=torque)
    during = piece(40, gear=from_gear, target=to_gear, load=PULL_PA, pedal=pedal, torque=torque)
    assert [one[0] for one in found(before, during, driving(gear=to_gear, pedal=pedal))] == [kind]


def test_a_change_with_open_clutches_is_a_regear() -> None:
    assert [one[0] for one in found(piece(90, gear=2, slip=30.0), piece(6, gear=2, target=1), standing())] == ["regear"]


pieces = st.builds(
    piece,
    st.integers(1, 120),
    gear=st.integers(0, 3),
    target=st.none() | st.integers(1, 3),
    slip=st.sampled_from((0.0, 3.0, 20.0, 80.0)),
    load=st.sampled_from((0.0, PULL_PA)),
    off_load=st.sampled_from((0.0, PULL_PA)),
    pedal=st.sampled_from((0.0, 0.3)),
    engine=st.sampled_from((IDLE, FAST)),
)


@settings(max_examples=60, deadline=None)
@given(
    drive=st.lists(pieces, min_size=1, max_size=14),
    cuts=st.lists(st.integers(1, 1500), max_size=12),
    signals=st.sampled_from((PRESSED, ASKED)),
)
def test_cutting_the_stream_anywhere_changes_no_event(
    drive: list[Piece], cuts: list[int], signals: frozenset[Signal]
) -> None:
    whole = columns_of(tuple(drive), signals)
    last = whole.watermark_ns // STEP_NS + 1

    def walked(rows: list[int]) -> list[Found]:
        finder = DriveFinder(signals, CALIBRATION)
        events: list[Event] = []
        for start, stop in pairwise(rows):
            cut = {name: one.between(start * STEP_NS, stop * STEP_NS) for name, one in whole.columns.items()}
            events += finder.feed(ColumnBatch(columns=cut, watermark_ns=(stop - 1) * STEP_NS))
        return summary(events + finder.flush())

    assert walked(sorted({0, last, *(cut for cut in cuts if cut < last)})) == walked([0, last])
