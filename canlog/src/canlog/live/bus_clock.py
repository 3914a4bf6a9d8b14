"""Bus time: kernel time stamps without the steps of the wall clock.

The kernel stamps frames with the wall clock, which users and time servers set. Its distance to the time since boot
tells steps from the clock's own slow correction: a step is taken out, the correction is left in. Without a step the
times are the kernel's to the bit, and so those of a recording of the same bus.
"""

import ctypes
import errno
import os
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NamedTuple

import numpy as np

from canlog.arrays import Int64Array

NS_PER_US: Final = 1_000
MIN_STEP_NS: Final = 5_000_000  # several times what two readings may be apart
MAX_GAP_NS: Final = 1_000_000  # longest time between two readings of one moment
TRY_COUNT: Final = 5
SLEW_RATIO: Final = 0.001  # twice what a kernel slews at most
SLACK_NS: Final = 5_000_000
STALE_NS: Final = 1_000_000_000  # a look at least once a second, while there are frames
TFD_FLAGS: Final = os.O_NONBLOCK | os.O_CLOEXEC  # as Linux defines TFD_NONBLOCK and TFD_CLOEXEC
TFD_TIMER_ABSTIME: Final = 1
TFD_TIMER_CANCEL_ON_SET: Final = 2
NEVER_S: Final = 2**33  # an expiry in the year 2242
_TIMES: Final = struct.Struct("=4q")  # interval and expiry, each in seconds and nanoseconds
_COUNT_BYTES: Final = 8


class ClockAlarm:
    """A descriptor that becomes readable when the wall clock is set: a timer for no time, cancelled by that.

    Raises
    ------
    OSError
        If this system has no such timers.
    """

    def __init__(self, expiry_s: int = NEVER_S) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        self._descriptor = int(library.timerfd_create(time.CLOCK_REALTIME, TFD_FLAGS))
        if self._descriptor < 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        flags = TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET
        if library.timerfd_settime(self._descriptor, flags, _TIMES.pack(0, 0, expiry_s, 0), None) != 0:
            number = ctypes.get_errno()
            self.close()
            raise OSError(number, os.strerror(number))

    def fileno(self) -> int:
        return self._descriptor

    def acknowledge(self) -> bool:
        """Return whether the clock was set since the last time this was asked; the alarm goes on."""
        try:
            os.read(self._descriptor, _COUNT_BYTES)
        except OSError as exc:
            return exc.errno == errno.ECANCELED
        return False

    def close(self) -> None:
        """Give the descriptor back; a second call does nothing."""
        with suppress(OSError):
            os.close(self._descriptor)
        self._descriptor = -1


def clock_alarm(expiry_s: int = NEVER_S) -> ClockAlarm | None:
    """Return an alarm, or None where there can be none."""
    try:
        return ClockAlarm(expiry_s)
    except (OSError, AttributeError):
        return None


class ClockReading(NamedTuple):
    """Two clocks at one moment."""

    wall_ns: int  # since the epoch
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

    With a `ClockAlarm` not every batch needs a look: `look_if_stale` looks for frames stamped far from the last one.
    """

    def __init__(self, read: Callable[[], ClockReading | None] = read_clocks) -> None:
        self._read = read
        self._last = read()
        self._offset_ns = 0  # wall clock minus bus time
        self._newest_ns: int | None = None  # bus time of the last frame
        self.step_count = 0
        self._before: tuple[int, int, int] | None = None  # offset before a step, and the two looks around it, bus time

    def look(self) -> None:
        """Compare the clocks; does nothing on a machine too busy to read both at one moment."""
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
            self.step_count += 1

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
