"""Frames of a tester on a bus, and who else asks there: two testers on one bus receive each other's answers."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import can

from canlog.live.pythoncan import one_line
from diag_service.errors import ControllerError, StoppedError
from workshop.tester.addresses import CanAddress, id_text, is_request

LISTEN_S: Final = 5.0  # S3 of a controller (ISO 14229-2), longest pause of a tester with a session
CLASSIC_BYTES: Final = 8  # of a frame of a request
PADDING: Final = 0xCC  # ISO 15765-2: fewest stuff bits
_PATIENCE_S: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardTraffic:
    """Traffic on a bus before the first request."""

    duration_s: float
    frame_count: int
    can_ids: frozenset[int]
    error_count: int = 0  # error frames

    def __str__(self) -> str:
        if not self.frame_count:
            return f"nothing was heard in {self.duration_s:g} s"
        rate_hz = self.frame_count / self.duration_s
        return f"{self.frame_count} frames of {len(self.can_ids)} identifiers in {self.duration_s:g} s, {rate_hz:.0f}/s"

    def other_testers(self, address: CanAddress | None = None) -> tuple[int, ...]:
        """Return identifiers of requests by other testers: those of the standard, and that of an address."""
        addressed = set() if address is None else {address.request_id}
        return tuple(sorted(can_id for can_id in self.can_ids if is_request(can_id) or can_id in addressed))


def send(bus: can.BusABC, message: can.Message) -> None:
    """Send a frame; raises ControllerError if the bus refuses it."""
    try:
        bus.send(message, timeout=1.0)
    except (can.CanError, OSError, ValueError) as exc:
        why = f"the bus does not take a request: {one_line(exc)}"
        raise ControllerError(f"{why}: is the ignition on, and is the bit rate that of the car?") from exc


def receive(bus: can.BusABC, patience_s: float) -> can.Message | None:
    """Return the next frame, None after the timeout; raises ControllerError if the bus cannot be read."""
    try:
        return bus.recv(patience_s)
    except (can.CanError, OSError, ValueError) as exc:
        raise ControllerError(f"the bus cannot be read: {one_line(exc)}") from exc


def listen(bus: can.BusABC, duration_s: float = LISTEN_S, goes_on: Callable[[], bool] = lambda: True) -> HeardTraffic:
    """Return the traffic on a bus during a time.

    Raises ControllerError if the bus cannot be read, StoppedError if ``goes_on`` returns False.
    """
    until_s = time.monotonic() + duration_s
    frame_count = error_count = 0
    can_ids = set[int]()
    while (left_s := until_s - time.monotonic()) > 0.0:
        if not goes_on():
            raise StoppedError("stopped early: nothing was asked")
        message = receive(bus, min(_PATIENCE_S, left_s))
        if message is None:
            continue
        if message.is_error_frame:
            error_count += 1
            continue
        frame_count += 1
        can_ids.add(message.arbitration_id)
    return HeardTraffic(
        duration_s=duration_s, frame_count=frame_count, can_ids=frozenset(can_ids), error_count=error_count
    )


def check_alone(traffic: HeardTraffic, address: CanAddress | None = None) -> None:
    """Raise ControllerError if there is another tester: two on one bus receive each other's answers."""
    if others := traffic.other_testers(address):
        named = ", ".join(map(id_text, others))
        raise ControllerError(f"another tester is asking on this bus (requests on {named}): nothing was asked")
