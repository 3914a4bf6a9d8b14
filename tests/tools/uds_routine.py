"""Lets a tester start the workshop routine of an emulated car, all as processes on one bus, and analyses the bus's log.

``python -m tests.tools.uds_routine`` prints what the routine told beside what ``analyze`` says; status 1: they differ.
Takes a minute and a half. On a real bus: ``python -m tests.uml.run -- python -m tests.tools.uds_routine -i
socketcan -c vcan0``. The log is BLF, which keeps nanoseconds.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import can

from tests.support.replay import free_bus

LONGEST_S: Final = 300.0
QUANTITIES: Final = {
    "mu_C": "mu_c",
    "standard deviation of mu_C": "std_mu_c",
    "mu_S": "mu_s",
    "standard deviation of mu_S": "std_mu_s",
}


def run(words: list[str], variables: dict[str, str]) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", *words],
        check=False, capture_output=True, text=True, timeout=LONGEST_S, env={**os.environ, **variables},
    )  # fmt: skip


def told_by_routine(bus: list[str], variables: dict[str, str]) -> dict[str, Any]:
    """Return what the routine's final response says; it is refused until the car has idled for a while."""
    words = ["diag_service", "routine", "0301", "start", "--options", "01 01", "--unlock", "1=5AA5C33C", *bus]
    until_s = time.monotonic() + LONGEST_S
    while True:
        done = run([*words, "--active", "--listen", "0.3", "--timeout", "20", "--json"], variables)
        if done.returncode == 0:
            told: dict[str, Any] = json.loads(done.stdout)["routine"]["values"]
            return told
        print(done.stderr.strip())
        if time.monotonic() > until_s:
            raise TimeoutError("the routine was not started")
        time.sleep(1.0)


def verdicts_of(log: Path) -> dict[int, dict[str, Any]]:
    """Return the last verdict on each clutch in a log."""
    done = run(["diag_service", "analyze", str(log), "--json"], {})
    records = [json.loads(line) for line in done.stdout.splitlines()]
    return {one["verdict"]["clutch"]: one["verdict"] for one in records if one["schema"] == "clutchdiag/shift/v1"}


def compared(told: dict[str, Any], analysed: dict[int, dict[str, Any]]) -> bool:
    """Print both side by side, and return whether they are the same."""
    is_same = True
    for clutch, verdict in sorted(analysed.items()):
        rows = {f"{name} of clutch {clutch}": verdict["friction"][key] for name, key in QUANTITIES.items()}
        fluid = verdict["condition"]
        rows[f"fluid by clutch {clutch}"] = None if fluid == "no_verdict" else fluid
        for name, value in rows.items():
            is_same &= told[name] == value
            print(f"{name:<42} {told[name]!r:<24} {value!r:<24} {'same' if told[name] == value else 'DIFFERENT'}")
    return is_same and set(analysed) == {1, 2}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-i", "--interface")
    parser.add_argument("-c", "--channel")
    options = parser.parse_args()
    place = free_bus()
    variables = {} if options.interface else dict(place.variables)
    interface, channel = options.interface or "udp_multicast", options.channel or place.group
    bus = ["-i", interface, "-c", channel]
    os.environ.update(variables)
    words = [sys.executable, "-m", "ecu_emulator", "run", *bus, "--fluid", "case2", "--diagnostics", "--on-board"]
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bus.blf"
        with (
            can.Bus(channel, interface) as near,
            can.BLFWriter(log) as writer,
            can.Notifier(near, [writer], timeout=0.1),
            subprocess.Popen([*words, "--workshop", "--json"], stdout=subprocess.DEVNULL) as emulator,
        ):
            told = told_by_routine(bus, variables)
            emulator.send_signal(signal.SIGINT)
        return int(not compared(told, verdicts_of(log)))


if __name__ == "__main__":
    sys.exit(main())
