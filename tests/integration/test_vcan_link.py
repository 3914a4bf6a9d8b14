"""A bus that goes away and comes back: what the supervised source and the whole service make of it on a real vcan."""

import asyncio
import socket
import struct
from pathlib import Path

import pytest

from canlog.frames import ERROR_FLAG, BusTrouble
from canlog.live import BusOpener, BusSilence, BusState, LinkBreak, SupervisedSource, supervise
from canlog.live.socketcan import restart_controller
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from tests.support.link_cycles import run_cycles
from tests.support.patience import HANG_S
from tests.support.wire import CONTRACTS, DATABASE
from tests.uml.vcan import create_vcan, ip_link

pytestmark = pytest.mark.vcan

_FRAME = struct.Struct("=IB3x8s")


def send(channel: str, *can_ids: int) -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((channel,))
        for can_id in can_ids:
            raw.send(_FRAME.pack(can_id, 8, bytes(8)))


class Listener:
    """Reads a supervised bus in the background and keeps what it heard."""

    def __init__(self, source: SupervisedSource) -> None:
        self.source = source
        self.heard: list[int | str] = []
        self._task = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for part in self.source:
            if not isinstance(part, BusSilence):
                self.heard += ["break"] if isinstance(part, LinkBreak) else part.can_id.tolist()

    async def until(self, *states: BusState) -> None:
        async with asyncio.timeout(HANG_S):
            while True:
                if self.source.status.state in states:
                    return
                await asyncio.sleep(0.01)

    async def close(self) -> list[int | str]:
        await self.source.aclose()
        await asyncio.wait_for(self._task, HANG_S)
        return self.heard


async def listener(channel: str) -> Listener:
    listening = Listener(await supervise(BusOpener("socketcan", channel)))
    await asyncio.sleep(0.05)
    return listening


async def test_an_interface_switched_off_and_on_is_read_again(vcan: str) -> None:
    bus = await listener(vcan)
    send(vcan, 1, 2)
    assert ip_link("set", vcan, "down")
    await bus.until(BusState.DOWN)
    assert ip_link("set", vcan, "up")
    await bus.until(BusState.RESTARTED)
    send(vcan, 3)
    await bus.until(BusState.UP)
    assert await bus.close() == [1, 2, "break", 3]
    assert bus.source.counts.received == 3


async def test_an_interface_removed_and_made_again_is_read_again(vcan: str) -> None:
    bus = await listener(vcan)
    assert ip_link("delete", vcan)
    await bus.until(BusState.DOWN)
    assert create_vcan(vcan)
    await bus.until(BusState.RESTARTED)
    send(vcan, 3)
    await bus.until(BusState.UP)
    assert await bus.close() == ["break", 3]


async def test_error_frames_are_counted_and_bus_off_asks_for_a_restart(vcan: str) -> None:
    bus = await listener(vcan)
    send(vcan, 1, ERROR_FLAG | 0x02, ERROR_FLAG | 0x08, ERROR_FLAG | 0x40)
    await bus.until(BusState.BUS_OFF)
    send(vcan, ERROR_FLAG | 0x100)
    await bus.until(BusState.RESTARTED)
    send(vcan, 2)
    await bus.until(BusState.UP, BusState.DEGRADED)
    await bus.close()
    status = bus.source.status
    assert status.errors == {
        BusTrouble.ARBITRATION_LOST: 1, BusTrouble.PROTOCOL: 1, BusTrouble.BUS_OFF: 1, BusTrouble.RESTARTED: 1
    }  # fmt: skip
    assert status.restart_count == 1


async def test_the_kernel_lets_through_what_is_mapped_and_error_frames(vcan: str) -> None:
    decoder = Decoder(DATABASE, load_profile())
    bus = Listener(await supervise(BusOpener("socketcan", vcan, filters=decoder.kernel_filters)))
    mapped = sorted(contract.can_id for name, contract in CONTRACTS.items() if name in decoder.messages)
    send(vcan, 0x7A0, *mapped, 0x8000_0000 | mapped[0], 0x4000_0000 | mapped[0], ERROR_FLAG | 0x02)
    await bus.until(BusState.DEGRADED)
    assert await bus.close() == [*mapped, ERROR_FLAG | 0x02]


def test_a_vcan_has_no_controller_to_restart(vcan: str) -> None:
    assert restart_controller(vcan) is not None
    assert "vcan99" in str(restart_controller("vcan99"))


def test_a_service_outlives_its_interface_and_marks_the_open_shift(vcan: str, tmp_path: Path) -> None:
    ended = run_cycles(tmp_path, vcan, 3)
    assert ended.status == 0
    assert "Traceback" not in ended.err
    assert sum(shift["reasons"] == ["interrupted"] for shift in ended.shifts) >= 3
    frames = ended.summary["frames"]
    assert frames["on_bus"] == frames["decoded"] > 0
