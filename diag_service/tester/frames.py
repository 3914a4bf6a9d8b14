"""Frames of requests: how long they are, what fills them, how they get onto a bus; needs no library of an extra."""

from typing import Final

import can

from canlog.live.pythoncan import one_line
from diag_service.errors import ControllerError

CLASSIC_BYTES: Final = 8
PADDING: Final = 0xCC  # ISO 15765-2: the bits stuffed least


def send(bus: can.BusABC, message: can.Message) -> None:
    """Put a frame on a bus; raises ControllerError if the bus does not take it."""
    try:
        bus.send(message, timeout=1.0)
    except (can.CanError, OSError, ValueError) as exc:
        raise ControllerError(f"the bus does not take a request: {one_line(exc)}") from exc
