"""Pytest plugin: what the run stood on (kernel, broker), and no skipped test goes unseen.

A skipped test proves nothing, so a single skip fails the run. Tests that a machine cannot run are deselected by their
marker (``-m "not vcan"``) and run where they can, instead.
"""

import os
import platform
import shutil
import subprocess
from collections import Counter, defaultdict
from pathlib import Path

import pytest

from tests.support.patience import HANG_S

SYSTEM_PROGRAM_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")


def kernel_line() -> str:
    """Return name, release and kind of the running kernel."""
    cpu = Path("/proc/cpuinfo")
    is_user_mode = cpu.is_file() and "User Mode Linux" in cpu.read_text(encoding="utf-8")
    return f"{platform.system()} {platform.release()}, {'User-Mode Linux' if is_user_mode else 'native'}"


def broker_line() -> str:
    """Return the version line of the installed Mosquitto."""
    path = os.pathsep.join((os.environ.get("PATH", os.defpath), *SYSTEM_PROGRAM_FOLDERS))
    program = shutil.which("mosquitto", path=path)
    if program is None:
        return "none, mosquitto is not installed"
    answer = subprocess.run([program, "-h"], capture_output=True, text=True, check=False, timeout=HANG_S)
    return next(iter(answer.stdout.splitlines()), "mosquitto of unknown version")


class RunReport:
    """Counts skips while the run goes on, fails it for one, and says at the end where it ran."""

    def __init__(self) -> None:
        self.skipped: list[str] = []
        self.counts, self.durations_s = Counter[str](), defaultdict[str, float](float)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note a module that was skipped as a whole."""
        if report.skipped:
            self.skipped.append(report.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what a test took, and that it was skipped; an expected failure ran, so it is none."""
        folder = "/".join(report.nodeid.split("/")[:2])
        self.counts[folder] += report.when == "call"
        self.durations_s[folder] += report.duration
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skipped.append(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail an otherwise green run that skipped something."""
        if self.skipped and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Tell what each folder of tests took, name kernel and broker, and whatever was skipped."""
        for folder, duration_s in sorted(self.durations_s.items(), key=lambda item: -item[1]):
            terminalreporter.write_line(f"{folder}: {self.counts[folder]} tests, {duration_s:.0f} s of all workers")
        terminalreporter.write_line(f"kernel: {kernel_line()}; broker: {broker_line()}; skipped: {len(self.skipped)}")
        for name in self.skipped:
            terminalreporter.write_line(f"skipped, which fails this run: {name}", red=True)


def pytest_configure(config: pytest.Config) -> None:
    """Put the report to work."""
    config.pluginmanager.register(RunReport(), "clutchdiag-run-report")
