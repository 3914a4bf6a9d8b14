"""Pytest plugin: a recorded drive and its beginning, made once per run, for all of its workers."""

import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import HANG_S

SHIFT_COUNT = 3  # 1-2, 2-3, 3-4
_END_S = 12


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of this run that all of its workers know."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if own.name.startswith("popen-") else own) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def cycle_log(shared_folder: Path) -> Path:
    """Return the candump log of the nominal drive: one cycle, ten shifts."""
    path = shared_folder / "cycle.log"
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            subprocess.run(
                [sys.executable, "-m", "ecu_emulator", "record", str(path)],
                check=True, capture_output=True, timeout=HANG_S,
            )  # fmt: skip
    return path


@pytest.fixture(scope="session")
def drive_log(cycle_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the candump log of the first ``SHIFT_COUNT`` shifts of the nominal drive."""
    path = tmp_path_factory.mktemp("drive") / "drive.log"
    lines = cycle_log.read_bytes().splitlines(keepends=True)
    first_s = send_time_s(lines[0])
    path.write_bytes(b"".join(line for line in lines if send_time_s(line) < first_s + _END_S))
    return path


def send_time_s(line: bytes) -> float:
    """Return the time of a line of a candump log."""
    return float(line[1 : line.index(b")")])
