"""A live CAN bus: CPU per frame beside python-can with cantools, and four flooded buses counted to the frame.

Both need SocketCAN interfaces. Where this kernel has none the benchmark runs itself in User-Mode Linux, whose system
calls take many times longer: only the ratio of two figures from there means anything.

    python -m benchmarks.live_bus
"""

import argparse
import asyncio
import multiprocessing as mp
import multiprocessing.context
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import can
import psutil

from dbc.contract import DBC_PATH, load_contract
from diag_service.database import load_database
from diag_service.mapping import Decoder
from diag_service.profile import load_profile
from diag_service.sources import open_source
from diag_service.sources.socketcan import SocketCanSource
from ecu_emulator.recording import Drive
from ecu_emulator.scenario_file import load_scenario
from tests.uml.vcan import create_vcan, has_can_sockets, ip_link

BURST = 10  # frames per wake-up
PERIODS_S = (0.0025, 0.02)  # a full bus of 500 kbit/s, and one with little traffic
SEND_S = 2.0
ROUNDS = 2
FLOOD_S = 5.0
BUSES = 4
QUIET_S = 0.7  # after the last frame
TARGET_RATIO = 5.0
MEMORY_TARGET_MB = 20.0
MB = 1e6
_FRAME = struct.Struct("=IB3x8s")
Start = Callable[[], None]
Sender = mp.context.ForkProcess


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What receiving some frames cost."""

    received: int
    cpu_s: float

    @property
    def us_per_frame(self) -> float:
        """CPU time per frame."""
        return 1e6 * self.cpu_s / max(1, self.received)


ReceivePath = Callable[[str, Sender], Awaitable[Cost]]


def drive_frames(count: int) -> list[bytes]:
    """Return the first frames of a drive as the kernel takes them."""
    frames = next(Drive(load_scenario("noise_only")).stretches(count / 500.0)).frames[:count]
    return [
        _FRAME.pack(can_id, length, bytes(data[:8]))
        for can_id, length, data in zip(frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
    ]


def send_bursts(channel: str, frames: list[bytes], burst: int, period_s: float) -> None:
    """Send frames in bursts, each on time; runs in a process of its own."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((channel,))
        next_s = time.monotonic() + QUIET_S
        for first in range(0, len(frames), burst):
            time.sleep(max(0.0, next_s - time.monotonic()))
            for frame in frames[first : first + burst]:
                raw.send(frame)
            next_s += period_s


def flood(channel: str, frame: bytes, duration_s: float, sent: "mp.Queue[int]") -> None:
    """Send one frame again and again as fast as the kernel takes it; runs in a process of its own."""
    count = 0
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((channel,))
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            raw.send(frame)
            count += 1
    sent.put(count)


async def own_path(channel: str, sender: Sender) -> Cost:
    """Receive and decode as the service does: CRC, counters, E2E states and ranges checked."""
    source = await open_source("socketcan", channel)
    decoder = Decoder(load_database(DBC_PATH), load_profile())
    sender.start()
    began_s = time.process_time()

    async def close_after_the_last() -> None:
        await asyncio.to_thread(sender.join)
        await asyncio.sleep(QUIET_S)
        await source.aclose()

    closer = asyncio.create_task(close_after_the_last())
    received = 0
    async for batch in source:
        decoder.feed(batch)
        received += len(batch)
    await closer
    return Cost(received=received, cpu_s=time.process_time() - began_s)


async def peer_path(channel: str, sender: Sender) -> Cost:
    """Receive and decode as python-can's documentation shows it, with cantools and nothing checked."""
    database = load_contract()
    received = 0
    with can.Bus(channel, interface="socketcan") as bus:
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(bus, [reader], loop=asyncio.get_running_loop())
        sender.start()
        began_s = time.process_time()

        async def decode() -> None:
            nonlocal received
            async for message in reader:
                database.decode_message(message.arbitration_id, bytes(message.data))
                received += 1

        decoding = asyncio.create_task(decode())
        await asyncio.to_thread(sender.join)
        await asyncio.sleep(QUIET_S)
        decoding.cancel()
        cost = Cost(received=received, cpu_s=time.process_time() - began_s)
        notifier.stop()
    return cost


def measured(path: ReceivePath, channel: str, frames: list[bytes], period_s: float) -> Cost:
    """Return what one path costs for frames that another process sends."""
    sender = mp.get_context("fork").Process(target=send_bursts, args=(channel, frames, BURST, period_s))

    async def run() -> Cost:
        return await path(channel, sender)

    return asyncio.run(run())


def report_cpu(channel: str, period_s: float) -> None:
    """Print CPU per frame of both paths, measured in turn."""
    count = round(SEND_S / period_s) * BURST
    frames = drive_frames(count)
    own, peer = [], []
    for _ in range(ROUNDS):
        own.append(measured(own_path, channel, frames, period_s))
        peer.append(measured(peer_path, channel, frames, period_s))
    best = [min(costs, key=lambda cost: cost.us_per_frame) for costs in (own, peer)]
    ratio = best[1].us_per_frame / best[0].us_per_frame
    print(f"CPU per frame, {BURST} frames per wake-up, {BURST / period_s:.0f} frames/s, best of {ROUNDS}")
    for name, cost in zip(
        ("service, everything checked", "Notifier, AsyncBufferedReader, cantools"), best, strict=True
    ):
        print(f"  {name:<40}{cost.us_per_frame:8.1f} us  {cost.received} of {count} frames")
    print(f"  ratio {ratio:.1f}   target >= {TARGET_RATIO:g}: {'met' if ratio >= TARGET_RATIO else 'MISSED'}")


async def listen(channels: list[str], started: Start, wait: Start) -> list[tuple[int, int]]:
    """Receive and decode several buses until ``wait`` returns; return what each received and lost."""
    sources = [SocketCanSource(channel) for channel in channels]
    started()

    async def read(source: SocketCanSource) -> None:
        decoder = Decoder(load_database(DBC_PATH), load_profile())
        async for batch in source:
            decoder.feed(batch)

    readers = [asyncio.create_task(read(source)) for source in sources]
    await asyncio.to_thread(wait)
    await asyncio.sleep(QUIET_S)
    for source in sources:
        await source.aclose()
    await asyncio.gather(*readers)
    return [(source.counts.received, source.counts.kernel_dropped) for source in sources]


def report_flood(channels: list[str], duration_s: float) -> None:
    """Print whether every frame of four flooded buses is accounted for, and what memory that took."""
    context = mp.get_context("fork")
    frame = drive_frames(100)[0]
    sent_of = {channel: context.Queue() for channel in channels}
    senders = [context.Process(target=flood, args=(name, frame, duration_s, sent_of[name])) for name in channels]
    process = psutil.Process()
    before_mb = process.memory_info().rss / MB

    def start() -> None:
        for sender in senders:
            sender.start()

    sent_count: dict[str, int] = {}

    def wait() -> None:
        sent_count.update({channel: queue.get() for channel, queue in sent_of.items()})

    counts = asyncio.run(listen(channels, start, wait))
    grown_mb = process.memory_info().rss / MB - before_mb
    print(f"Flood of {len(channels)} buses at once for {duration_s:g} s, as fast as this kernel takes frames")
    is_exact = True
    for channel, (received, dropped) in zip(channels, counts, strict=True):
        sent = sent_count[channel]
        is_exact &= sent == received + dropped
        print(
            f"  {channel}: {sent} sent ({sent / duration_s:.0f}/s) = {received} received + {dropped} dropped: "
            f"{'exact' if sent == received + dropped else 'WRONG'}"
        )
    print(f"  every frame accounted for: {'met' if is_exact else 'MISSED'}")
    verdict = "met" if grown_mb < MEMORY_TARGET_MB else "MISSED"
    print(f"  memory grew by {grown_mb:.1f} MB   target < {MEMORY_TARGET_MB:g} MB: {verdict}")


def main() -> int:
    """Run the benchmark, in a guest if it must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flood", type=float, default=FLOOD_S, help=f"seconds of overload (default: {FLOOD_S:g})")
    options = parser.parse_args()
    if not has_can_sockets():
        command = [sys.executable, "-m", "tests.uml.run", "--", sys.executable, "-m", "benchmarks.live_bus"]
        return subprocess.run([*command, *sys.argv[1:]], check=False).returncode
    channels = [f"vcan{60 + number}" for number in range(BUSES)]
    if not all(create_vcan(channel) for channel in channels):
        raise SystemExit("cannot create vcan interfaces")
    try:
        for period_s in PERIODS_S:
            report_cpu(channels[0], period_s)
        report_flood(channels, options.flood)
    finally:
        for channel in channels:
            ip_link("delete", channel)
    return 0


if __name__ == "__main__":
    sys.exit(main())
