"""Disks that are full from the beginning: what cannot be whole is not left behind."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import HANG_S


def run_with(most_bytes: int, folder: Path, *words: str | Path) -> "subprocess.CompletedProcess[str]":
    """Run a program none of whose files may become larger."""
    return subprocess.run(
        ["prlimit", f"--fsize={most_bytes}", sys.executable, "-B", "-m", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=HANG_S,
    )


def test_the_truth_of_a_log_that_cannot_be_written_goes_with_it(tmp_path: Path) -> None:
    words = ("ecu_emulator", "record", "drive.log", "--scenario", "noise_only", "--cycles", "1")
    told = run_with(60_000, tmp_path, *words)
    assert (told.returncode, told.stderr) == (4, "ecu-emulator: error: cannot write drive.log: File too large\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("most_bytes", "words"),
    [
        (60_000, ("record", "mine.log", "--scenario", "noise_only", "--cycles", "1")),
        (2_000, ("dbc", "-o", "mine.log")),
    ],
)
def test_what_was_there_stays_where_what_is_to_replace_it_cannot_be_whole(
    tmp_path: Path, most_bytes: int, words: tuple[str, ...]
) -> None:
    kept = {"mine.log": "mine", "mine.log.truth.jsonl": "true of mine"}
    for name, text in kept.items():
        (tmp_path / name).write_text(text, encoding="ascii")
    told = run_with(most_bytes, tmp_path, "ecu_emulator", *words, "--force")
    assert (told.returncode, told.stderr) == (4, "ecu-emulator: error: cannot write mine.log: File too large\n")
    assert {path.name: path.read_text(encoding="ascii") for path in tmp_path.iterdir()} == kept


def test_what_is_left_of_a_store_that_cannot_be_made_is_removed(drive_log: Path, tmp_path: Path) -> None:
    told = run_with(20_480, tmp_path, "diag_service", "analyze", drive_log, "--store", "car.sqlite")
    assert told.returncode == 4
    assert "cannot use store" in told.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {"car.sqlite.lock"}
