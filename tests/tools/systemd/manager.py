"""Starts a systemd and asks it about the shipped unit."""

import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[3]
START = Path(__file__).with_name("root.sh")
UNIT = "clutchdiag.service"
INTERFACE = "can0"  # the unit's own
UP_LIMIT_S = 30.0


class Manager:
    """A running systemd, by the process that is its first."""

    def __init__(self, first: psutil.Process) -> None:
        self._first = first

    def command(self, *words: str) -> list[str]:
        """Return a command as one that runs where the units run, but with the mounts of this machine."""
        return ["nsenter", "--target", str(self._first.pid), "--pid", "--net", "--mount", "--", *words]

    def run(self, *words: str) -> str:
        """Run a command there; return what it printed."""
        return subprocess.run(self.command(*words), check=True, capture_output=True, text=True, timeout=150.0).stdout

    def is_up(self) -> bool:
        """Return whether it answers and has started what it should."""
        asked = self.command("systemctl", "is-system-running")
        return subprocess.run(asked, check=False, capture_output=True, timeout=30.0).stdout == b"running\n"

    def shown(self, name: str) -> str:
        """Return a property of the unit."""
        return self.run("systemctl", "show", UNIT, f"--property={name}", "--value").strip()


@contextmanager
def own_systemd(log: Path) -> Iterator[Manager]:
    """Start a systemd that knows the shipped unit and has a vcan of its own; needs to be root."""
    packages = sysconfig.get_path("purelib")
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    with log.open("wb") as out:
        process = subprocess.Popen(
            ["sh", START, ROOT, sys.base_prefix, python, packages, INTERFACE], stdout=out, stderr=subprocess.STDOUT
        )
    try:
        yield _once_up(process.pid, log)
    finally:
        for child in psutil.Process(process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):  # with the first process of a namespace all others are gone
                child.kill()
        process.wait(timeout=30.0)


def _once_up(pid: int, log: Path) -> Manager:
    deadline_s = time.monotonic() + UP_LIMIT_S
    while time.monotonic() < deadline_s:
        for child in psutil.Process(pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):
                if child.name() == "systemd" and (manager := Manager(child)).is_up():
                    return manager
        time.sleep(0.2)
    raise RuntimeError(f"systemd did not come up: {log.read_text(encoding='utf-8', errors='replace')}")


def wait_for(what: Callable[[], bool], limit_s: float) -> float:
    """Wait until something is so; return how long it took [s]."""
    began_s = time.monotonic()
    while not what():
        if time.monotonic() - began_s > limit_s:
            raise TimeoutError(f"not so after {limit_s:g} s")
        time.sleep(0.2)
    return time.monotonic() - began_s
