"""Sends a candump log over UDP multicast, faster than it was recorded; for tests that need a live bus, not dynamics."""

import random
import time
from collections.abc import Sequence

import can

from tests.plugins.drives import send_time_s

INTERFACE = "udp_multicast"


def free_group() -> str:
    """Return a multicast group that no other test is likely to use."""
    return f"239.74.{random.randrange(256)}.{random.randrange(256)}"  # noqa: S311 - no secret


class Replay:
    """The sending end of a bus."""

    def __init__(self, group: str, lines: Sequence[bytes], speed_ratio: float = 4.0) -> None:
        self._bus = can.Bus(group, interface=INTERFACE, fd=False)
        self._lines = lines
        self._speed_ratio = speed_ratio
        self._next = 0

    def send_until(self, end_s: float) -> int:
        """Send the frames before ``end_s`` since the beginning of the log; return how many were sent in all."""
        origin_s = send_time_s(self._lines[0])
        start_s = send_time_s(self._lines[self._next]) - origin_s
        started_s = time.monotonic()
        while self._next < len(self._lines):
            line = self._lines[self._next]
            at_s = send_time_s(line) - origin_s
            if at_s >= end_s:
                break
            time.sleep(max(0.0, started_s + (at_s - start_s) / self._speed_ratio - time.monotonic()))
            self._bus.send(_message(line))
            self._next += 1
        return self._next

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def _message(line: bytes) -> can.Message:
    identifier, payload = line.split()[2].decode("ascii").split("#")
    return can.Message(arbitration_id=int(identifier, 16), data=bytes.fromhex(payload), is_extended_id=False)
