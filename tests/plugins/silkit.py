"""Pytest plugin: a SIL Kit registry on loopback, and programs that take part in its simulations.

They run in ``.venv-silkit``, for SIL Kit's binding needs Python 3.12 or newer; ``make silkit`` makes it. Where that is
not possible the tests that need it are left out, and the end of the run says so.
"""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import pytest

from tests.support.patience import HANG_S
from tests.support.ports import free_port

ROOT: Final = Path(__file__).parents[2]
PROGRAMS: Final = ROOT / ".venv-silkit" / "bin"
PYTHON: Final = PROGRAMS / "python"
_left_out = pytest.StashKey[int]()


class Simulations:
    """A registry, and what takes part in the simulations that it knows; all ends with the test."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.uri = f"silkit://127.0.0.1:{free_port()}"
        self._folder, self._stack = folder, stack
        self._registry: subprocess.Popen[bytes] | None = None

    def start_registry(self) -> None:
        """Start the registry, and return when it listens."""
        log = self._folder / "registry.log"
        self._registry = self._start(["registry", "--listen-uri", self.uri, "--log", "info"], log)
        deadline_s = time.monotonic() + HANG_S
        while b"Press Ctrl-C" not in log.read_bytes():
            assert time.monotonic() < deadline_s, log.read_text(encoding="utf-8")
            time.sleep(0.02)

    def end_registry(self) -> None:
        """Kill the registry: it says goodbye to nobody."""
        assert self._registry is not None
        self._registry.kill()
        self._registry.wait()

    def begin(self, *participants: str) -> None:
        """Start a system controller: the simulation begins when these are there."""
        self._start(["system-controller", "-u", self.uri, "-l", "off", *participants], self._folder / "controller.log")

    def start(
        self, program: str, *words: str, step_s: float = 0.001, registry: str | None = None, patience_s: float = HANG_S,
    ) -> "subprocess.Popen[str]":  # fmt: skip
        """Start a program that finds the registry, or looks for another."""
        settings = {"registry": registry or self.uri, "step_s": step_s, "patience_s": patience_s}
        process = subprocess.Popen(
            [PROGRAMS / program, *words],
            env={**os.environ, "CAN_CONFIG": json.dumps(settings), "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._stack.callback(_end, process)
        return process

    def _start(self, words: list[str], log: Path) -> "subprocess.Popen[bytes]":
        (tool,) = PROGRAMS.parent.glob(f"lib/python3*/site-packages/SilKit_py/bin/sil-kit-{words[0]}")
        with log.open("wb") as out:
            process = subprocess.Popen([tool, *words[1:]], stdout=out, stderr=subprocess.STDOUT)
        self._stack.callback(_end, process)
        return process


def _end(process: "subprocess.Popen[bytes] | subprocess.Popen[str]") -> None:
    process.kill()
    process.communicate()


@pytest.fixture
def simulations(tmp_path: Path) -> Iterator[Simulations]:
    """Return a registry that runs."""
    with ExitStack() as stack:
        made = Simulations(tmp_path, stack)
        made.start_registry()
        yield made


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what needs SIL Kit where it is not."""
    wanted = [item for item in items if item.get_closest_marker("silkit") is None]
    if not PYTHON.exists() and len(wanted) < len(items):
        config.stash[_left_out] = len(items) - len(wanted)
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("silkit")])
        items[:] = wanted


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many were left out."""
    if count := config.stash.get(_left_out, 0):
        line = f"SIL Kit: {count} tests were left out: there is no .venv-silkit, which `make silkit` makes"
        terminalreporter.write_line(line, yellow=True)
