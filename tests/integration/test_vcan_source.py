"""The service's own SocketCAN receive path: what the kernel loses, what candump sees, what happens when a bus fails."""

import asyncio
import socket
import struct
import time
from pathlib import Path

import pytest

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join
from canlog.live import BusOpener, BusSilence, FrameSource
from canlog.live.bus_clock import ClockAlarm
from canlog.live.socketcan import SocketCanSource
from canlog.live.sources import FrameQueue
from canlog.logs import read_log
from tests.support.bus_end import candump
from tests.support.patience import HANG_S
from tests.support.traffic import assert_same
from tests.uml.vcan import ip_link, is_guest

pytestmark = pytest.mark.vcan

SO_RCVBUFFORCE = 33  # of asm-generic/socket.h
EAR_BYTES = 8 * 2**20


async def collect(source: FrameSource) -> list[FrameBatch]:
    return [part async for part in source if not isinstance(part, BusSilence)]


def send_numbers(channel: str, count: int, *, gap_s: float = 0.0) -> int:
    """Send numbered frames and let them arrive; return how many the kernel took.

    A busy kernel hands frames on in a thread of its own, in their order: who hears the last one knows that all came.
    """
    taken, last = 0, b""
    with (
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw,
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as ear,
    ):
        ear.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, EAR_BYTES)
        for one in (ear, raw):
            one.bind((channel,))
        ear.settimeout(HANG_S)
        for number in range(count):
            frame = struct.pack("<IB3x8s", number % 0x800, 4, struct.pack("<I", number) + b"\xee" * 4)
            try:
                raw.send(frame)
            except OSError:
                time.sleep(0.001)
                continue
            taken, last = taken + 1, frame
            if gap_s:
                time.sleep(gap_s)
        while ear.recv(len(last)) != last:
            pass
    return taken


async def test_a_candump_of_the_same_bus_is_identical(vcan: str, tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    with candump(vcan, path):
        source = await BusOpener("socketcan", vcan).open()
        collector = asyncio.create_task(collect(source))
        sent = await asyncio.to_thread(send_numbers, vcan, 3_000, gap_s=0.0002)
        await source.aclose()
    live = join(await collector)
    assert sent == len(live) == 3_000
    assert_same(list(read_log(path)), live)


async def test_what_the_kernel_drops_is_counted_to_the_frame(vcan: str) -> None:
    source = SocketCanSource(vcan, receive_buffer_bytes=1)
    collector = asyncio.create_task(collect(source))
    sent = send_numbers(vcan, 500)  # in the loop's own thread: nobody reads meanwhile
    while not source.counts.received:  # noqa: ASYNC110 - the loop itself receives
        await asyncio.sleep(0)
    sent += await asyncio.to_thread(send_numbers, vcan, 500)
    await source.aclose()
    received = sum(map(len, await collector))
    assert source.counts.received == received
    assert source.counts.kernel_dropped > 400
    assert sent == received + source.counts.kernel_dropped == 1_000


async def test_losses_after_the_last_frame_are_counted_too(vcan: str) -> None:
    source = SocketCanSource(vcan, receive_buffer_bytes=1)
    sent = send_numbers(vcan, 200)
    await source.aclose()
    assert source.counts.kernel_dropped > 0
    assert sent == source.counts.received + source.counts.kernel_dropped


async def test_a_consumer_that_is_too_slow_costs_frames_of_the_queue_and_not_of_the_kernel(vcan: str) -> None:
    source = SocketCanSource(vcan, queue=FrameQueue(limit=300))
    sent = await asyncio.to_thread(send_numbers, vcan, 2_000)
    await source.aclose()
    batch = join(await collect(source))
    assert source.counts.kernel_dropped == 0
    assert source.counts.received == sent
    assert len(batch) == 300 == sent - source.counts.queue_dropped


async def test_bytes_past_the_length_are_cleared(vcan: str) -> None:
    source = await BusOpener("socketcan", vcan).open()
    send_numbers(vcan, 300)
    await source.aclose()
    batch = join(await collect(source))
    assert not batch.data[:, 4:].any()
    assert batch.data[:, :4].copy().view("<u4")[:, 0].tolist() == list(range(300))


async def test_frames_received_before_the_interface_goes_down_are_delivered_then_the_error(vcan: str) -> None:
    source = await BusOpener("socketcan", vcan).open()
    collector = asyncio.create_task(collect(source))
    await asyncio.sleep(0.05)
    send_numbers(vcan, 20)
    batches: list[FrameBatch] = []
    collector.cancel()
    assert ip_link("set", vcan, "down")

    async def read_on() -> None:
        batches.extend(await collect(source))

    with pytest.raises(SourceError, match=f"{vcan}' went down: switch it on"):
        await asyncio.wait_for(read_on(), timeout=HANG_S)
    assert source.counts.received == 20
    await source.aclose()


async def test_an_interface_switched_off_while_reading_is_an_error_and_no_hang(vcan: str) -> None:
    source = await BusOpener("socketcan", vcan).open()
    collector = asyncio.create_task(collect(source))
    await asyncio.sleep(0.05)
    assert ip_link("set", vcan, "down")
    with pytest.raises(SourceError, match="went down"):
        await asyncio.wait_for(collector, timeout=HANG_S)
    await source.aclose()


def test_who_sets_the_clock_rings_the_alarm() -> None:
    """Only a guest's clock is ours to set: elsewhere the alarm must stay silent."""
    alarm = ClockAlarm()
    for step_s in (0.05, -0.05) if is_guest() else ():
        time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step_s)
        assert alarm.acknowledge()
    assert not alarm.acknowledge()
    alarm.close()


async def test_a_small_receive_buffer_is_emptied_as_often_as_it_needs(vcan: str) -> None:
    source = SocketCanSource(vcan, receive_buffer_bytes=128 * 1024)
    collector = asyncio.create_task(collect(source))
    sent = await asyncio.to_thread(send_numbers, vcan, 1_000, gap_s=0.0005)
    await source.aclose()
    assert sent == sum(map(len, await collector)) == 1_000
    assert source.counts.kernel_dropped == 0
