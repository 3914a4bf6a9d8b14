"""However the stream is cut, the same run-ups come out."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from tests.support.run_ups import CLOSED_PA, OPEN_PA, STEP_NS, Piece, batch_between, columns_of, idle, run_up

CALIBRATION = nominal_calibration()
PRESSURES = st.sampled_from([OPEN_PA, CLOSED_PA])
GEARS = st.sampled_from([0, 0, 0, 1])
PIECES = st.one_of(
    st.builds(run_up, PRESSURES, top_rad_s=st.floats(120.0, 420.0), gear=GEARS),
    st.builds(lambda rows, gear: idle(rows, gear=gear), st.integers(1, 150), GEARS),
    st.builds(
        lambda rows, speed_rad_s: Piece(speed_rad_s=np.full(rows, speed_rad_s)),
        st.integers(1, 1200),
        st.floats(60.0, 400.0),
    ),
)
CUTS = st.lists(st.integers(0, 6000), max_size=12)


def fingerprint(event: Event) -> tuple[object, ...]:
    bits = {signal: (series.t_ns.tobytes(), series.value.tobytes()) for signal, series in event.columns.items()}
    what = event.number, event.start_ns, event.end_ns, event.are_clutches_closed, event.end_reason
    return *what, event.bad_frame_count, bits


@given(st.lists(PIECES, min_size=1, max_size=8), CUTS)
def test_cutting_the_stream_anywhere_changes_no_event(pieces: list[Piece], rows: list[int]) -> None:
    columns = columns_of(pieces)
    end_ns = max(int(series.t_ns[-1]) for series in columns.values()) + 1
    whole_batch = batch_between(columns, 0, end_ns)
    assert whole_batch is not None
    whole, cut = RunUpFinder(CALIBRATION), RunUpFinder(CALIBRATION)
    expected = whole.feed(whole_batch) + whole.flush()
    # Every millisecond may be a cut, so that the samples of one instant's messages fall apart.
    grid_ns = sorted({0, end_ns, *(row * STEP_NS // 10 * 7 for row in rows if row * STEP_NS // 10 * 7 < end_ns)})
    found = []
    for start_ns, stop_ns in pairwise(grid_ns):
        batch = batch_between(columns, start_ns, stop_ns)
        if batch is not None:
            found += cut.feed(batch)
    found += cut.flush()
    assert [fingerprint(event) for event in found] == [fingerprint(event) for event in expected]
