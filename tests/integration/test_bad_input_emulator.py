"""A recording that is killed or stopped, as a process."""

import signal
import sys
from pathlib import Path

from tests.support.in_process import ended as run
from tests.support.service import service

EMULATOR = (sys.executable, "-m", "ecu_emulator")


def test_a_recording_killed_leaves_no_half_a_log_and_the_next_one_is_whole(tmp_path: Path) -> None:
    """Stopped, it keeps what it has; killed, it leaves nothing that could be taken for a log."""
    log, truth = tmp_path / "drive.log", tmp_path / "drive.log.truth.jsonl"
    arguments = ("record", log, "--cycles", "1000")

    def ended_by(number: signal.Signals) -> int:
        with service(tmp_path / number.name, *arguments, program=EMULATOR) as recording:
            recording.wait_for(lambda: truth.exists() and truth.read_bytes().count(b"\n") > 2)
            recording.send(number)
            return recording.wait().status

    ended_by(signal.SIGKILL)
    assert not log.exists()
    for number in (signal.SIGINT, signal.SIGTERM):
        truth.unlink()
        log.unlink(missing_ok=True)
        assert ended_by(number) == 128 + number
        analysed = run("analyze", log, "--json")
        assert (analysed.status, analysed.err) == (0, "")
        assert analysed.summary["frames"]["on_bus"] == log.read_bytes().count(b"\n")
