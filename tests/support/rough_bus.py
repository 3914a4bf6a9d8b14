"""A bus on which something goes wrong every few seconds: a drive in real time, foreign traffic and fault after fault.

The drive is the emulator's, sent by a thread that outlives its interface; foreign frames fill the bus up to a frame
rate. A fault is one of the emulator's faults of bus and sensors, a frame in which the controller reports itself
bus-off, a burst, an interface that is switched off, removed or renamed or, in a guest of our own, a wall clock that is
moved.
"""

import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.drive.recording import SHORT_STRETCH_S, Drive
from ecu_emulator.scenario.faults import BusFault, BusFaultKind, SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario_file import load_scenario
from ecu_emulator.truth import ShiftTruth
from tests.support.bus_end import STRANGER_ID
from tests.support.wire import CONTRACTS
from tests.tools.link_cycles import CALAMITIES

TICK_S: Final = 0.005
FAULT_S: Final = 2.0  # how long a fault lasts, at most
BURST_FRAMES: Final = 3_000
CLOCK_STEP_S: Final = 7_200.0
QUANTITIES: Final = ("engine_torque_nm", "engine_speed_rad_s", "clutch1_pressure_pa", "output_speed_rad_s")
BUS_OFF: Final = 0x2000_0040  # error frame: bus-off
RESTARTED: Final = 0x2000_0100  # error frame: the controller was restarted
_FRAME: Final = struct.Struct("=IB3x8s")
_FOREIGN: Final = _FRAME.pack(STRANGER_ID, 8, b"stranger")
_ABSENT_S: Final = 0.01


class RoughBus:
    """Sends while it is entered; ``strike`` makes the next fault happen.

    Parameters
    ----------
    channel : str
        An interface that exists and that nobody else needs.
    rate_ratio : float
        Frames on the bus for each frame of the drive.
    may_set_clock : bool
        Whether the machine's wall clock may be moved.
    """

    def __init__(self, channel: str, *, rate_ratio: float, seed: int, may_set_clock: bool) -> None:
        self.channel = channel
        self.struck: Counter[str] = Counter()
        self.sent = 0
        self.late_s = 0.0  # longest that a tick came late
        self.truth = list[ShiftTruth]()
        self._foreign_ratio = rate_ratio - 1.0
        self._random = np.random.default_rng(seed)
        self._seed = seed
        self._drive = self._next_drive()
        self._faults: dict[str, Callable[[], None]] = {
            **{kind.value: self._bus_fault(kind) for kind in BusFaultKind},
            **{f"sensor_{kind.value}": self._sensor_fault(kind) for kind in SensorFaultKind},
            **{calamity.__name__: self._calamity(calamity) for calamity in CALAMITIES},
            "bus_off": self._go_bus_off,
            "burst": self._burst,
        }
        if may_set_clock:
            self._faults["clock_step"] = self._move_clock
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._send, name="rough bus")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    @property
    def is_sending(self) -> bool:
        """Whether the drive goes on; it ends only with an error of our own."""
        return self._thread.is_alive()

    def strike(self) -> str:
        """Let one fault happen, each kind as often as any other; return its name."""
        name = str(self._random.choice(sorted(self._faults)))
        self._faults[name]()
        self.struck[name] += 1
        return name

    def _bus_fault(self, kind: BusFaultKind) -> Callable[[], None]:
        def strike() -> None:
            given: dict[str, float | int | str] = {"duration_s": self._random.uniform(0.02, FAULT_S)}
            if kind is not BusFaultKind.OVERLOAD:
                given["message"] = str(self._random.choice(["", *CONTRACTS]))
            if kind is BusFaultKind.DELAY:
                given |= {"delay_s": 0.02, "jitter_s": 0.03}
            if kind is BusFaultKind.SKIPPING_COUNTER:
                given["skip"] = int(self._random.integers(1, 15))
            if kind is BusFaultKind.LOSS:
                given["share"] = float(self._random.choice([0.01, 0.05, 0.5, 1.0]))
            self._drive.add_fault(BusFault(kind=kind, **given))  # type: ignore[arg-type]

        return strike

    def _sensor_fault(self, kind: SensorFaultKind) -> Callable[[], None]:
        def strike() -> None:
            quantity = str(self._random.choice(QUANTITIES))
            large = {"engine_torque_nm": 40.0, "clutch1_pressure_pa": 2e5}.get(quantity, 30.0)
            is_sized = kind not in {SensorFaultKind.FROZEN, SensorFaultKind.NOT_AVAILABLE}
            duration_s = self._random.uniform(0.05, FAULT_S)
            size = large if is_sized else 0.0
            self._drive.add_fault(SensorFault(kind=kind, quantity=quantity, duration_s=duration_s, size=size))

        return strike

    def _calamity(self, calamity: Callable[[str], str]) -> Callable[[], None]:
        def strike() -> None:
            self.channel = calamity(self.channel)

        return strike

    def _go_bus_off(self) -> None:
        with suppress(OSError), self._socket() as raw:
            raw.send(_FRAME.pack(BUS_OFF, 8, bytes(8)))
            time.sleep(self._random.uniform(0.0, FAULT_S))
            raw.send(_FRAME.pack(RESTARTED, 8, bytes(8)))
            self.sent += 2

    def _burst(self) -> None:
        with suppress(OSError), self._socket() as raw:
            for _ in range(BURST_FRAMES):
                raw.send(_FOREIGN)
                self.sent += 1

    def _move_clock(self) -> None:
        step_s = float(self._random.choice([-CLOCK_STEP_S, CLOCK_STEP_S]))
        time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step_s)

    def _socket(self) -> socket.socket:
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            raw.bind((self.channel,))
        except OSError:
            raw.close()
            raise
        return raw

    def _next_drive(self) -> Drive:
        self._seed += 1
        return Drive(replace(load_scenario("noise_only"), seed=self._seed))

    def _stretches(self) -> Iterator[EncodedFrames]:
        """Drive for as long as anybody wants."""
        while True:
            for stretch in self._drive.stretches(SHORT_STRETCH_S):
                self.truth += [one for one in stretch.truths if isinstance(one, ShiftTruth)]
                yield stretch.frames
            self._drive = self._next_drive()

    def _ticks(self) -> Iterator[list[bytes]]:
        """Yield what is to be sent in each tick of scenario time."""
        owed = 0.0
        for frames in self._stretches():
            if not len(frames):
                continue
            ticks = (frames.t_s / TICK_S).astype(int)
            packed = [
                _FRAME.pack(can_id, length, bytes(data[:8]))
                for can_id, length, data in zip(
                    frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
                )
            ]
            at = 0
            for tick in range(int(ticks[0]), int(ticks[-1]) + 1):
                first = at
                while at < len(packed) and ticks[at] <= tick:
                    at += 1
                owed += self._foreign_ratio * len(packed) / (int(ticks[-1]) + 1 - int(ticks[0]))
                yield [*packed[first:at], *[_FOREIGN] * int(owed)]
                owed -= int(owed)

    def _send(self) -> None:
        ticks, due_s = self._ticks(), time.monotonic()
        while not self._is_over.is_set():
            try:
                with self._socket() as raw:
                    due_s = self._send_on(raw, ticks, due_s)
            except OSError:
                self._is_over.wait(_ABSENT_S)

    def _send_on(self, raw: socket.socket, ticks: Iterator[list[bytes]], due_s: float) -> float:
        """Send until the interface fails or nobody wants it any more; return when the next tick is due."""
        for frames in ticks:
            now_s = time.monotonic()
            if now_s < due_s:
                self._is_over.wait(due_s - now_s)
            elif now_s - due_s > 1.0:  # a machine that stood still: what was missed is not made up for
                due_s = now_s
            self.late_s = max(self.late_s, now_s - due_s)
            due_s += TICK_S
            for frame in frames:
                raw.send(frame)
            self.sent += len(frames)
            if self._is_over.is_set():
                return due_s
        return due_s


def is_guest() -> bool:
    """Return whether this is a User-Mode Linux guest, whose clock is nobody else's."""
    return "User Mode Linux" in Path("/proc/cpuinfo").read_text(encoding="ascii")
