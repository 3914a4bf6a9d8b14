"""Bus time does not follow the wall clock: moved by hours or stepped during a shift, every bit of an estimate stays."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from canlog.arrays import Int64Array
from canlog.frames import FrameBatch
from canlog.live.bus_clock import BusClock, ClockReading
from clutch_results.records import Status
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.chain import Outcome, diagnosed
from tests.support.wire import received

NS_PER_S = 1_000_000_000
HOURS_NS = 2 * 3600 * NS_PER_S
DRAIN_NS = 10_000_000
UPTIME_NS = 12_345 * NS_PER_S
DURATION_S = 6.0  # one shift and the beginning of the next


class Clocks:
    """The clocks of a machine whose user moves the wall clock at some moments."""

    def __init__(self, start_ns: int, steps: dict[int, int]) -> None:
        self._start_ns = start_ns
        self._steps = steps  # true time -> step
        self.true_ns = start_ns

    def wall_ns(self, true_ns: Int64Array) -> Int64Array:
        """Return what the wall clock shows at true times."""
        shown = true_ns.copy()
        for when, step in self._steps.items():
            shown[true_ns >= when] += step
        return shown

    def read(self) -> ClockReading:
        """Return what both clocks show now."""
        wall = int(self.wall_ns(np.array([self.true_ns]))[0])
        return ClockReading(wall, UPTIME_NS + self.true_ns - self._start_ns)


@cache
def frames() -> FrameBatch:
    return received(next(Drive(drive_scenario()).stretches(DURATION_S)).frames)


@cache
def undisturbed() -> Outcome:
    return diagnosed([frames()])


def heard(steps: dict[int, int]) -> tuple[list[FrameBatch], BusClock]:
    """Return the batches that a receiver hands on whose machine's clock is moved; true times after the start [ns]."""
    batch = frames()
    start_ns = int(batch.t_ns[0])
    clocks = Clocks(start_ns, {start_ns + after: step for after, step in steps.items()})
    clock = BusClock(clocks.read)
    stamps = clocks.wall_ns(batch.t_ns)
    drains = np.arange(start_ns, batch.t_ns[-1] + 2 * DRAIN_NS, DRAIN_NS)
    batches: list[FrameBatch] = []
    for earlier, now in pairwise(np.searchsorted(batch.t_ns, drains).tolist()):
        clocks.true_ns = int(drains[len(batches) + 1])
        clock.look()
        piece = batch[earlier:now]
        batches.append(replace(piece, t_ns=clock.bus_time_ns(stamps[earlier:now])))
    return batches, clock


def shift_middle_ns() -> int:
    estimate = undisturbed().diagnoses[0].estimate
    assert estimate.status is Status.VALID
    return (estimate.start_ns + estimate.end_ns) // 2 - int(frames().t_ns[0])


@pytest.mark.parametrize("step_ns", [HOURS_NS, -HOURS_NS, NS_PER_S // 5, -NS_PER_S // 5])
def test_a_clock_that_steps_during_a_shift_changes_no_bit(step_ns: int) -> None:
    batches, clock = heard({shift_middle_ns() + 3_456_789: step_ns})
    assert clock.step_count == 1
    assert diagnosed(batches).fingerprint == undisturbed().fingerprint


def test_a_small_step_told_at_once_moves_neither_the_frames_before_nor_those_after() -> None:
    """The receiver is told between two frames that it reads together."""
    clocks = Clocks(NS_PER_S, {NS_PER_S + 330_000_000: -50_000_000})
    clock = BusClock(clocks.read)
    true_ns = np.arange(NS_PER_S, NS_PER_S + 600_000_000, 10_000_000)
    for first in range(0, len(true_ns), 2):
        part = true_ns[first : first + 2]
        before = clocks.true_ns
        clocks.true_ns = int(part[-1])
        if before < NS_PER_S + 330_000_000 <= clocks.true_ns:
            clock.look()
        stamps = clocks.wall_ns(part)
        clock.look_if_stale(int(stamps[-1]))
        assert clock.bus_time_ns(stamps).tolist() == part.tolist()
        clock.end_of_backlog()
    assert clock.step_count == 1
