"""How far a bus of multicast UDP reaches, counted on the other end of a cable in a network namespace of its own."""

import asyncio
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from canlog.live import BusOpener, Silence
from ecu_emulator.bus.sender import open_bus, transmit
from tests.support.patience import HANG_S
from tests.support.traffic import random_frames

FRAME_COUNT = 50
ETH_P_ALL = 0x0003
ETH_P_IP, ETH_P_IPV6 = 0x0800, 0x86DD
UDP = 17
NETWORK = (
    "link set lo up",
    "link add out0 type veth peer name far0",
    "link set far0 up",
    "link set out0 up",
    "address add 192.0.2.1/24 dev out0",
    "-6 address add 2001:db8::1/64 dev out0 nodad",
    "route add default via 192.0.2.254",
)
OPENING_S = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A group and the variables of the environment that name more."""

    group: str
    variables: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """What became of frames that the emulator's end of a bus sent."""

    heard: int  # by the service's end
    left_udp: int  # packets on the cable
    left_ipv4: int  # of any kind, such as those by which a network learns of a group


class Cable:
    """Counts packets at the far end of the cable, while it is open."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(ETH_P_ALL))
        self._socket.bind(("far0", ETH_P_ALL))

    def counts(self) -> tuple[int, int]:
        """Return UDP packets and packets of IPv4 that came so far."""
        self._socket.setblocking(False)
        udp = ipv4 = 0
        while True:
            try:
                packet, (_, kind, *_) = self._socket.recvfrom(2048)
            except BlockingIOError:
                return udp, ipv4
            ipv4 += kind == ETH_P_IP
            udp += (kind == ETH_P_IP and packet[9] == UDP) or (kind == ETH_P_IPV6 and packet[6] == UDP)


async def _meet(group: str) -> int:
    """Send from the emulator's end to the service's; return how many frames arrived."""
    source = await BusOpener("udp_multicast", group).open()
    frames = random_frames(FRAME_COUNT, mean_gap_s=200e-6)
    with open_bus("udp_multicast", group) as bus:
        await asyncio.to_thread(transmit, bus, [frames], threading.Event())
    await asyncio.sleep(OPENING_S)  # what the loopback interface still carries, and reports of membership
    await source.aclose()
    return sum([len(part) async for part in source if not isinstance(part, Silence)])


def reach_of(case: Case) -> Reach:
    """Let the two ends meet on a group, as a configuration has it, and return what happened."""
    os.environ.pop("CAN_CONFIG", None)
    os.environ.update(case.variables)
    cable = Cable()
    heard = asyncio.run(_meet(case.group))
    udp, ipv4 = cable.counts()
    return Reach(heard=heard, left_udp=udp, left_ipv4=ipv4)


def main(arguments: Sequence[str]) -> None:
    """Build the network and print what happened in each case."""
    for command in NETWORK:
        subprocess.run(["ip", *command.split()], check=True, timeout=HANG_S)
    for content in json.loads(arguments[0]):
        print(json.dumps(asdict(reach_of(Case(**content)))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
