"""Sensors and truth do not depend on how the plant's rows are cut into chunks."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from ecu_emulator.scenario.faults import NOMINAL_SENSORS, Sensors
from ecu_emulator.sensing import QUANTITIES, Installation, Readings, Schedule, SensorSuite
from ecu_emulator.shift_control.tcu_data import CLOSED_REVS, OPEN_REVS
from ecu_emulator.truth import RevWatcher, ShiftWatcher
from tests.unit.ecu_emulator.rows import made_up_rows, with_revs, with_shift

COUNT = 1500
ROWS = with_shift(with_shift(made_up_rows(COUNT), 200, 700, 1, 2), 900, 1300, 2, 3)
REVVED = with_revs(ROWS, [(100, 200, OPEN_REVS), (200, 400, OPEN_REVS), (800, 1000, CLOSED_REVS)])
CUTS = st.lists(st.integers(0, COUNT), max_size=12).map(lambda inner: [0, *sorted(inner), COUNT])
PLACE = Installation(
    crank_segment_rad=2.0,
    output_ratio=4.0,
    wheel_radius_m=0.3,
    ambient_temperature_k=290.0,
    odometer_m=0.0,
)
SCHEDULES = (
    Schedule(message="fast", sender="ECM", cycle_ms=10, phase_ms=3, quantities=tuple(sorted(QUANTITIES)[::2])),
    Schedule(message="slow", sender="TCU", cycle_ms=70, phase_ms=0, quantities=tuple(sorted(QUANTITIES)[1::2])),
)


def read_all(cuts: list[int], sensors: Sensors) -> dict[str, FloatArray]:
    suite = SensorSuite(schedules=SCHEDULES, sensors=sensors, installation=PLACE, startup_s={"ECM": 0.1}, seed=3)
    readings: list[Readings] = [part for start, stop in pairwise(cuts) for part in suite.read(ROWS[start:stop])]
    return {
        quantity: np.concatenate([part.values[quantity] for part in readings if quantity in part.values])
        for quantity in QUANTITIES
    }


@settings(max_examples=40, deadline=None)
@given(cuts=CUTS, latency_s=st.floats(0.0, 0.1), lag_s=st.sampled_from([0.0, 0.02]))
def test_readings_are_the_same_for_any_chunking(cuts: list[int], latency_s: float, lag_s: float) -> None:
    sensors = {
        quantity: replace(sensor, latency_s=latency_s, lag_s=lag_s) for quantity, sensor in NOMINAL_SENSORS.items()
    }
    whole, pieces = read_all([0, COUNT], sensors), read_all(cuts, sensors)
    for quantity in QUANTITIES:
        assert np.array_equal(whole[quantity], pieces[quantity], equal_nan=True), quantity


@settings(max_examples=40, deadline=None)
@given(cuts=CUTS)
def test_the_truth_is_the_same_for_any_chunking(cuts: list[int]) -> None:
    watcher = ShiftWatcher()
    found = [shift for start, stop in pairwise(cuts) for shift in watcher.feed(ROWS[start:stop])]
    assert found == ShiftWatcher().feed(ROWS)
    rev_watcher = RevWatcher()
    revs = [rev for start, stop in pairwise(cuts) for rev in rev_watcher.feed(REVVED[start:stop])]
    assert revs == RevWatcher().feed(REVVED)
    assert [rev.are_clutches_closed for rev in revs] == [False, False, True]
    assert [(shift.number, shift.from_gear, shift.to_gear) for shift in found] == [(1, 1, 2), (2, 2, 3)]
