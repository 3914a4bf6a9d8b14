"""What users do wrong at the emulator as a process; the table in ``test_bad_input_service`` says where the rest is."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.in_process import ended as run
from tests.support.patience import HANG_S
from tests.support.service import service

EMULATOR = (sys.executable, "-m", "ecu_emulator")


def emulate(*arguments: str | Path, wrapper: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    command = [*wrapper, *EMULATOR, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)


def assert_one_line(done: subprocess.CompletedProcess[str], status: int, *texts: str) -> None:
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (status, 1, ""), done.stderr
    assert done.stderr.startswith("ecu-emulator: error: ")
    for text in texts:
        assert text in done.stderr


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    # Root passes every permission bit unless it gives that up.
    wrapper = ("setpriv", "--bounding-set", "-dac_override,-dac_read_search") if os.getuid() == 0 else ()
    assert_one_line(emulate("record", folder / "drive.log", wrapper=wrapper), 4, "cannot write", "Permission denied")


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
