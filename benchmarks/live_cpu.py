"""What it costs to receive: CPU per frame from the socket to the shifts, beside python-can with cantools.

Frames come in bursts of ten, each burst at once: one wake-up for whoever reads as they come. The service lets them
gather while nothing waits for them (``canlog.live.sources``), here as it does live: it knows of shifts. All
processor time of the receiving process counts, that in the kernel included.

Where this kernel has no CAN, User-Mode Linux has. A system call takes many times longer there, and a guest takes the
time in which its host did something else for its own: there the host counts (``benchmarks.guest_meter``), for the
whole guest, and what the sender alone costs is taken off. On this kernel the same is measured with datagrams on the
loopback in the place of CAN frames: the same system calls on a socket of another family.
"""

import asyncio
import multiprocessing as mp
import multiprocessing.synchronize
import os
import socket
import struct
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import can
import psutil

from benchmarks.guest_meter import ask, meter_folder
from canlog.live import Silence
from canlog.live.raw_socket import RECEIVE_BUFFER_BYTES, SO_TIMESTAMPNS, grow_receive_buffer
from canlog.live.socketcan import SocketCanSource
from canlog.live.sources import ReadSchedule
from dbc.contract import load_contract
from diag_service.diagnosis.shifts.gear_tracking import tracker_for
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario_file import load_scenario

BURST = 10  # frames per wake-up
TARGET_RATIOS = {  # seconds between bursts: least ratio
    0.0025: 6.0,  # a full bus of 500 kbit/s
    0.02: 3.0,  # less than this project's messages: waking up costs more than what is done then, see decision 0009
}
SEND_S = 12.0
MOST_FRAMES = 24_000  # one stretch of a drive
QUIET_S = 0.7  # before the first and after the last frame
LOST_SHARE = 0.1  # of what sending takes, which varies by as much: less cannot be told
FRAME = struct.Struct("=IB3x8s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What receiving some frames cost."""

    received: int
    cpu_s: float

    @property
    def us_per_frame(self) -> float:
        """CPU time per frame."""
        return 1e6 * self.cpu_s / max(1, self.received)


ReceivePath = Callable[[str, "Sender"], Awaitable[Cost]]


def clock_s() -> float:
    """Return the processor time of this process or, in a guest that is metered, of the guest [s]."""
    folder = meter_folder()
    return time.process_time() if folder is None else ask(folder)


def drive_frames(count: int) -> list[bytes]:
    """Return the first frames of a drive as the kernel takes them."""
    frames = next(Drive(load_scenario("noise_only")).stretches(count / 500.0)).frames[:count]
    return [
        FRAME.pack(can_id, length, bytes(data[:8]))
        for can_id, length, data in zip(frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
    ]


class Sender:
    """A process of its own that sends bursts, each on time, once it is told to go.

    It is there before the measurement begins: making a process costs more than receiving a thousand frames.
    """

    def __init__(self, channel: str, frames: list[bytes], burst: int, period_s: float) -> None:
        context = mp.get_context("fork")
        self._go = context.Event()
        self._process = context.Process(target=send_bursts, args=(channel, frames, burst, period_s, self._go))
        self._process.start()

    def start(self) -> None:
        """Begin to send."""
        self._go.set()

    async def end(self) -> None:
        """Wait for the last frame, and for what follows it to have been received."""
        await asyncio.to_thread(self._process.join)
        await asyncio.sleep(QUIET_S)


def send_bursts(channel: str, frames: list[bytes], burst: int, period_s: float, go: "mp.synchronize.Event") -> None:
    """Send frames in bursts, each on time."""
    with sending_socket(channel) as raw:
        go.wait()
        next_s = time.monotonic() + QUIET_S
        for first in range(0, len(frames), burst):
            time.sleep(max(0.0, next_s - time.monotonic()))
            for frame in frames[first : first + burst]:
                raw.send(frame)
            next_s += period_s


def sending_socket(channel: str) -> socket.socket:
    """Return a socket on a CAN interface or, if the channel is a number, one that sends to that port."""
    if channel.isdecimal():
        raw = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        raw.connect(("127.0.0.1", int(channel)))
        return raw
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((channel,))
    return raw


async def own_path(channel: str, sender: Sender) -> Cost:
    """Receive, check CRC, counters, E2E states and ranges, decode, and look for shifts, as the service does."""
    schedule = ReadSchedule()
    decoder = Decoder(load_contract(), load_profile())
    finder = ShiftFinder(tracker_for(decoder.signals, decoder.gears))
    source = SocketCanSource(channel, schedule=schedule)
    began_s = clock_s()
    sender.start()

    async def close_after_the_last() -> None:
        await sender.end()
        await source.aclose()

    closer = asyncio.create_task(close_after_the_last())
    received = 0
    async for part in source:
        if isinstance(part, Silence):
            continue
        for columns in decoder.feed(part):
            finder.feed(columns)
        schedule.wait_for(is_expecting=finder.is_expecting, due_ns=finder.due_ns)
        received += len(part)
    await closer
    return Cost(received=received, cpu_s=clock_s() - began_s)


async def no_path(_channel: str, sender: Sender) -> Cost:
    """Receive nothing, to see what sending costs where that cannot be told apart."""
    began_s = clock_s()
    sender.start()
    await sender.end()
    return Cost(received=0, cpu_s=clock_s() - began_s)


async def peer_path(channel: str, sender: Sender) -> Cost:
    """Receive and decode as python-can's documentation shows it, with cantools and nothing checked."""
    database = load_contract()
    received = 0
    with can.Bus(channel, interface="socketcan") as bus:
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(bus, [reader], loop=asyncio.get_running_loop())
        began_s = clock_s()
        sender.start()

        async def decode() -> None:
            nonlocal received
            async for message in reader:
                database.decode_message(message.arbitration_id, bytes(message.data))
                received += 1

        decoding = asyncio.create_task(decode())
        await sender.end()
        decoding.cancel()
        cost = Cost(received=received, cpu_s=clock_s() - began_s)
        notifier.stop()
    return cost


def measured(path: ReceivePath, channel: str, frames: list[bytes], period_s: float) -> Cost:
    """Return what one path costs for frames that another process sends."""
    sender = Sender(channel, frames, BURST, period_s)

    async def run() -> Cost:
        return await path(channel, sender)

    return asyncio.run(run())


def report_cpu(channel: str, period_s: float, rounds: int) -> None:
    """Print CPU per frame of both paths, measured in turn."""
    count = min(round(SEND_S / period_s) * BURST, MOST_FRAMES)
    frames = drive_frames(count)
    own, peer, nobody = [], [], []
    for _ in range(rounds):
        own.append(measured(own_path, channel, frames, period_s))
        peer.append(measured(peer_path, channel, frames, period_s))
        if meter_folder() is not None:
            nobody.append(measured(no_path, channel, frames, period_s).cpu_s)
    sending_s = min(nobody, default=0.0)
    best = [
        replace(cost, cpu_s=cost.cpu_s - sending_s)
        for cost in (min(costs, key=lambda cost: cost.us_per_frame) for costs in (own, peer))
    ]
    load = os.getloadavg()[0] / (psutil.cpu_count() or 1)
    print(
        f"CPU per frame, {BURST} frames per wake-up, {BURST / period_s:.0f} frames/s, best of {rounds}"
        f"{'' if load < 1.0 else f'; a busy machine, load {load:.1f} per core'}"
    )
    for name, cost in zip(
        ("service, everything checked", "Notifier, AsyncBufferedReader, cantools"), best, strict=True
    ):
        print(f"  {name:<40}{cost.us_per_frame:8.1f} us  {cost.received} of {count} frames")
    if best[0].cpu_s < LOST_SHARE * sending_s:
        print("  no ratio: what the service takes is lost beside what sending takes", flush=True)
        return
    ratio = best[1].us_per_frame / best[0].us_per_frame
    target = TARGET_RATIOS[period_s]
    print(f"  ratio {ratio:.1f}   target >= {target:g}: {'met' if ratio >= target else 'MISSED'}", flush=True)


class DatagramSocket(socket.socket):
    """A socket for datagrams that takes the options of CAN for granted."""

    def setsockopt(self, level: int, name: int, value: Any, *rest: Any) -> None:  # noqa: ANN401 - as socket's own
        """Set an option, unless it is one of CAN."""
        if level not in {socket.SOL_CAN_BASE, socket.SOL_CAN_RAW}:
            super().setsockopt(level, name, value, *rest)


@contextmanager
def datagrams() -> Iterator[str]:
    """Let both paths read datagrams while entered; yield what to call the channel."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])

    def bind(raw: socket.socket, _channel: str) -> None:
        raw.bind(("127.0.0.1", port))

    def create() -> socket.socket:
        return DatagramSocket(socket.AF_INET, socket.SOCK_DGRAM)

    def open_socket(channel: str, **_: object) -> socket.socket:
        raw = create()
        raw.setblocking(False)
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        grow_receive_buffer(raw, RECEIVE_BUFFER_BYTES)
        bind(raw, channel)
        return raw

    where = "can.interfaces.socketcan.socketcan"
    with (
        patch("canlog.live.socketcan.open_socket", open_socket),
        patch(f"{where}.create_socket", create),
        patch(f"{where}.bind_socket", bind),
    ):
        yield str(port)
