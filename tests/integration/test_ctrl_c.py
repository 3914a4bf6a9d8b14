"""Ctrl-C while a program loads: at whichever import it comes, there is no traceback, and status 130."""

import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.patience import HANG_S

REPOSITORY = Path(__file__).parents[2]
SPARSE = 211  # beyond the first imports every so many: they are alike
PLAIN = "clutchdiag_io.program"  # the first that a program loads once Ctrl-C is heeded
USUAL = {
    ("diag_service", "analyze", "missing.log"): 3,
    ("diag_service", "history", "--help"): 0,
    ("ecu_emulator", "scenarios"): 0,
    ("ecu_emulator", "dbc", "-o", "car.dbc", "--force"): 0,
    ("fleet_backend", "table", "--database", "sqlite:///missing.sqlite"): 4,
    ("demo", "--help"): 0,
    ("demo.fleet", "--help"): 0,
}
"""Status of each without a signal."""
STARTED = f"""
import os, runpy, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
left, has_begun = int(sys.argv.pop(1)), False

def at_an_import(event, arguments):
    global left, has_begun
    if event != "import":
        return
    has_begun |= arguments[0] == {PLAIN!r}
    if has_begun:
        if left == 0:
            os.kill(os.getpid(), signal.SIGINT)
        left -= 1

sys.addaudithook(at_an_import)
module = sys.argv.pop(1)
try:
    runpy.run_module(module, run_name="__main__", alter_sys=True)
finally:
    sys.stdout.flush()
    os.write(1, f"imports left: {{left}}\\n".encode())
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    status: int
    error: str
    left: int | None  # imports until the signal would have come; None where the program did not end by itself


def interrupted(folder: Path, words: tuple[str, ...], at: int) -> Ended:
    """Return how a program ends that is interrupted at its nth import from the one at which Ctrl-C is heeded."""
    run = subprocess.run(
        [sys.executable, "-c", STARTED, str(at), *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    left = re.search(r"^imports left: (-?\d+)$", run.stdout, re.MULTILINE)
    return Ended(status=run.returncode, error=run.stderr, left=int(left[1]) if left else None)


@pytest.mark.slow
@pytest.mark.parametrize("words", USUAL, ids=" ".join)
def test_ctrl_c_at_any_import_ends_with_130_and_without_a_traceback(tmp_path: Path, words: tuple[str, ...]) -> None:
    at, statuses = 0, set()
    while True:
        ended = interrupted(tmp_path, words, at)
        assert "Traceback" not in ended.error, f"at import {at}: {ended.error}"
        assert len(ended.error.splitlines()) <= 1, f"at import {at}: {ended.error}"
        if ended.left is not None and ended.left >= 0:  # it came to its end before
            assert ended.status == USUAL[words]
            break
        assert ended.status in {130, USUAL[words]}, f"at import {at}: {ended}"
        statuses.add(ended.status)
        at += 1 if at < 4 else SPARSE
    assert at >= 4
    assert 130 in statuses


@pytest.mark.parametrize("words", [("diag_service", "run"), ("fleet_backend", "serve")], ids=" ".join)
def test_a_service_that_is_interrupted_while_it_loads_has_ended_well(tmp_path: Path, words: tuple[str, ...]) -> None:
    for at in (0, 1, 20, 60):
        ended = interrupted(tmp_path, words, at)
        assert (ended.status, ended.error) == (0, "")


def test_what_loads_before_ctrl_c_is_heeded_is_light() -> None:
    """Nobody can heed it while Python itself starts; what a program adds to that is a few modules."""
    heavy = {"ast", "email", "hashlib", "importlib.metadata", "pathlib", "shutil", "tempfile", "zipfile"}
    for module in ("diag_service", "ecu_emulator", "fleet_backend", "demo", "demo.fleet"):
        code = f"import sys, {module}.__main__; print(' '.join(sys.modules))"
        # Without `site`, which has modules of its own for an editable installation.
        command = [sys.executable, "-S", "-c", code]
        places = [REPOSITORY, *(REPOSITORY / name / "src" for name in ("canlog", "fleet"))]
        run = subprocess.run(
            command, env={"PYTHONPATH": ":".join(map(str, places))}, capture_output=True, text=True, check=True
        )
        assert not heavy.intersection(run.stdout.split())


def test_the_signal_is_one_that_python_would_show() -> None:
    """What this file is about: without a handler of ours there is a traceback."""
    code = STARTED.replace(PLAIN, "json")
    words = [sys.executable, "-c", code, "0", "json.tool"]
    run = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=HANG_S)
    assert run.returncode == -signal.SIGINT
    assert "KeyboardInterrupt" in run.stderr
