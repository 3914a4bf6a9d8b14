"""A live CAN bus: CPU per frame beside python-can with cantools, and four flooded buses counted to the frame.

Both need SocketCAN interfaces. Where this kernel has none the benchmark runs itself in User-Mode Linux, whose system
calls take many times longer: only the ratio of two figures from there means anything; before, the CPU is measured on
this kernel with datagrams instead (``benchmarks.live_cpu``).

    python -m benchmarks.live_bus
"""

import argparse
import asyncio
import multiprocessing as mp
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from benchmarks.guest_meter import FOLDER_VARIABLE, answering
from benchmarks.live_cpu import QUIET_S, TARGET_RATIOS, datagrams, drive_frames, report_cpu
from canlog.live import Silence
from canlog.live.socketcan import SocketCanSource
from dbc.contract import load_contract
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from tests.uml.vcan import create_vcan, has_can_sockets, ip_link

ROUNDS = 2
FLOOD_S = 5.0
BUSES = 4
MEMORY_TARGET_MB = 20.0
MB = 1e6
Start = Callable[[], None]


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


async def listen(channels: list[str], started: Start, wait: Start) -> list[tuple[int, int]]:
    """Receive and decode several buses until ``wait`` returns; return what each received and lost."""
    decoders = [Decoder(load_contract(), load_profile()) for _ in channels]  # as the service, before it listens
    sources = [SocketCanSource(channel) for channel in channels]
    started()

    async def read(source: SocketCanSource, decoder: Decoder) -> None:
        async for part in source:
            if not isinstance(part, Silence):
                decoder.feed(part)

    readers = [asyncio.create_task(read(*pair)) for pair in zip(sources, decoders, strict=True)]
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


def run_in_guest() -> int:
    """Run this benchmark where there is a vcan, and count its processor time from here."""
    command = [sys.executable, "-m", "tests.uml.run", "--", sys.executable, "-m", "benchmarks.live_bus", *sys.argv[1:]]
    with tempfile.TemporaryDirectory() as name, answering(Path(name)):
        return subprocess.run(command, env={**os.environ, FOLDER_VARIABLE: name}, check=False).returncode


def main() -> int:
    """Run the benchmark, in a guest if it must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flood", type=float, default=FLOOD_S, help=f"seconds of overload (default: {FLOOD_S:g})")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"of each measurement (default: {ROUNDS})")
    options = parser.parse_args()
    if not has_can_sockets():
        print("datagrams in the place of CAN frames, on this kernel")
        with datagrams() as channel:
            for period_s in TARGET_RATIOS:
                report_cpu(channel, period_s, options.rounds)
        return run_in_guest()
    channels = [f"vcan{60 + number}" for number in range(BUSES)]
    if not all(create_vcan(channel) for channel in channels):
        raise SystemExit("cannot create vcan interfaces")
    try:
        for period_s in TARGET_RATIOS:
            report_cpu(channels[0], period_s, options.rounds)
        report_flood(channels, options.flood)
    finally:
        for channel in channels:
            ip_link("delete", channel)
    return 0


if __name__ == "__main__":
    sys.exit(main())
