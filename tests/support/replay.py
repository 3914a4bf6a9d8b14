"""Sends a candump log over UDP multicast, faster than it was recorded; for tests that need a live bus, not dynamics."""

import json
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass

import can

from tests.plugins.drives import send_time_s

INTERFACE = "udp_multicast"


@dataclass(frozen=True, slots=True, kw_only=True)
class UdpBus:
    """A bus of our own: every group on one port hears every other, so the port differs too."""

    group: str
    port: int

    @property
    def variables(self) -> dict[str, str]:
        """Environment in which a program that uses python-can finds the port."""
        return {"CAN_CONFIG": json.dumps({"port": self.port})}


def free_bus() -> UdpBus:
    """Return a multicast group and a port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    return UdpBus(group=f"239.74.{port % 256}.{port // 256}", port=port)


class Replay:
    """The sending end of a bus."""

    def __init__(self, bus: UdpBus, lines: Sequence[bytes], speed_ratio: float = 4.0) -> None:
        self._bus = can.Bus(bus.group, interface=INTERFACE, port=bus.port, fd=False)
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
