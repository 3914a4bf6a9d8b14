"""Bus time that knows nothing of the wall clock: kernel time stamps, freed of the steps that the clock makes.

The kernel stamps frames with the wall clock, which users and time servers set. Its distance to the time since boot
tells steps from the clock's own slow correction: a step is taken out, the correction is left in. Without a step the
times are the kernel's to the bit, and so those of a recording of the same bus.
"""

import time
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from diag_service.records import Int64Array

NS_PER_US: Final = 1_000
MIN_STEP_NS: Final = 5_000_000  # two readings of a clock may be interrupted between
SLEW_RATIO: Final = 0.001  # twice what a kernel slews at most
SLACK_NS: Final = 5_000_000


class ClockReading(NamedTuple):
    """Two clocks at one moment."""

    wall_ns: int  # since the epoch, as set by whomever
    boot_ns: int  # since boot, suspended time included


def read_clocks() -> ClockReading:
    """Return what the system's clocks show."""
    return ClockReading(time.clock_gettime_ns(time.CLOCK_REALTIME), time.clock_gettime_ns(time.CLOCK_BOOTTIME))


class BusClock:
    """Turns kernel time stamps into bus time; looks at the clocks whenever frames are about to be read.

    A step between two looks may have come before or after a frame that arrived between them: the frame counts as
    stamped before it if that puts it between the two looks. A step while frames are being read is seen too late for
    them; their time jumps, which ends the segment.
    """

    def __init__(self, read: Callable[[], ClockReading] = read_clocks) -> None:
        self._read = read
        self._last = read()
        self._offset_ns = 0  # wall clock minus bus time
        self._step_count = 0
        self._before: tuple[int, int, int] | None = None  # offset before a step, and the two looks around it, bus time

    @property
    def step_count(self) -> int:
        """Steps of the wall clock until now."""
        return self._step_count

    def look(self) -> None:
        """Compare the clocks."""
        now, last = self._read(), self._last
        self._last, self._before = now, None
        elapsed_ns = now.boot_ns - last.boot_ns
        step_ns = (now.wall_ns - last.wall_ns) - elapsed_ns
        if abs(step_ns) > MIN_STEP_NS + SLEW_RATIO * elapsed_ns:
            earliest_ns = last.wall_ns - self._offset_ns
            self._before = (self._offset_ns, earliest_ns - SLACK_NS, earliest_ns + elapsed_ns + SLACK_NS)
            self._offset_ns += round(step_ns / NS_PER_US) * NS_PER_US  # the stamps are in whole microseconds
            self._step_count += 1

    def bus_time_ns(self, stamp_ns: Int64Array) -> Int64Array:
        """Return the bus time of frames that arrived since the look before the last, shape (n,)."""
        times: Int64Array = stamp_ns - self._offset_ns
        if self._before is None:
            return times
        offset_ns, earliest_ns, latest_ns = self._before
        before = stamp_ns - offset_ns
        return np.where((before >= earliest_ns) & (before <= latest_ns), before, times)
