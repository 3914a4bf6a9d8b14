"""A service whose interface is switched off or removed in the middle of a shift, again and again.

A sender drives one unfinished shift after another. Each round takes the interface away while a shift is open and gives
it back, then waits until the service says that it reads it again.
"""

import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from canlog.e2e.profile1 import COUNTER_PERIOD
from ecu_emulator.bus.frames import FrameEncoder
from ecu_emulator.sensing import Readings
from tests.support.beside import Beside
from tests.support.service import Ended, Service, service
from tests.support.wire import CONTRACTS, DATABASE
from tests.uml.vcan import create_vcan, ip_link

CYCLE_S = 0.01
OPEN_AFTER = 30  # frames with equal gears before the target moves
RETURNED = "is read again after"
_FRAME = struct.Struct("=IB3x8s")
_PERIOD = 2 * OPEN_AFTER  # a multiple of the alive counter's period: the payloads repeat


def shift_payloads() -> list[bytes]:
    """Return the frames of one round: gears equal, then a shift that does not end."""
    rows = np.arange(_PERIOD, dtype=np.float64)
    values = {
        "current_gear": np.ones(_PERIOD),
        "target_gear": np.where(rows < OPEN_AFTER, 1.0, 2.0),
        "preselected_gear": np.full(_PERIOD, 2.0),
        "shift_phase": np.zeros(_PERIOD),
    }
    frames = FrameEncoder(DATABASE).encode(Readings(message="TCU_Shift", t_s=rows * CYCLE_S, values=values))
    return [bytes(row) for row in frames.data]


class ShiftSender(Beside):
    """Sends gears at their cycle time while it is entered; an interface that is away only makes it wait."""

    def __init__(self, channel: str) -> None:
        super().__init__()
        self.channel = channel
        self.is_shifting = threading.Event()
        self._begin = 0  # of the payloads, for the counter that comes next

    def _work(self) -> None:
        while not self._is_over.is_set():
            with suppress(OSError), socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
                raw.bind((self.channel,))
                self._drive(raw)
            self._is_over.wait(CYCLE_S)

    def _drive(self, raw: socket.socket) -> None:
        """Send one shift after the other until the interface fails; alive counters go on where they were."""
        payloads = shift_payloads()
        while True:
            for number, payload in enumerate(payloads):
                if number < self._begin:
                    continue
                raw.send(_FRAME.pack(CONTRACTS["TCU_Shift"].can_id, 8, payload))
                self._begin = (number + 1) % COUNTER_PERIOD
                if number < OPEN_AFTER:
                    self.is_shifting.clear()
                elif number > OPEN_AFTER + 5:
                    self.is_shifting.set()
                if self._is_over.wait(CYCLE_S):
                    return


def switch(name: str) -> None:
    """Switch an interface off and on."""
    if not (ip_link("set", name, "down") and ip_link("set", name, "up")):
        raise RuntimeError(f"cannot switch {name}")


def recreate(name: str) -> None:
    """Remove an interface and make it again."""
    if not (ip_link("delete", name) and create_vcan(name)):
        raise RuntimeError(f"cannot make {name} again")


CALAMITIES: tuple[Callable[[str], None], ...] = (switch, recreate)


def run_cycles(folder: Path, channel: str, count: int) -> Ended:
    """Take the interface away ``count`` times during a shift; return how the service ended."""
    bus = ("run", "-i", "socketcan", "-c", channel, "--json", "--store", folder / "car.sqlite")
    with service(folder, *bus) as running, ShiftSender(channel) as sender:
        running.wait_for(lambda: "listening" in running.err)
        for number in range(count):
            time.sleep(4 * CYCLE_S)
            running.wait_for(sender.is_shifting.is_set)
            known = returns(running)  # one calamity may be two to the service, if it looks in between
            CALAMITIES[number % len(CALAMITIES)](channel)
            running.wait_for(lambda known=known: returns(running) > known)  # type: ignore[misc]
            sender.is_shifting.clear()
        running.process.terminate()
        return running.wait()


def returns(running: Service) -> int:
    """Return how often the service said that it reads its bus again."""
    return running.err.count(RETURNED)
