"""The first start of a program on a machine says that it compiles, before it does."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.service import environment


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("diag-service", ("diag_service", "inspect", "drive.log")),
        ("ecu-emulator", ("ecu_emulator", "record", "made.log", "--cycles", "1")),
    ],
)
def test_the_first_start_says_that_it_compiles(program: str, command: Sequence[str], tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_bytes(b"(1700000000.000000) can0 123#11\n")
    starting = subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=tmp_path,
        env={**environment(), "XDG_CACHE_HOME": str(tmp_path / "cache")},
        stderr=subprocess.PIPE,
        text=True,
    )
    with starting:
        assert starting.stderr is not None
        first = starting.stderr.readline()
        starting.kill()
    assert first == f"{program}: compiling numerical kernels, as at every first start; this takes up to a minute\n"
