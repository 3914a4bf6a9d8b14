"""Word from the kernel that somebody has set the wall clock, so that nobody has to look at it for every frame."""

import ctypes
import errno
import os
import struct
import time
from contextlib import suppress
from typing import Final

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
        """Return the descriptor to wait for."""
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
