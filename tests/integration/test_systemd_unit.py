"""The shipped unit under a real systemd: it comes up hardened, hears its bus, and is restarted when it hangs."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.systemd.manager import INTERFACE, Manager, own_systemd, wait_for

HEALTH = "http://127.0.0.1:9464"
WATCHDOG_S = 10.0
HEARD_FRAMES = 100
RETURN_S = 100.0  # in User-Mode Linux a service takes long to start

pytestmark = pytest.mark.vcan


def answer(manager: Manager, path: str) -> str:
    ask = f"import urllib.request as r; print(r.urlopen('{HEALTH}/{path}', timeout=5).read().decode(), end='')"
    return manager.run(sys.executable, "-c", ask)


def metric(manager: Manager, name: str) -> float:
    lines = (line.rpartition(" ") for line in answer(manager, "metrics").splitlines())
    return next(float(value) for key, _, value in lines if key == name)


def main_process(manager: Manager) -> psutil.Process:
    """Return the service's process, as seen from outside."""
    inside = int(manager.shown("MainPID"))
    for process in psutil.process_iter():
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
        numbers = next(line for line in status.splitlines() if line.startswith("NSpid:")).split()[1:]
        if len(numbers) > 1 and int(numbers[-1]) == inside and "diag_service" in process.cmdline():
            return process
    raise AssertionError(f"no process {inside}")


def test_the_unit_runs_as_shipped_and_a_service_that_hangs_is_replaced(tmp_path: Path) -> None:
    with own_systemd(tmp_path / "log") as manager:
        manager.run("systemctl", "start", "clutchdiag")  # returns when the service says that it is ready
        assert manager.shown("ActiveState") == "active"
        assert manager.shown("StatusText").startswith("bus up, 0 frames")
        assert answer(manager, "readyz") == "OK\n"
        service = main_process(manager)
        assert service.uids().real >= 61_184  # a user of its own, made for it: systemd's DynamicUser
        drive = ("run", "-i", "socketcan", "-c", INTERFACE, "--cycles", "1")
        with subprocess.Popen(manager.command(sys.executable, "-m", "ecu_emulator", *drive)) as emulator:
            wait_for(lambda: metric(manager, 'clutchdiag_frames_total{fate="decoded"}') > HEARD_FRAMES, RETURN_S)
            emulator.terminate()
        results = "/var/lib/clutchdiag/results.sqlite"
        assert manager.run("stat", "--format=%a", results) == "600\n"

        os.kill(service.pid, signal.SIGSTOP)
        taken_s = wait_for(lambda: manager.shown("NRestarts") == "1", WATCHDOG_S + RETURN_S)
        assert taken_s < WATCHDOG_S + RETURN_S
        wait_for(lambda: manager.shown("ActiveState") == "active", RETURN_S)
        assert main_process(manager).pid != service.pid
        assert answer(manager, "livez") == "OK\n"

        manager.run("systemctl", "stop", "clutchdiag")
        assert (manager.shown("ActiveState"), manager.shown("Result")) == ("inactive", "success")
