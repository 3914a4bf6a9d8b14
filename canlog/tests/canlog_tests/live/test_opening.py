"""The choice of a bus, who hears whom on it, and how its silence is told."""

import asyncio
import json
import time
from collections.abc import Iterator

import can
import pytest

from canlog.live import BusSilence, medium, pythoncan
from canlog.live.medium import open_medium
from canlog.live.multicast import MulticastBus, open_bus
from canlog.live.pythoncan import PythonCanSource
from tests.support.patience import HANG_S
from tests.support.replay import UdpBus, free_bus

QUIET_S = 0.05
FRAME = can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01\x02")


@pytest.fixture
def place() -> UdpBus:
    return free_bus()


@pytest.fixture
def bus(place: UdpBus) -> Iterator[MulticastBus]:
    with MulticastBus(place.group, place.port) as opened:
        yield opened


def test_python_cans_own_interface_meets_this_bus_in_both_directions(bus: MulticastBus, place: UdpBus) -> None:
    with can.Bus(place.group, "udp_multicast", port=place.port, hop_limit=0) as stranger:
        stranger.send(FRAME)
        heard = bus.recv(HANG_S)
        assert heard is not None
        assert heard.equals(FRAME, timestamp_delta=None, check_channel=False)
        bus.send(FRAME)
        answers = [stranger.recv(HANG_S) for _ in range(2)]  # it hears itself as well
        assert all(answer is not None and answer.arbitration_id == 0x123 for answer in answers)


def test_a_classic_bus_takes_no_frame_of_can_fd(bus: MulticastBus, place: UdpBus) -> None:
    long = can.Message(arbitration_id=0x1, is_fd=True, data=bytes(12))
    with MulticastBus(place.group, place.port, fd=False) as classic:
        with pytest.raises(can.CanOperationError, match="classic"):
            classic.send(long)
        bus.send(long)
        bus.send(FRAME)
        heard = classic.recv(HANG_S)
        assert heard is not None
        assert not heard.is_fd


@pytest.mark.parametrize("interface", ["virtual", "udp_multicast"])
def test_no_bus_hears_itself_whatever_is_configured(
    interface: str, place: UdpBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": place.port, "receive_own_messages": True}))
    with open_bus(interface, place.group, None) as bus:
        bus.send(FRAME)
        assert bus.recv(QUIET_S) is None


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let every program of the system fail, and note what was asked of it."""
    asked: list[str] = []

    def refuse(program: str, *arguments: str) -> None:
        asked.append(" ".join((program, *arguments)))

    monkeypatch.setattr(medium, "_run", refuse)
    return asked


def use(monkeypatch: pytest.MonkeyPatch, *, has_can: bool) -> None:
    monkeypatch.setattr(medium, "_has_can_sockets", lambda: has_can)


def test_without_can_in_the_kernel_it_is_multicast_and_says_why(
    monkeypatch: pytest.MonkeyPatch, commands: list[str]
) -> None:
    use(monkeypatch, has_can=False)
    with open_medium() as chosen:
        assert chosen.arguments == ("-i", "udp_multicast", "-c", medium.MULTICAST_GROUP)
        assert "no CAN" in chosen.explanation
        assert set(json.loads(chosen.environment["CAN_CONFIG"])) == {"port"}  # no reach is asked for
    assert not any(command.startswith("ip ") for command in commands)


def test_a_vcan_of_our_own_goes_with_us(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, has_can=True)
    asked: list[tuple[str, ...]] = []

    def obey(*words: str) -> str:
        asked.append(words)
        return ""

    monkeypatch.setattr(medium, "_run", obey)
    with open_medium() as chosen:
        assert chosen.interface == "socketcan"
        assert len(chosen.channel) <= 15  # the kernel's limit
        assert ("ip", "link", "set", chosen.channel, "up") in asked
    assert asked[-1] == ("ip", "link", "delete", chosen.channel)


SILENCE_S = 0.2


async def _close_later(source: PythonCanSource) -> None:
    await asyncio.sleep(5.0 * SILENCE_S)
    await source.aclose()


@pytest.mark.parametrize(("is_of_now", "expected"), [(True, ["frames", "silence"]), (False, ["frames"])])
async def test_silence_is_told_once_where_times_are_of_this_machine(
    monkeypatch: pytest.MonkeyPatch, expected: list[str], *, is_of_now: bool
) -> None:
    monkeypatch.setattr(pythoncan, "SILENCE_S", SILENCE_S)
    monkeypatch.setattr(pythoncan, "NOW_S", HANG_S)
    channel = f"silence-{is_of_now}"
    timestamp = time.time() if is_of_now else 1.0
    heard: list[str] = []
    with can.Bus(channel, interface="virtual", preserve_timestamps=True) as near:
        source = PythonCanSource(can.Bus(channel, interface="virtual"), channel)
        near.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01", timestamp=timestamp))
        async with asyncio.timeout(HANG_S), asyncio.TaskGroup() as tasks:
            async for part in source:
                heard.append("silence" if isinstance(part, BusSilence) else "frames")
                if heard == expected:
                    tasks.create_task(_close_later(source))
    assert heard == expected
