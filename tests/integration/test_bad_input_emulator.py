"""A recording that is killed or stopped, as a process."""

import signal
import sys
from pathlib import Path

import pytest

from tests.support.in_process import ended as run
from tests.support.service import service

EMULATOR = (sys.executable, "-m", "ecu_emulator")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_recording_killed_leaves_no_half_a_log_and_the_next_one_is_whole(
    tmp_path: Path, number: signal.Signals
) -> None:
    """Stopped, it keeps what it has; killed, it leaves nothing that could be taken for a log."""
    log, truth = tmp_path / "drive.log", tmp_path / "drive.log.truth.jsonl"
    arguments = ("record", log, "--cycles", "1000")
    with service(tmp_path / "killed", *arguments, program=EMULATOR) as killed:
        killed.wait_for(lambda: truth.exists() and truth.read_bytes().count(b"\n") > 2)
        killed.send(signal.SIGKILL)
        killed.wait()
    assert not log.exists()
    truth.unlink()
    with service(tmp_path / "stopped", *arguments, program=EMULATOR) as stopped:
        stopped.wait_for(lambda: truth.exists() and truth.read_bytes().count(b"\n") > 2)
        stopped.send(number)
        assert stopped.wait().status == 128 + number
    analysed = run("analyze", log, "--json")
    assert (analysed.status, analysed.err) == (0, "")
    assert analysed.summary["frames"]["on_bus"] == log.read_bytes().count(b"\n")
