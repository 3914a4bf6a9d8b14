"""What users do wrong at the emulator as a process; the table in ``test_bad_input_service`` says where the rest is."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ecu_emulator.cli import main
from tests.support.in_process import ended as run
from tests.support.patience import HANG_S
from tests.support.service import service

EMULATOR = (sys.executable, "-m", "ecu_emulator")
SCENARIO = Path(__file__).parents[2] / "ecu_emulator" / "scenarios" / "noise_only.toml"


def emulate(*arguments: str | Path, wrapper: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    command = [*wrapper, *EMULATOR, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)


def assert_one_line(done: subprocess.CompletedProcess[str], status: int, *texts: str) -> None:
    assert (done.returncode, done.stderr.count("\n"), done.stdout) == (status, 1, ""), done.stderr
    assert done.stderr.startswith("ecu-emulator: error: ")
    for text in texts:
        assert text in done.stderr


@pytest.mark.parametrize(
    ("change", "texts"),
    [
        (("seed = 1", 'seed = 1\ncolour = "red"'), ("colour",)),
        (("pedal_ratio = 0.45", "pedal_ratio = 45.0"), ("pedal_ratio",)),
        (('condition = "ideal"', 'condition = "water"'), ("water",)),
        (("cycles = 1", 'cycles = "many"'), ("cycles",)),
        (("seed = 1", "seed ="), ("TOML",)),
    ],
    ids=["unknown key", "out of range", "unknown fluid", "wrong type", "not TOML"],
)
def test_a_scenario_file_that_cannot_be_used(
    tmp_path: Path, change: tuple[str, str], texts: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    text = SCENARIO.read_text(encoding="utf-8")
    assert change[0] in text
    scenario, log = tmp_path / "mine.toml", tmp_path / "drive.log"
    scenario.write_text(text.replace(*change), encoding="utf-8")
    assert main(["record", str(log), "--scenario", str(scenario)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith("ecu-emulator: error: ")
    assert all(text in said.err for text in (str(scenario), *texts))
    assert not log.exists()


def test_a_folder_that_may_not_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    # Root passes every permission bit unless it gives that up.
    wrapper = ("setpriv", "--bounding-set", "-dac_override,-dac_read_search") if os.getuid() == 0 else ()
    assert_one_line(emulate("record", folder / "drive.log", wrapper=wrapper), 4, "cannot write", "Permission denied")


def test_a_bus_of_another_kind(tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    assert_one_line(emulate("run", "-i", "carrier_pigeon", "-c", "0", "--truth", truth), 3, "carrier_pigeon")
    assert not truth.exists()


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
