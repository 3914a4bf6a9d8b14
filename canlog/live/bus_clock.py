"""Bus time that knows nothing of the wall clock: kernel time stamps, freed of the steps that the clock makes.

The kernel stamps frames with the wall clock, which users and time servers set. Its distance to the time since boot
tells steps from the clock's own slow correction: a step is taken out, the correction is left in. Without a step the
times are the kernel's to the bit, and so those of a recording of the same bus.
"""

import time
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import Int64Array

NS_PER_US: Final = 1_000
MIN_STEP_NS: Final = 5_000_000  # several times what two readings may be apart
MAX_GAP_NS: Final = 1_000_000  # between the readings of two clocks, beyond which they were not taken at one moment
TRY_COUNT: Final = 5
SLEW_RATIO: Final = 0.001  # twice what a kernel slews at most
SLACK_NS: Final = 5_000_000
STALE_NS: Final = 1_000_000_000  # a look at least once a second, while there are frames


class ClockReading(NamedTuple):
    """Two clocks at one moment."""

    wall_ns: int  # since the epoch, as set by whomever
    boot_ns: int  # since boot, suspended time included


def read_clocks() -> ClockReading | None:
    """Return what the system's clocks show, or None if the process was held up between them in every try."""
    for _ in range(TRY_COUNT):
        before_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        gap_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - before_ns
        if gap_ns <= MAX_GAP_NS:
            return ClockReading(wall_ns, before_ns + gap_ns // 2)
    return None


class BusClock:
    """Turns kernel time stamps into bus time; looks at the clocks whenever frames are about to be read.

    A step between two looks may have come before or after a frame that arrived between them: the frame counts as
    stamped before it if that puts it between the newest frame known and the look. A step while frames are being read
    is seen too late for them; their time jumps, which ends the segment.

    Who is told when the clock is set need not look for every frame: frames that are stamped far from the last look
    ask for another one by themselves.
    """

    def __init__(self, read: Callable[[], ClockReading | None] = read_clocks) -> None:
        self._read = read
        self._last = read()
        self._offset_ns = 0  # wall clock minus bus time
        self._newest_ns: int | None = None  # bus time of the last frame
        self._step_count = 0
        self._before: tuple[int, int, int] | None = None  # offset before a step, and the two looks around it, bus time

    @property
    def step_count(self) -> int:
        """Steps of the wall clock until now."""
        return self._step_count

    def look(self) -> None:
        """Compare the clocks; on a machine too busy to read both at one moment, the next look tells."""
        now, last = self._read(), self._last
        self._before = None
        if now is None:
            return
        self._last = now
        if last is None:
            return
        elapsed_ns = now.boot_ns - last.boot_ns
        step_ns = (now.wall_ns - last.wall_ns) - elapsed_ns
        if abs(step_ns) > MIN_STEP_NS + SLEW_RATIO * elapsed_ns:
            looked_ns = last.wall_ns - self._offset_ns
            earliest_ns = looked_ns if self._newest_ns is None else max(looked_ns, self._newest_ns)
            self._before = (self._offset_ns, earliest_ns - SLACK_NS, looked_ns + elapsed_ns + SLACK_NS)
            self._offset_ns += round(step_ns / NS_PER_US) * NS_PER_US  # the stamps are in whole microseconds
            self._step_count += 1

    def look_if_stale(self, stamp_ns: int) -> None:
        """Look unless a step was just seen, or this frame was stamped soon after the last look."""
        if self._before is not None:
            return
        if self._last is None or not -SLACK_NS <= stamp_ns - self._last.wall_ns <= STALE_NS:
            self.look()

    def end_of_backlog(self) -> None:
        """Take note that all frames which arrived before the last look have got their time."""
        self._before = None

    def bus_time_ns(self, stamp_ns: Int64Array) -> Int64Array:
        """Return the bus time of frames that arrived since those before, shape (n,)."""
        times: Int64Array = stamp_ns - self._offset_ns if self._offset_ns else stamp_ns
        if self._before is not None:
            offset_ns, earliest_ns, latest_ns = self._before
            before = stamp_ns - offset_ns
            times = np.where((before >= earliest_ns) & (before <= latest_ns), before, times)
        if len(times):
            self._newest_ns = int(times[-1])
        return times
