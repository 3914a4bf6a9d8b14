"""Pytest plugin: a recorded drive and its beginning, made once per run."""

import subprocess
import sys
from pathlib import Path

import pytest

SHIFT_COUNT = 3  # 1-2, 2-3, 3-4
_END_S = 12


@pytest.fixture(scope="session")
def cycle_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the candump log of the nominal drive: one cycle, ten shifts."""
    path = tmp_path_factory.mktemp("drive") / "cycle.log"
    subprocess.run(
        [sys.executable, "-m", "ecu_emulator", "record", str(path)], check=True, capture_output=True, timeout=300
    )
    return path


@pytest.fixture(scope="session")
def drive_log(cycle_log: Path) -> Path:
    """Return the candump log of the first ``SHIFT_COUNT`` shifts of the nominal drive."""
    path = cycle_log.with_name("drive.log")
    lines = cycle_log.read_bytes().splitlines(keepends=True)
    first_s = send_time_s(lines[0])
    path.write_bytes(b"".join(line for line in lines if send_time_s(line) < first_s + _END_S))
    return path


def send_time_s(line: bytes) -> float:
    """Return the time of a line of a candump log."""
    return float(line[1 : line.index(b")")])
