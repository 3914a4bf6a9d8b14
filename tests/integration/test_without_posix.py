"""Analysts sit at Windows and macOS: what reads recordings needs nothing that only POSIX, or only Linux, has."""

import subprocess
import sys
from pathlib import Path

from tests.support.patience import HANG_S
from tests.support.service import environment


def test_recordings_are_read_without_what_only_posix_has(drive_log: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.tools.portable", str(drive_log), "--without-posix"],
        capture_output=True, text=True, timeout=HANG_S, check=False, env=environment(),
        cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "3 shifts" in done.stdout
    assert " signals of drive.log on " in done.stdout.splitlines()[-1]
