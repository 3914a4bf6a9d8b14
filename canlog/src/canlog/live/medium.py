"""A bus for programs and tests that need one: a vcan interface if the kernel offers one, else UDP in this machine."""

import json
import os
import socket
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from canlog.errors import SourceError
from canlog.live.socketcan import run_program

if TYPE_CHECKING:
    import can

MULTICAST_GROUP = "239.74.163.2"  # administratively scoped, python-can's own choice
MULTICAST, SOCKETCAN, VIRTUAL = "udp_multicast", "socketcan", "virtual"


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A bus that several programs can open, and why it is this one.

    Attributes
    ----------
    interface, channel : str
        As python-can and the programs of this project name the bus.
    explanation : str
        Which bus it is and why no better one, for people.
    options : Mapping of str to Any
        What ``can.Bus`` must be given besides, such as a port.
    is_shared : bool
        Whether it was there before, so that others may use it too.
    """

    interface: str
    channel: str
    explanation: str
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    is_shared: bool = False

    @property
    def arguments(self) -> tuple[str, ...]:
        """The options of a command line that name it."""
        return "-i", self.interface, "-c", self.channel

    @property
    def environment(self) -> Mapping[str, str]:
        """The environment in which a program that is given ``arguments`` finds it."""
        return {"CAN_CONFIG": json.dumps(dict(self.options))} if self.options else {}

    @property
    def can_options(self) -> dict[str, Any]:
        """The arguments of ``can.Bus`` that open it, in any program: ``can.Bus(**medium.can_options)``."""
        reach = {"hop_limit": 0} if self.interface == MULTICAST else {}  # the frames stay in this machine
        return {"interface": self.interface, "channel": self.channel, **self.options, **reach}

    def open(self) -> "can.BusABC":
        """Return an end of the bus; it does not hear itself.

        Raises SourceError if it cannot be opened.
        """
        from canlog.live import pythoncan  # noqa: PLC0415 - heavy, and not needed for a name

        return pythoncan.open_bus(self.interface, self.channel, None, fd=False, options=self.options)


@contextmanager
def open_medium() -> Iterator[Medium]:
    """Return the best bus that this machine offers to several programs; one that was made for it goes with it."""
    for module in ("can-raw", "vcan") if os.geteuid() == 0 else ():
        _run("modprobe", "-q", module)
    if not _has_can_sockets():
        yield multicast("this kernel has no CAN")
        return
    name = f"vc{uuid.uuid4().hex[:8]}"  # names of interfaces end at 15 characters
    if _run("ip", "link", "add", name, "type", "vcan") is not None:
        try:
            _run("ip", "link", "set", name, "up")
            yield _vcan(name, "made for this run", is_shared=False)
        finally:
            _run("ip", "link", "delete", name)
        return
    answer = _run("ip", "-json", "link", "show", "up", "type", "vcan")  # never real hardware: a car may be connected
    present = next((str(link["ifname"]) for link in json.loads(answer or "[]") if "ifname" in link), None)
    if present is None:
        yield multicast("no vcan interface is up, and making one takes root")
    else:
        yield _vcan(present, "which is up already; making one of our own takes root", is_shared=True)


@contextmanager
def open_vcan() -> Iterator[Medium]:
    """Return a vcan interface, made for this run or found.

    Raises SourceError if this kernel has no CAN, or there is no vcan interface and none may be made.
    """
    with open_medium() as medium:
        if medium.interface != SOCKETCAN:
            raise SourceError(f"there is no vcan interface: {medium.explanation}")
        yield medium


def multicast(why: str) -> Medium:
    """Return multicast UDP inside this machine, on a port of its own, which separates it from other buses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = int(probe.getsockname()[1])
    return Medium(
        interface=MULTICAST,
        channel=MULTICAST_GROUP,
        explanation=f"multicast UDP {MULTICAST_GROUP}:{port} inside this machine, since {why}",
        options={"port": port},  # no hop limit is named, so the frames stay in this machine
    )


def virtual(why: str) -> Medium:
    """Return a bus within this process, with a name of its own; frames keep the times that their senders gave."""
    return Medium(
        interface=VIRTUAL,
        channel=f"bus-{uuid.uuid4().hex[:8]}",
        explanation=f"virtual, since {why}",
        options={"preserve_timestamps": True},
    )


def _vcan(name: str, why: str, *, is_shared: bool) -> Medium:
    return Medium(interface=SOCKETCAN, channel=name, explanation=f"vcan interface {name}, {why}", is_shared=is_shared)


def _has_can_sockets() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def _run(program: str, *arguments: str) -> str | None:
    """Return what a program of the system prints, or None if it is missing or fails."""
    try:
        return run_program(program, *arguments)
    except OSError:
        return None
