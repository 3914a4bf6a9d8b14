"""gallia, a scanner that is not ours, finds the entity, its address and its services."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.doip.tester import entity
from tests.support.patience import HANG_S


@pytest.fixture(scope="module")
def target() -> Iterator[str]:
    with entity() as (_, server):
        yield f"doip://{server.place}?activation_type=0&src_addr=0x0e00"


def gallia(folder: Path, *words: str) -> str:
    """Return what it says; it keeps its files, and looks for settings, in this folder."""
    program = "import sys; from gallia.cli.gallia import main; sys.exit(main())"
    told = subprocess.run(
        [sys.executable, "-c", program, *words],
        check=False, capture_output=True, text=True, timeout=HANG_S, cwd=folder,
        env={**os.environ, "HOME": str(folder), "NO_COLOR": "1"},
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    return told.stderr + told.stdout


def test_it_discovers_the_entity_and_its_address(target: str, tmp_path: Path) -> None:
    told = gallia(tmp_path, "discover", "doip", "--target", target, "--start", "0x1010", "--stop", "0x1012")
    assert "VIN=b'WDCTEMUL3TED00047'" in told
    assert "is a Node with 0/4 concurrent TCP sockets currently open and a maximum data size of 4095" in told
    assert "0x1010 is an unknown target address" in told
    assert "0x1011 responded: TesterPresentResponse()" in told


def test_it_finds_every_service_of_the_session(target: str, tmp_path: Path) -> None:
    told = gallia(tmp_path, "scan", "uds", "services", "--target", f"{target}&target_addr=0x1011", "--no-dumpcap")
    found = [line.partition("[0x")[2][:2] for line in told.splitlines() if "[result]:   [0x" in line]
    assert found == ["10", "11", "14", "19", "22", "2c", "3e"]
