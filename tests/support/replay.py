"""Sends a candump log over UDP multicast, faster than it was recorded; for tests that need a live bus, not dynamics."""

import json
import os
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import can

from tests.plugins.drives import send_time_s
from tests.support.patience import HANG_S

INTERFACE = "udp_multicast"
LOOK_EVERY = 32  # frames; of the 212 kB that a socket holds, they take 25
BEHIND_BYTES = 50_000


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
    """The sending end of a bus; it waits for a receiver that is behind, whose socket would drop what does not fit."""

    def __init__(self, bus: UdpBus, lines: Sequence[bytes], speed_ratio: float = 4.0) -> None:
        self._bus = can.Bus(bus.group, interface=INTERFACE, port=bus.port, fd=False)
        self._port = bus.port
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
            if self._next % LOOK_EVERY == 0:
                self._wait_for_receivers()
        return self._next

    def _wait_for_receivers(self) -> None:
        deadline_s = time.monotonic() + HANG_S
        own = str(os.fstat(self._bus.fileno()).st_ino)  # hears itself, and nobody reads that
        while max(_waiting_bytes(self._port, own), default=0) > BEHIND_BYTES:
            assert time.monotonic() < deadline_s, "a receiver takes nothing"
            time.sleep(0.01)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def _waiting_bytes(port: int, own_inode: str) -> list[int]:
    """Return what waits in the receive buffers of all other sockets on a port, as the kernel tells it."""
    rows = [line.split() for line in Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]]
    return [
        int(row[4].split(":")[1], 16) for row in rows if int(row[1].split(":")[1], 16) == port and row[9] != own_inode
    ]


def _message(line: bytes) -> can.Message:
    identifier, payload = line.split()[2].decode("ascii").split("#")
    return can.Message(arbitration_id=int(identifier, 16), data=bytes.fromhex(payload), is_extended_id=False)
