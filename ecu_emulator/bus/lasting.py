"""A bus that is opened again when its adapter was pulled or its interface was away, as the service does."""

import errno
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import can
import can.typechecking
from can.interfaces.socketcan import SocketcanBus

from canlog.live.pythoncan import one_line
from ecu_emulator.errors import BusError

LOST: Final = frozenset({errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.ENETUNREACH})
STUCK_S: Final = 2.0  # drivers of adapters have error codes of their own: so long none of its frames passes
RETRY_S: Final = 0.1
JOIN_S: Final = 3.0  # for a driver that does not return


class LastingBus(can.BusABC):
    """Passes frames to a bus, and opens that again for as long as it takes when it is lost.

    While it is away each frame is refused with ``can.CanOperationError`` of ENETDOWN, and nothing is heard.

    Parameters
    ----------
    bus
        The first opening, which this object owns from now on.
    name
        Of the bus, for people.
    reopen
        Opens the bus anew; raises BusError where that cannot be yet.
    say
        Gets a line when the bus is lost, and one when a frame passes again, from the thread that sends.
    stuck_s
        A bus through which no frame has passed for so long is lost, too [s]; None: the error alone tells.
    """

    def __init__(
        self,
        bus: can.BusABC,
        name: str,
        reopen: Callable[[], can.BusABC],
        say: Callable[[str], None],
        *,
        stuck_s: float | None = STUCK_S,
    ) -> None:
        self._bus: can.BusABC | None = bus
        self._name = name
        self._reopen = reopen
        self._say = say
        self._stuck_s = stuck_s
        self._filters_wanted: can.typechecking.CanFilters | None = None
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._opener: threading.Thread | None = None
        self._lost_s: float | None = None  # until a frame passes again
        self._failing_s: float | None = None
        super().__init__(channel=name)
        self.channel_info = bus.channel_info

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        bus = self._bus
        if bus is None:
            raise can.CanOperationError(f"{self._name} is away", errno.ENETDOWN)
        try:
            bus.send(msg, timeout)
        except (can.CanError, OSError, ValueError) as exc:
            if bus is self._bus and not self._is_lost(exc):
                raise
            self._lose(bus, exc)
            raise can.CanOperationError(f"{self._name} is away: {one_line(exc)}", errno.ENETDOWN) from exc
        self._failing_s = None
        if self._lost_s is not None:
            with self._lock:
                lost_s, self._lost_s = self._lost_s, None
            if lost_s is not None:
                self._say(f"{self._name} is there again after {time.monotonic() - lost_s:.1f} s")

    def shutdown(self) -> None:
        super().shutdown()
        self._closing.set()
        if self._opener is not None:
            self._opener.join(JOIN_S)
        with self._lock:
            bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        bus = self._bus
        if bus is None:
            self._closing.wait(RETRY_S if timeout is None else timeout)
            return None, True
        return bus.recv(timeout), True  # what it sends will say what is wrong with it

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        with self._lock:
            self._filters_wanted = filters
            if self._bus is not None:
                self._bus.set_filters(filters)

    def _is_lost(self, error: Exception) -> bool:
        """Return whether an error says that the bus must be opened again; a full buffer empties by itself."""
        if not isinstance(error, can.CanError):
            return isinstance(error, OSError)  # of a serial port, for one
        if error.error_code in LOST:
            return True
        now_s = time.monotonic()
        self._failing_s = now_s if self._failing_s is None else self._failing_s
        return self._stuck_s is not None and now_s - self._failing_s > self._stuck_s

    def _lose(self, bus: can.BusABC, error: Exception) -> None:
        """Let a bus go, say so unless that was said, and try to open it again."""
        with self._lock:
            if bus is not self._bus or self._closing.is_set():
                return
            self._bus = self._failing_s = None
            is_news = self._lost_s is None
            self._lost_s = time.monotonic() if self._lost_s is None else self._lost_s
            self._opener = threading.Thread(target=self._open_again, args=(bus,), name="bus opener", daemon=True)
            self._opener.start()
        if is_news:
            self._say(f"{self._name} is lost: {_cause(error)}; waiting for its return")

    def _open_again(self, lost: can.BusABC) -> None:
        with suppress(can.CanError, OSError, ValueError):  # there is nothing left to close
            lost.shutdown()
        while not self._closing.wait(RETRY_S):
            try:
                bus = self._reopen()
            except BusError:
                continue
            with self._lock:
                if not self._closing.is_set():
                    bus.set_filters(self._filters_wanted)
                    self._bus = bus
                    return
            bus.shutdown()


def _cause(error: Exception) -> str:
    """Return what an error says, without its number where that is one of the system's own."""
    code = error.error_code if isinstance(error, can.CanError) else getattr(error, "errno", None)
    return os.strerror(code) if code in LOST else one_line(error)


def lasting(open_: Callable[[], can.BusABC], name: str, say: Callable[[str], None]) -> can.BusABC:
    """Open a bus and keep it open; one with a time of its own, such as a simulation's, ends when it ends.

    Parameters
    ----------
    open_
        Opens it; raises BusError.
    name
        What the user asked for, empty if that is left to the configuration.
    say
        Gets lines for people.
    """
    bus = open_()
    if getattr(bus, "clock", None) is not None:
        return bus
    # Alone on a bus nobody acknowledges: the kernel's buffer stays full, and the interface is not lost.
    return LastingBus(
        bus, name or bus.channel_info, open_, say, stuck_s=None if isinstance(bus, SocketcanBus) else STUCK_S
    )
