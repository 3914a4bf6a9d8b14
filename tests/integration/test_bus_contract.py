"""What the emulator sends is what the service receives: one suite for every transport."""

import asyncio
import threading
from dataclasses import dataclass, replace

import can
import numpy as np
import pytest

from canlog.errors import SourceError
from canlog.frames import BRS_FLAG, ESI_FLAG, FD_FLAG, MAX_GAP_NS, FrameBatch, join
from canlog.live import BusOpener, BusSilence, FrameSource
from dbc.contract import load_contract
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.bus.sender import TransmitReport, open_bus, transmit
from tests.support.patience import HANG_S
from tests.support.replay import free_bus
from tests.support.starvation import again_if_starved
from tests.support.traffic import as_received, assert_same_contents, random_frames
from tests.support.wire import CONTRACTS, drive


@dataclass(frozen=True, slots=True)
class Transport:
    """Where both ends meet."""

    interface: str
    channel: str


@pytest.fixture(params=["virtual", "udp_multicast", pytest.param("socketcan", marks=pytest.mark.vcan)])
def transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Transport:
    interface = str(request.param)
    if interface == "socketcan":
        return Transport(interface, request.getfixturevalue("vcan"))
    if interface == "virtual":
        return Transport(interface, "contract")
    bus = free_bus()
    for name, value in bus.variables.items():
        monkeypatch.setenv(name, value)
    return Transport(interface, bus.group)


def followed_ids() -> list[int]:
    return [CONTRACTS[source.message_name].can_id for source in load_profile().sources.values()]


async def collect(source: FrameSource) -> list[FrameBatch]:
    return [part async for part in source if not isinstance(part, BusSilence)]


async def received(source: FrameSource, count: int) -> None:
    """Wait until so many frames have come, which python-can's transports may still carry."""
    async with asyncio.timeout(HANG_S):
        while source.counts.received < count:  # noqa: ASYNC110 - another thread counts
            await asyncio.sleep(0.01)


def send(transport: Transport, frames: EncodedFrames) -> TransmitReport:
    chunks = [frames[first : first + 100] for first in range(0, len(frames), 100)]
    with open_bus(transport.interface, transport.channel) as bus:
        return transmit(bus, chunks, threading.Event())


async def transfer(transport: Transport, frames: EncodedFrames) -> tuple[FrameBatch, FrameSource, TransmitReport]:
    source = await BusOpener(transport.interface, transport.channel).open()
    collector = asyncio.create_task(collect(source))
    report = await asyncio.to_thread(send, transport, frames)
    await received(source, len(frames))
    await source.aclose()
    return join(await collector), source, report


async def test_every_frame_arrives_as_it_was_sent(transport: Transport) -> None:
    frames = random_frames(1_000, mean_gap_s=500e-6)
    batch, source, report = await transfer(transport, frames)
    assert_same_contents(batch, as_received(frames))
    assert (report.frames_sent, report.frames_given_up) == (1_000, 0)
    assert source.counts.received == 1_000
    assert (source.counts.kernel_dropped, source.counts.queue_dropped, source.counts.unsupported) == (0, 0, 0)
    assert source.description == f"{transport.interface} {transport.channel}"


@again_if_starved
async def test_times_are_whole_microseconds_of_the_epoch_that_follow_the_schedule(transport: Transport) -> None:
    frames = random_frames(300, mean_gap_s=1e-3)
    batch, _, report = await transfer(transport, frames)
    assert not (batch.t_ns % 1000).any()
    lateness_s = (batch.t_ns - batch.t_ns[0]) / 1e9 - (frames.t_s - frames.t_s[0])
    assert abs(lateness_s).max() < report.lateness_max_s + 0.05


async def test_a_source_reads_from_the_moment_it_is_open(transport: Transport) -> None:
    frames = random_frames(50, mean_gap_s=20e-6)
    source = await BusOpener(transport.interface, transport.channel).open()
    await asyncio.to_thread(send, transport, frames)
    await received(source, len(frames))
    await source.aclose()
    assert_same_contents(join(await collect(source)), as_received(frames))


async def test_a_bus_that_falls_silent_says_so_and_is_heard_again(transport: Transport) -> None:
    frames = random_frames(20, mean_gap_s=20e-6)
    source = await BusOpener(transport.interface, transport.channel).open()
    heard: list[FrameBatch] = []
    silence_count = 0
    await asyncio.to_thread(send, transport, frames)
    async with asyncio.timeout(HANG_S):
        async for part in source:
            if not isinstance(part, BusSilence):
                heard.append(part)
            elif silence_count == 0:
                silence_count += 1
                assert_same_contents(join(heard), as_received(frames))
                await asyncio.to_thread(send, transport, frames)
            else:
                await source.aclose()
    first, second = np.split(join(heard).t_ns, [20])
    assert len(second) == 20
    assert second[0] - first[-1] > MAX_GAP_NS  # a new stretch by its times as well


async def test_two_senders_at_once_break_no_segment(transport: Transport) -> None:
    own = drive(2.0)
    others = random_frames(600, mean_gap_s=1.0 / 300.0)
    others = replace(others, can_id=np.full(len(others), 0x3E9, np.uint32))
    source = await BusOpener(transport.interface, transport.channel).open()
    collector = asyncio.create_task(collect(source))
    await asyncio.gather(*(asyncio.to_thread(send, transport, frames) for frames in (own, others)))
    await received(source, len(own) + len(others))
    await source.aclose()
    batches, decoder = await collector, Decoder(load_contract(), load_profile())
    columns = list(decoder.whole(batches))
    breaks = sum(part.breaks_before for part in columns)
    is_own = np.isin(join(batches).can_id, own.can_id)
    silences = np.diff(np.maximum.accumulate(join(batches).t_ns[is_own])) > MAX_GAP_NS  # of a busy machine
    assert breaks <= np.count_nonzero(silences)
    assert decoder.counts.ignored == len(others) + int(np.count_nonzero(~np.isin(own.can_id, followed_ids())))
    assert decoder.counts.is_balanced


async def test_remote_and_error_frames_carry_their_flags(transport: Transport) -> None:
    source = await BusOpener(transport.interface, transport.channel).open()
    with open_bus(transport.interface, transport.channel) as bus:
        bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=4))
        bus.send(can.Message(arbitration_id=0x40, is_extended_id=False, is_error_frame=True, dlc=8, data=bytes(8)))
        await received(source, 2)
    await source.aclose()
    batch = join(await collect(source))
    assert batch.can_id.tolist() == [0x4000_0123, 0x2000_0040]
    assert batch.length.tolist() == [4, 8]


async def test_can_fd_frames_keep_their_payload_and_flags(transport: Transport) -> None:
    is_fd = transport.interface != "virtual"  # which carries them anyway and knows no such option
    long = bytes(range(1, 65))
    source = await BusOpener(transport.interface, transport.channel, fd=is_fd).open()
    with open_bus(transport.interface, transport.channel, fd=is_fd) as bus:
        bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, is_fd=True, data=long))
        bus.send(can.Message(arbitration_id=0x124, is_extended_id=False, data=b"\x01"))
        bus.send(can.Message(arbitration_id=0x125, is_fd=True, bitrate_switch=True, data=long[:12]))
        bus.send(can.Message(arbitration_id=0x126, is_fd=True, error_state_indicator=True))
        await received(source, 4)
    await source.aclose()
    batch = join(await collect(source))
    assert batch.can_id.tolist() == [0x123, 0x124, 0x8000_0125, 0x8000_0126]
    assert batch.length.tolist() == [64, 1, 12, 0]
    assert batch.flags.tolist() == [FD_FLAG, 0, FD_FLAG | BRS_FLAG, FD_FLAG | ESI_FLAG]
    payloads = [long, b"\x01", long[:12], b""]
    assert [row.tobytes() for row in batch.data] == [payload.ljust(64, b"\0") for payload in payloads]
    assert (source.counts.received, source.counts.unsupported) == (4, 0)


async def test_the_death_of_a_reader_thread_reaches_the_consumer(monkeypatch: pytest.MonkeyPatch) -> None:
    source = await BusOpener("virtual", "contract").open()
    collector = asyncio.create_task(collect(source))

    def fail(*_: object, **__: object) -> None:
        raise can.CanOperationError("the driver is gone")

    with open_bus("virtual", "contract") as bus:
        monkeypatch.setattr(type(bus), "_recv_internal", fail)
        with pytest.raises(SourceError, match="virtual contract cannot be read: the driver is gone"):
            await asyncio.wait_for(collector, timeout=HANG_S)
    await source.aclose()
