"""Lets a tester start the workshop routine of an emulated car, all as processes on one bus, and analyses the bus's log.

``python -m tests.tools.uds_routine`` prints what the routine told beside what ``analyze`` says; status 1: they differ.
Takes a minute and a half. On a real bus, where all who listen get the kernel's time of a frame, to the bit: ``python -m
tests.uml.run -- python -m tests.tools.uds_routine -i socketcan -c vcan0``. Elsewhere each has a time of its own, some
microseconds apart: there a thousandth of the stated deviation is the same.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import can

from tests.support.replay import free_bus

LONGEST_S: Final = 300.0
NEAR_RATIO: Final = 1e-3  # of a stated deviation
SOCKETCAN: Final = "socketcan"
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
    print(f"{records[-1]['frames']['missing']} frames are missing in the log")  # then the two have not heard the same
    return {one["verdict"]["clutch"]: one["verdict"] for one in records if one["schema"] == "clutchdiag/shift/v1"}


def likeness(told: object, analysed: object, std: float, *, to_the_bit: bool) -> str:
    """Return how alike a value of both is, empty if it is not."""
    if told == analysed:
        return "same"
    is_number = isinstance(told, float) and isinstance(analysed, float)
    is_near = is_number and not to_the_bit and abs(float(told) - float(analysed)) < NEAR_RATIO * std  # type: ignore[arg-type]  # numbers
    return "within a thousandth of its deviation" if is_near else ""


def compared(told: dict[str, Any], analysed: dict[int, dict[str, Any]], *, to_the_bit: bool) -> bool:
    """Print both side by side, and return whether they are the same."""
    is_same = set(analysed) == {1, 2}
    for clutch, verdict in sorted(analysed.items()):
        friction, fluid = verdict["friction"] or {}, verdict["condition"]  # nothing, if no shift could be used
        rows = {f"{name} of clutch {clutch}": friction.get(key) for name, key in QUANTITIES.items()}
        rows[f"fluid by clutch {clutch}"] = None if fluid == "no_verdict" else fluid
        for name, value in rows.items():
            found = likeness(told[name], value, friction.get("std_mu_c", 0.0), to_the_bit=to_the_bit)
            is_same &= bool(found)
            print(f"{name:<42} {told[name]!r:<24} {value!r:<24} {found or 'DIFFERENT'}")
    return is_same


@contextmanager
def logged(interface: str, channel: str, log: Path) -> Iterator[None]:
    """Log a bus while this is entered: on SocketCAN by candump, with the kernel's times as the service gets them."""
    if interface == SOCKETCAN:
        with (
            log.open("wb") as file,
            subprocess.Popen(["stdbuf", "-oL", "candump", "-L", channel], stdout=file) as reader,
        ):
            try:
                yield
            finally:
                reader.terminate()
        return
    with can.Bus(channel, interface) as near, can.Notifier(near, [can.BLFWriter(log)], timeout=0.1):
        yield  # the notifier closes the log


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
    is_can = interface == SOCKETCAN
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / ("bus.log" if is_can else "bus.blf")
        with (
            logged(interface, channel, log),
            subprocess.Popen([*words, "--workshop", "--json"], stdout=subprocess.DEVNULL) as emulator,
        ):
            told = told_by_routine(bus, variables)
            emulator.send_signal(signal.SIGINT)
        return int(not compared(told, verdicts_of(log), to_the_bit=is_can))


if __name__ == "__main__":
    sys.exit(main())
