"""Multicast UDP as a CAN bus: who hears whom, what is refused, and what the configuration may ask for."""

import json
from collections.abc import Iterator

import can
import pytest

from canlog.live.opening import MulticastBus, open_bus
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
