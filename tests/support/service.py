"""Runs the service as its users do: a process, its two outputs, its exit status and its signals."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tests.support.patience import HANG_S

Record = dict[str, Any]
OWN_PREFIXES = ("CAN_", "CLUTCHDIAG_")
NOTHING: Mapping[str, str] = MappingProxyType({})
PROGRAM = (sys.executable, "-m", "diag_service")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """What is left of a service that ended."""

    status: int
    out: str
    err: str

    @property
    def records(self) -> list[Record]:
        """The JSON lines of standard output; anything else there fails the test."""
        return [json.loads(line) for line in self.out.splitlines()]

    @property
    def shifts(self) -> list[Record]:
        """The shift results among the JSON lines."""
        return [record for record in self.records if record["schema"] == "clutchdiag/shift/v1"]

    @property
    def summary(self) -> Record:
        """The last JSON line."""
        last = self.records[-1]
        assert last["schema"] == "clutchdiag/summary/v1"
        return last

    def assert_one_line(self, status: int, text: str) -> None:
        """Check that it failed as promised: the exit status, one clear line, no traceback."""
        assert (self.status, self.err.count("\n")) == (status, 1), self.err
        assert self.err.startswith("diag-service: error: ")
        assert text in self.err


class Service:
    """A running service whose outputs go to files, so that it never waits for us."""

    def __init__(self, folder: Path, command: Sequence[str], variables: Mapping[str, str] = NOTHING) -> None:
        self._out, self._err = folder / "stdout", folder / "stderr"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self.process = subprocess.Popen(command, stdout=out, stderr=err, env={**environment(), **variables})

    @property
    def out(self) -> str:
        """Standard output until now."""
        return self._out.read_text(encoding="utf-8")

    @property
    def err(self) -> str:
        """Standard error until now."""
        return self._err.read_text(encoding="utf-8")

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self.process.send_signal(number)

    def wait_until_it_catches(self, number: signal.Signals, timeout_s: float = HANG_S) -> None:
        """Return when the process has a handler for a signal; before that it is an interpreter that starts."""

        def catches() -> bool:
            text = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
            caught = next(line for line in text.splitlines() if line.startswith("SigCgt:"))
            return bool(int(caught.split()[1], 16) >> (number - 1) & 1)

        self.wait_for(catches, timeout_s)

    def wait_for(self, condition: Callable[[], bool], timeout_s: float = HANG_S) -> None:
        """Return when a condition holds; fail if it never does or the service ends before."""
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            assert self.process.poll() is None, f"the service ended: {self.err}"
            assert time.monotonic() < deadline_s, f"never came true; out: {self.out} err: {self.err}"
            time.sleep(0.005)

    def wait(self, timeout_s: float = HANG_S) -> Ended:
        """Return what is left when the service has ended."""
        status = self.process.wait(timeout_s)
        return Ended(status=status, out=self.out, err=self.err)


@contextmanager
def service(
    folder: Path,
    *arguments: str | Path,
    wrapper: Sequence[str] = (),
    program: Sequence[str] = PROGRAM,
    variables: Mapping[str, str] = NOTHING,
) -> Iterator[Service]:
    """Start a service, or another ``program``; it does not outlive the block."""
    folder.mkdir(parents=True, exist_ok=True)
    running = Service(folder, [*wrapper, *program, *(str(argument) for argument in arguments)], variables)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
        running.process.wait(HANG_S)


def run_service(
    folder: Path, *arguments: str | Path, wrapper: Sequence[str] = (), variables: Mapping[str, str] = NOTHING
) -> Ended:
    """Run a service to its end."""
    with service(folder, *arguments, wrapper=wrapper, variables=variables) as running:
        return running.wait()


def environment() -> dict[str, str]:
    """Return an environment in which nothing of the user's configures a bus or a broker."""
    return {name: value for name, value in os.environ.items() if not name.startswith(OWN_PREFIXES)}
