"""The demonstration, as people run it: a drive with aged fluid to its verdict, and Ctrl-C in the middle."""

import asyncio
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from demo.outcome import complaints, verdict_lines
from demo.runner import RECORDING, DemoOptions, drive_in_virtual_time
from ecu_emulator.truth import read_truth
from tests.support.patience import HANG_S
from tests.support.service import environment
from tests.support.starvation import AHEAD, STARVED_S, undisturbed

ROOT = Path(__file__).parents[2]
INTERRUPTED = 130
AGED = ["verdict: clutch 1 change fluid", "verdict: clutch 2 change fluid"]
SHIFTS, LONGEST_S = 6, 25.0  # driven on the bus, and within which time: with the start of programs half a minute
SCANNED = "scan tool: no trouble codes"

pytestmark = pytest.mark.slow


@contextmanager
def demo(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Start a demonstration without a terminal; neither it nor its children outlive the block."""
    command = [*AHEAD, sys.executable, "-m", "demo", "--output", str(folder), *arguments]
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    family = psutil.Process(process.pid)
    try:
        yield process
    finally:
        left = [*family.children(recursive=True), family] if family.is_running() else []
        for one in left:
            one.kill()
        process.wait(HANG_S)
        if process.stdout is not None:
            process.stdout.close()


def test_aged_fluid_is_found(tmp_path: Path) -> None:
    """Where the machine let the emulator send; a drive that it sent late is driven again."""

    def attempt(number: int) -> tuple[int, str, Path]:
        folder = tmp_path / str(number)
        with demo(folder, "--scenario", "case2") as process:
            said, _ = process.communicate(timeout=HANG_S)
        assert process.returncode == 0, said  # on the busiest machine
        return process.returncode, said, folder

    def is_disturbed(outcome: tuple[int, str, Path]) -> bool:
        _, said, folder = outcome
        if (verdicts(said), said.splitlines()[-1:]) == (AGED, [SCANNED]) and "too busy" not in said:
            return False
        sent = json.loads((folder / "ecu-emulator.out").read_text(encoding="utf-8"))
        return bool(sent["lateness_max_s"] > STARVED_S)

    status, said, folder = undisturbed(attempt, is_disturbed)
    assert status == 0, said
    assert sum("after its end" in line for line in said.splitlines()) == SHIFTS, said
    assert verdicts(said) == AGED, said
    assert "Change the fluid now." in said
    for clutch in (1, 2):
        assert f"Clutch {clutch}: it can shudder " in said
    assert said.splitlines()[-1] == SCANNED, said
    assert "unexplained: 0" in said
    assert (folder / "demo.png").read_bytes().startswith(b"\x89PNG")
    table = said[said.index("while its fluid ages") : said.index("Single shifts")]
    course = re.findall(r"(good|watch|change fluid) *$", table, re.MULTILINE)
    assert list(dict.fromkeys(course)) == ["good", "watch", "change fluid"], said
    took = re.search(r"^took: .*$", said, re.MULTILINE)
    assert took is not None, said
    parts = re.sub(r"\d+ s", "", took.group()).replace(" ", "")
    assert parts == "took:kernels,recordingandservice,driving,pictures"
    sixth = read_truth(folder / "truth.jsonl").shifts[SHIFTS - 1]
    assert sixth.t_end_s < LONGEST_S
    assert (folder / "ageing.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_the_same_drive_is_as_it_must_be_in_virtual_time(tmp_path: Path) -> None:
    """What is shown where the machine was too busy, which `lateness_text` tells."""
    options = DemoOptions(
        scenario="case2", seed=None, shifts=SHIFTS, broker=None, broker_url=None, vehicle="demo", folder=tmp_path
    )
    record = [sys.executable, "-m", "ecu_emulator", "record", str(tmp_path / RECORDING), *options.drive]
    subprocess.run(record, check=True, capture_output=True, env=environment(), timeout=HANG_S)
    outcome = asyncio.run(drive_in_virtual_time(options))
    assert complaints(outcome) == []
    assert len(outcome.shifts) >= SHIFTS
    assert [line.plain for line in verdict_lines(outcome) if line.plain.startswith("verdict")] == AGED


def verdicts(said: str) -> list[str]:
    return [line for line in said.splitlines() if line.startswith("verdict: ")]


def test_an_interrupt_ends_all_children(tmp_path: Path) -> None:
    with demo(tmp_path) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("driving "):  # the service is on the bus and the broker, the others begin
                break
        driver = tmp_path / "ecu-emulator.log"
        while not driver.exists() or "sending on" not in driver.read_text(encoding="utf-8"):
            assert process.poll() is None
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        # Emulator, service, subscriber, and the two of the fluid that ages, until it has.
        assert 3 <= len(children) <= 5
        process.send_signal(signal.SIGINT)
        assert process.wait(HANG_S) == INTERRUPTED
        _, alive = psutil.wait_procs(children, timeout=HANG_S)
        assert alive == []
    for name in ("ecu-emulator.log", "diag-service.log"):
        assert "Traceback" not in (tmp_path / name).read_text(encoding="utf-8")


def test_a_scenario_that_does_not_exist_is_one_clear_line(tmp_path: Path) -> None:
    with demo(tmp_path, "--scenario", "nowhere") as process:
        said, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 1
    assert "demo: error: ecu-emulator ended with status 2" in said
    assert "nowhere" in said.splitlines()[-1]
