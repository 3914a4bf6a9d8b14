"""The bus of the demonstration: a vcan interface if the kernel offers one, else multicast UDP inside this machine."""

import json
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType

MULTICAST_GROUP = "239.74.163.2"  # administratively scoped, python-can's own choice
_PATIENCE_S = 10.0
_SYSTEM_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A bus that both programs can open, and why it is this one."""

    interface: str
    channel: str
    explanation: str
    environment: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def arguments(self) -> tuple[str, ...]:
        """The options that both programs take."""
        return "-i", self.interface, "-c", self.channel


@contextmanager
def open_medium() -> Iterator[Medium]:
    """Return the best bus that this machine offers; one that was made for it goes with it."""
    for module in ("can-raw", "vcan") if os.geteuid() == 0 else ():
        _run("modprobe", "-q", module)
    if not _has_can_sockets():
        yield _multicast("this kernel has no CAN")
        return
    own = f"vcdemo{os.getpid() % 1_000_000}"  # names of interfaces end at 15 characters
    if _run("ip", "link", "add", own, "type", "vcan") is not None:
        try:
            _run("ip", "link", "set", own, "up")
            yield _vcan(own, "made for this demo")
        finally:
            _run("ip", "link", "delete", own)
        return
    found = _existing_vcan()
    if found is None:
        yield _multicast("no vcan interface is up, and making one takes root")
    else:
        yield _vcan(found, "which is up already; making one of our own takes root")


def _vcan(name: str, why: str) -> Medium:
    return Medium(interface="socketcan", channel=name, explanation=f"vcan interface {name}, {why}")


def _multicast(why: str) -> Medium:
    """Return multicast UDP on a port of its own: the kernel tells demos apart by the port, not by the group."""
    port = _free_udp_port()
    options = {"port": port}  # no hop limit is named, so the frames stay in this machine
    return Medium(
        interface="udp_multicast",
        channel=MULTICAST_GROUP,
        explanation=f"multicast UDP {MULTICAST_GROUP}:{port} inside this machine, since {why}",
        environment={"CAN_CONFIG": json.dumps(options)},
    )


def _has_can_sockets() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def _existing_vcan() -> str | None:
    """Return a vcan interface that is up; never one of real hardware, on which a car may hang."""
    answer = _run("ip", "-json", "link", "show", "up", "type", "vcan")
    names = [link["ifname"] for link in json.loads(answer or "[]") if "ifname" in link]
    return str(names[0]) if names else None


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def _run(program: str, *arguments: str) -> str | None:
    """Return what a program of the system says, or None if it is missing or fails."""
    path = shutil.which(program, path=os.pathsep.join((os.environ.get("PATH", os.defpath), *_SYSTEM_FOLDERS)))
    if path is None:
        return None
    try:
        answer = subprocess.run(  # noqa: S603 - constant programs, no shell
            [path, *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=True,
            timeout=_PATIENCE_S,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout
