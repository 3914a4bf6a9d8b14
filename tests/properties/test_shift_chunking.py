"""However the stream is cut, the same shifts come out."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from canlog.arrays import Series
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from tests.support.gears import STEP_NS

gear_runs = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(1, 120)), min_size=1, max_size=12)
cuts = st.lists(st.integers(0, 1500), max_size=12)


def drive(runs: list[tuple[int, int, int]]) -> dict[Signal, Series]:
    """Gears in one message, a pressure in another with its own phase."""
    gears = np.array([run[:2] for run in runs for _ in range(run[2])], dtype=np.float64)
    rows = np.arange(len(gears), dtype=np.int64)
    pressure_ns = rows * STEP_NS + STEP_NS // 3
    return {
        Signal.CURRENT_GEAR: Series(t_ns=rows * STEP_NS, sequence=rows, value=gears[:, 0]),
        Signal.TARGET_GEAR: Series(t_ns=rows * STEP_NS, sequence=rows, value=gears[:, 1]),
        Signal.CLUTCH1_PRESSURE: Series(t_ns=pressure_ns, sequence=rows, value=rows.astype(np.float64)),
    }


def between(columns: dict[Signal, Series], start_ns: int, stop_ns: int) -> ColumnBatch:
    cut = {signal: series.between(start_ns, stop_ns) for signal, series in columns.items()}
    return ColumnBatch(
        columns=cut,
        watermark_ns=max(int(series.t_ns[-1]) for series in cut.values() if len(series.t_ns)),
        bad_frame_ns=cut[Signal.CLUTCH1_PRESSURE].t_ns[::37],
    )


def fingerprint(event: Event) -> tuple[object, ...]:
    bits = {signal: (series.t_ns.tobytes(), series.value.tobytes()) for signal, series in event.columns.items()}
    return event.number, event.from_gear, event.to_gear, event.start_ns, event.end_ns, event.end_reason, bits


@given(gear_runs, cuts)
def test_cutting_the_stream_anywhere_changes_no_event(runs: list[tuple[int, int, int]], rows: list[int]) -> None:
    columns = drive(runs)
    end_ns = int(columns[Signal.CLUTCH1_PRESSURE].t_ns[-1]) + 1
    whole = ShiftFinder()
    # The frames between which the stream is cut carry their samples' own times, as on a bus.
    grid_ns = sorted({0, end_ns, *(row * STEP_NS // 2 for row in rows if row * STEP_NS // 2 < end_ns)})
    pieces = ShiftFinder()
    expected = whole.feed(between(columns, 0, end_ns)) + whole.flush()
    found = []
    for start_ns, stop_ns in pairwise(grid_ns):
        has_samples = any(len(series.between(start_ns, stop_ns).t_ns) for series in columns.values())
        if has_samples:
            found += pieces.feed(between(columns, start_ns, stop_ns))
    found += pieces.flush()
    assert [fingerprint(event) for event in found] == [fingerprint(event) for event in expected]
