"""What this kernel offers in the way of vcan interfaces, and the commands that make them."""

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

IFF_UP = 1


def has_can_sockets() -> bool:
    """Return whether this kernel knows AF_CAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def is_up(name: str) -> bool:
    """Return whether a network interface exists and is switched on."""
    flags = Path(f"/sys/class/net/{name}/flags")
    return flags.exists() and bool(int(flags.read_text(), 16) & IFF_UP)


def ip_link(*arguments: str) -> bool:
    """Run ``ip link`` with these arguments; return whether it did what it was asked to."""
    program = shutil.which("ip", path=os.pathsep.join((os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin")))
    if program is None:
        return False
    return subprocess.run([program, "link", *arguments], stderr=subprocess.DEVNULL, check=False).returncode == 0


def create_vcan(name: str) -> bool:
    """Make a vcan interface and switch it on; return whether that worked."""
    return ip_link("add", name, "type", "vcan") and ip_link("set", name, "up")


def may_create_vcan() -> bool:
    """Return whether we may make interfaces, as tests do that switch one off."""
    name = f"vcan{os.getpid() % 1_000_000}"
    is_made = ip_link("add", name, "type", "vcan")
    return is_made and ip_link("delete", name)


@contextmanager
def native_vcan(name: str = "vcan0") -> Iterator[bool]:
    """Make sure that this kernel has the interface and lets us make more; take away only what was made here."""
    if os.geteuid() == 0 and shutil.which("modprobe"):
        for module in ("can-raw", "vcan"):
            subprocess.run(["modprobe", "-q", module], stderr=subprocess.DEVNULL, check=False)
    if not has_can_sockets() or not may_create_vcan():
        yield False
    elif is_up(name):
        yield True
    else:
        is_made = create_vcan(name)
        try:
            yield is_made
        finally:
            if is_made:
                ip_link("delete", name)


def is_guest() -> bool:
    """Return whether this is a User-Mode Linux guest, whose clock is nobody else's."""
    return "User Mode Linux" in Path("/proc/cpuinfo").read_text(encoding="ascii")
