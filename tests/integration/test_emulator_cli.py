"""The emulator's command line: exit status, one clear line for every error, clean stops."""

import json
import os
import re
import signal
import threading
from pathlib import Path

import can
import cantools
import pytest

from dbc.contract import load_contract
from ecu_emulator import write_dbc
from ecu_emulator.cli import main
from ecu_emulator.truth import read_truth, truth_path
from tests.support.patience import HANG_S

SOME_FRAMES = 600  # about a second of driving
RECORD = ("--scenario", "noise_only", "--cycles", "1")


def error_line(captured: pytest.CaptureFixture[str]) -> str:
    lines = captured.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert lines[0].startswith("ecu-emulator: error: ")
    return lines[0]


def test_record_writes_log_and_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "drive.log"
    assert main(["record", str(path), *RECORD, "--json", "--channel", "can7"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    truth = read_truth(truth_path(path))
    lines = path.read_text(encoding="ascii").splitlines()
    assert lines[0].startswith("(1767225600.000000) can7 0A0#")
    assert result["frames"] == len(lines)
    assert (result["shifts"], result["finished"]) == (10, True)
    assert truth.totals is not None
    assert (truth.totals.frames, truth.totals.shifts, len(truth.shifts)) == (len(lines), 10, 10)
    assert re.search(r"[\d.]+ s of driving in [\d.]+ s; truth in ", captured.err)


def test_overrides_reach_the_drive(tmp_path: Path) -> None:
    path, truth_file = tmp_path / "drive", tmp_path / "truth.jsonl"
    arguments = ["record", str(path), "--format", "candump", "--truth", str(truth_file), "--scenario", "ideal"]
    changes = ["--fluid", "case2", "--seed", "77", "--cycles", "2", "--start-time", "2026-11-20T10:00:00.5+01:00"]
    assert main([*arguments, *changes, "--routine", "2,1"]) == 0
    truth = read_truth(truth_file)
    assert [rev.are_clutches_closed for rev in truth.revs] == [False, False, True]
    assert (truth.drive.fluid, truth.drive.seed, truth.drive.cycles, len(truth.shifts)) == ("case2", 77, 2, 20)
    assert truth.drive.mu_c == pytest.approx((0.119, 0.119))
    assert path.read_text(encoding="ascii").startswith("(1795165200.500000) vcan0 ")
    assert not truth_path(path).exists()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "missing command"),
        (["fly"], "fly"),
        (["record"], "FILE"),
        (["record", "x.log", "--start-time", "soon"], "soon"),
        (["record", "x.log", "--drive", "nedc"], "'nedc' is not one of"),
        (["record", "x.log", "--oil-degc", "-40"], "'--oil-degc': -40.0 is not in the range -15.0<=x<=130.0"),
        (["record", "x.log", "--mass-kg", "nan"], "mass_kg must be 900..3500, got nan"),
        (["record", "x.log", "--start-time", "1969-01-01"], "1970"),
        (["run", "--parked", "-1"], "--parked"),
    ],
)
def test_wrong_usage_is_one_line(capsys: pytest.CaptureFixture[str], arguments: list[str], named: str) -> None:
    assert main(arguments) == 2
    assert named in error_line(capsys)


@pytest.mark.parametrize("number", [signal.SIGTERM])
def test_a_live_drive_stops_cleanly_and_accounts_for_every_frame(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    truth_file = tmp_path / "truth.jsonl"
    arguments = ["run", "-i", "virtual", "-c", f"stop{number}", *RECORD, "--json"]
    handlers = [signal.getsignal(known) for known in (signal.SIGINT, signal.SIGTERM)]
    received: list[can.Message] = []
    with can.Bus(f"stop{number}", "virtual") as listener:
        reader = threading.Thread(target=receive_then_kill, args=(listener, received, number, truth_file))
        reader.start()
        assert main([*arguments, "--truth", str(truth_file)]) == 0
        reader.join()
        while (message := listener.recv(timeout=0.0)) is not None:
            received.append(message)
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert result["frames_sent"] == len(received)
    assert (result["is_complete"], result["frames_given_up"]) == (False, 0)
    assert result["foreign_frames"] == 0
    assert "stopped early" in captured.err
    truth = read_truth(truth_file)
    assert [shift.number for shift in truth.shifts] == [*range(1, result["shifts"] + 1)]
    assert 1 <= result["shifts"] < 10
    assert truth.totals is not None
    assert truth.totals.frames == len(received)
    assert truth.shifts[-1].t_end_s <= truth.totals.duration_s
    assert [signal.getsignal(known) for known in (signal.SIGINT, signal.SIGTERM)] == handlers


def receive_then_kill(
    listener: can.BusABC, received: list[can.Message], number: signal.Signals, truth: Path | None = None
) -> None:
    """Receive a drive until it has sent a second's frames and, where there is its truth, told of a shift; then stop it.

    However late a busy machine sends and receives, that has happened by then.
    """
    while (message := listener.recv(timeout=HANG_S)) is not None:
        received.append(message)
        if len(received) >= SOME_FRAMES and (truth is None or '"shift"' in truth.read_text(encoding="utf-8")):
            os.kill(os.getpid(), number)
            return


def test_the_database_of_the_car_is_printed_or_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "car.dbc"
    assert main(["dbc"]) == 0
    printed = capsys.readouterr().out
    assert main(["dbc", "-o", str(path)]) == 0
    assert path.read_bytes() == printed.encode()
    assert write_dbc(path) == path.stat().st_size == len(printed)
    database = cantools.database.load_file(path)
    assert isinstance(database, cantools.database.can.Database)
    assert {one.name for one in database.messages} == {one.name for one in load_contract().messages}
    assert main(["dbc", "--transmission", "lockup"]) == 0
    assert "TurbineSpeed" in capsys.readouterr().out
    assert main(["dbc", "-o", str(path)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["dbc", "-o", str(tmp_path), "--force"]) == 4
