"""The shipped unit under a real systemd: it comes up hardened, hears its bus, and is replaced when it hangs.

As root, ``python -m tests.uml.run -- python -m tests.tools.systemd`` prints each step and how long it took; a step
that fails ends it with status 1. It takes one to two minutes in User-Mode Linux, most of them for the compiler and
the watchdog.
"""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil

from tests.tools.systemd.manager import INTERFACE, Manager, own_systemd, wait_for

HEALTH = "http://127.0.0.1:9464"  # the unit's own
RESULTS = "/var/lib/clutchdiag/results.sqlite"
LIMIT_S = 150.0  # of each step
FIRST_DYNAMIC_UID = 61_184  # of systemd's DynamicUser
HEARD_FRAMES = 1_000


def answer(manager: Manager, path: str) -> str:
    """Return what the service says over HTTP."""
    ask = f"import urllib.request as r; print(r.urlopen('{HEALTH}/{path}', timeout=5).read().decode(), end='')"
    return manager.run(sys.executable, "-c", ask)


def decoded_frames(manager: Manager) -> float:
    """Return how many frames the service has decoded."""
    lines = (line.rpartition(" ") for line in answer(manager, "metrics").splitlines())
    return next(float(value) for key, _, value in lines if key == 'clutchdiag_frames_total{fate="decoded"}')


def main_process(manager: Manager) -> psutil.Process:
    """Return the service's process, as seen from outside."""
    inside = manager.shown("MainPID")
    for process in psutil.process_iter():
        with suppress(psutil.NoSuchProcess, FileNotFoundError, ProcessLookupError):
            status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
            numbers = next(line for line in status.splitlines() if line.startswith("NSpid:")).split()[1:]
            if len(numbers) > 1 and numbers[-1] == inside and "diag_service" in process.cmdline():
                return process
    raise RuntimeError(f"no process {inside}")


def step(text: str, is_done: Callable[[], bool]) -> None:
    """Wait for something to be so and say how long it took."""
    print(f"{text:<60}{wait_for(is_done, LIMIT_S):6.1f} s", flush=True)


def state(manager: Manager) -> str:
    """Return the state of the unit."""
    return manager.shown("ActiveState")


def check(manager: Manager) -> None:
    """Take the unit through its life; TimeoutError or AssertionError tell what is not as it should be."""
    manager.run("systemctl", "start", "--no-block", "clutchdiag")
    step("started, everything compiled, ready", lambda: state(manager) == "active")
    assert manager.shown("StatusText").startswith("bus up"), manager.shown("StatusText")
    assert answer(manager, "readyz") == "OK\n"
    service = main_process(manager)
    assert service.uids().real >= FIRST_DYNAMIC_UID, service.uids()
    drive = ("run", "-i", "socketcan", "-c", INTERFACE, "--cycles", "1")
    with subprocess.Popen(
        manager.command(sys.executable, "-m", "ecu_emulator", *drive), stderr=subprocess.DEVNULL
    ) as emulator:
        step(f"{HEARD_FRAMES} frames decoded", lambda: decoded_frames(manager) > HEARD_FRAMES)
        emulator.terminate()
    assert manager.run("stat", "--format=%a", RESULTS) == "600\n"
    os.kill(service.pid, signal.SIGSTOP)
    step("a service that hangs is given up", lambda: state(manager) != "active")
    step("replaced by another one", lambda: manager.shown("NRestarts") == "1" and state(manager) == "active")
    assert main_process(manager).pid != service.pid
    assert answer(manager, "livez") == "OK\n"
    manager.run("systemctl", "stop", "clutchdiag")
    assert (state(manager), manager.shown("Result")) == ("inactive", "success")
    print("stopped in order: met")


def main() -> int:
    """Run the check in a systemd of its own."""
    with tempfile.TemporaryDirectory() as folder, own_systemd(Path(folder) / "log") as manager:
        check(manager)
    return 0


if __name__ == "__main__":
    sys.exit(main())
