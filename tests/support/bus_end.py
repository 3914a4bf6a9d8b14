"""A third party on a vcan: it waits for the moment at which something happens, and sends what does not belong there."""

import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path

import psutil

from tests.support.beside import Beside
from tests.support.patience import HANG_S
from tests.support.wire import CONTRACTS, DATABASE

_FRAME = struct.Struct("=IB3x8s")
STRANGER_ID = 0x7A0  # in no database
_QUIET_S = 0.5
_RECEIVERS = Path("/proc/net/can")
RECEIVE_BYTES = str(8 << 20)  # ten seconds of bus: what a busy machine may keep a program waiting for


def listener_count(channel: str) -> int:
    """Return how often the kernel hands frames of a bus on."""
    return sum(path.read_text(encoding="ascii").count(f" {channel} ") for path in _RECEIVERS.glob("rcvlist_*"))


def wait_for_listener(channel: str, count: int, process: "subprocess.Popen[bytes] | subprocess.Popen[str]") -> None:
    """Return when a program that does not say so listens: when frames of the bus are handed on so often."""
    deadline_s = time.monotonic() + HANG_S
    while listener_count(channel) < count:
        assert process.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@contextmanager
def candump(channel: str, path: Path) -> Iterator[None]:
    """Record a bus with can-utils' candump, from before this yields until the bus has been quiet."""
    before = listener_count(channel)
    with (
        path.open("wb") as log,
        subprocess.Popen(["candump", "-L", "-r", RECEIVE_BYTES, channel], stdout=log) as process,
    ):
        wait_for_listener(channel, before + 1, process)
        yield
        written, dump = -1, psutil.Process(process.pid)
        while written != path.stat().st_size or dump.status() == psutil.STATUS_RUNNING:  # it may be behind
            written = path.stat().st_size
            time.sleep(_QUIET_S)
        process.terminate()


def raw_socket(channel: str) -> socket.socket:
    """Return a bound raw CAN socket."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((channel,))
    return raw


def wait_for_shift(channel: str, from_gear: int, frame_count: int = 1) -> None:
    """Return when so many frames of a gear change out of ``from_gear`` were on the bus, each 10 ms after the other."""
    contract = CONTRACTS["TCU_Shift"]
    message = DATABASE.get_message_by_name(contract.name)
    with raw_socket(channel) as raw:
        only_gears = struct.pack("=II", contract.can_id, socket.CAN_SFF_MASK)
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, only_gears)
        raw.settimeout(HANG_S)
        deadline_s = time.monotonic() + HANG_S
        while time.monotonic() < deadline_s:
            values = message.decode_simple(_FRAME.unpack(raw.recv(16))[2], decode_choices=False)
            frame_count -= values["CurrentGear"] == from_gear != values["TargetGear"]
            if frame_count == 0:
                return
    raise TimeoutError(f"no shift from gear {from_gear} within {HANG_S:g} s")


class Stranger(Beside):
    """Sends unknown identifiers, wrong CRCs and short frames in turn while it is entered; counts what it sent."""

    def __init__(self, channel: str, pause_s: float) -> None:
        super().__init__()
        self._channel = channel
        self._pause_s = pause_s
        speeds, pressures = CONTRACTS["TCU_InputSpeeds"].can_id, CONTRACTS["TCU_Pressures"].can_id
        self._kinds = {
            "ignored": _FRAME.pack(STRANGER_ID, 8, b"stranger"),
            "bad_crc": _FRAME.pack(speeds, 8, b"\x5a\xf0liessss"),
            "short": _FRAME.pack(pressures, 3, b"cut"),
        }
        self.sent = dict.fromkeys(self._kinds, 0)

    @property
    def total(self) -> int:
        """Frames sent of all kinds."""
        return sum(self.sent.values())

    def burst(self, count: int) -> None:
        """Send frames of an unknown identifier as fast as the kernel takes them."""
        with raw_socket(self._channel) as raw:
            for _ in range(count):
                raw.send(self._kinds["ignored"])
        self.sent["ignored"] += count

    def _work(self) -> None:
        kinds = cycle(self._kinds.items())
        with raw_socket(self._channel) as raw:
            while not self._is_over.wait(self._pause_s):
                kind, frame = next(kinds)
                raw.send(frame)
                self.sent[kind] += 1
