"""``decode`` gives every number that cantools gives, tells signals apart, and accounts for every frame."""

import json
import signal
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from diag_service.errors import IncompleteError
from diag_service.stopping import Trigger
from tests.support.in_process import command
from tests.support.in_process import ended as run
from tests.support.service import service

Row = dict[str, Any]

STATES = """VERSION ""
BU_: A
BO_ 256 Brake: 4 A
 SG_ State : 0|3@1+ (1,0) [0|3] "" A
 SG_ Lamp : 3|1@1+ (1,0) [0|1] "" A
 SG_ Speed : 8|16@1+ (0.5,-10) [0|100] "km/h" A
VAL_ 256 State 0 "kein_Fehler" 1 "Fault" 2 "initializing" 7 "SNA" ;
VAL_ 256 Lamp 0 "No Fault" 1 "Error present" ;
VAL_ 256 Speed 65535 "not available" ;
"""
LOSSES = """VERSION ""
BU_: A
BO_ 256 Whole: 8 A
 SG_ Low : 0|8@1+ (1,0) [0|10] "" A
 SG_ High : 56|8@1+ (1,0) [0|0] "" A
BO_ 257 Long: 20 A
 SG_ Piece : 0|8@1+ (1,0) [0|0] "" A
BO_ 258 Bad: 2 A
 SG_ Outside : 12|8@1+ (1,0) [0|0] "" A
 SG_ Inside : 0|8@1+ (1,0) [0|0] "" A
BO_ 259 Nothing: 8 A
"""
LOST_LOG = """(1.000000) can0 100#0102030405060708
(1.001000) can0 100#01020304050607
(1.002000) can0 100#
(1.003000) can0 101#1014010203040506
(1.004000) can0 102#0102
(1.005000) can0 103#0102
(1.006000) can0 7AB#00
(1.007000) can0 100#R
(1.008000) can0 20000001#0000000000000000
what is this
(1.009000) can0 100#FF02030405060708
"""


def execute(*words: str | Path, stop: Trigger | None = None) -> None:
    """Run the command in this process."""
    command("decode", *words, stop=stop)


def decoded(tmp_path: Path, database: str, log: str, *words: str) -> list[Row]:
    """Return the rows of a decoded log."""
    (tmp_path / "car.dbc").write_text(database, encoding="utf-8")
    (tmp_path / "drive.log").write_text(log, encoding="ascii")
    execute(tmp_path / "drive.log", "--dbc", tmp_path / "car.dbc", "-o", tmp_path / "out.parquet", "--force", *words)
    return list(pq.read_table(tmp_path / "out.parquet").to_pylist())


def told(tmp_path: Path, capsys: pytest.CaptureFixture[str], database: str, log: str, *words: str) -> Row:
    """Return what ``decode --json`` says."""
    decoded(tmp_path, database, log, "--json", *words)
    record = json.loads(capsys.readouterr().out)
    assert isinstance(record, dict)
    return record


def log_of(*frames: str) -> str:
    """Return a candump log."""
    return "".join(f"({1 + place / 1000:.6f}) can0 {frame}\n" for place, frame in enumerate(frames))


SAILS = """VERSION ""
BU_: A
BO_ {} Sails: 8 A
 SG_ Area : 0|8@1+ (1,0) [0|0] "" A

BO_ 256 Cabin: 1 A
 SG_ Light : 0|8@1+ (1,0) [0|0] "" A
"""
SAILS_LOG = log_of("09F11223#0700000000000000", "05F11224#0800000000000000", "100#01")


@pytest.mark.parametrize(("words", "areas"), [((), [None] * 3), (("--match", "group"), [7.0, 8.0, None])])
def test_groups_are_matched_where_that_is_asked_for_and_proposed_where_it_would_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], areas: list[float | None]
) -> None:
    database = SAILS.format(0x89F11255)
    rows = decoded(tmp_path, database, SAILS_LOG, *words)
    assert [row.get("Sails.Area") for row in rows if row["message"] == "Sails"] == [one for one in areas if one]
    capsys.readouterr()
    proposal = (
        "2 frames have the parameter group (PGN) of a message of the database, but another identifier: "
        "--match group decodes them"
    )
    assert (proposal in told(tmp_path, capsys, database, SAILS_LOG, *words)["losses"]) == (not words)


STATE_LOG = log_of("100#00000000", "100#09640000", "100#0AFFFF00", "100#07FEFF00", "100#0B010000")


def test_every_frame_and_every_loss_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = told(tmp_path, capsys, LOSSES, LOST_LOG)
    frames = record["frames"]
    assert frames.pop("read") == sum(frames.values()) == 10
    assert frames == {
        "decoded": 3, "short": 2, "transported": 1, "without_signals": 1, "unknown": 1, "remote": 1, "error": 1,
        "left_out": 0,
    }  # fmt: skip
    assert record["unreadable"] == {"malformed": 1}
    assert record["refused"] == {"Bad.Outside": "Bad.Outside lies outside its message"}
    whole = record["messages"][0]["signals"]
    assert whole["Low"] == {"column": "Whole.Low", "values": 3, "cut_off": 1, "out_of_range": 1, "not_a_number": 0}
    assert whole["High"] == {"column": "Whole.High", "values": 2, "cut_off": 2, "out_of_range": 0, "not_a_number": 0}
    assert record["identifiers"] == {
        "seen": 5, "known": 4, "unlisted_frames": 0, "nearest": [],
        "unknown": [{"id": "0x7AB", "is_extended": False, "frames": 1}],
    }  # fmt: skip
    assert len(record["losses"]) == 4
    rows = pq.read_table(tmp_path / "out.parquet").to_pylist()
    assert record["rows"] == len(rows) == 5
    assert [row["Whole.Low"] for row in rows] == [1, 1, None, None, 255]
    assert [row["Whole.High"] for row in rows] == [8, None, None, None, 8]
    assert [row["Bad.Inside"] for row in rows] == [None, None, None, 1, None]


def test_strict_writes_the_file_and_complains_with_a_status_of_its_own(tmp_path: Path) -> None:
    decoded(tmp_path, LOSSES, LOST_LOG)
    words = ("decode", tmp_path / "drive.log", "--dbc", tmp_path / "car.dbc", "-o", tmp_path / "o.parquet")
    strict = run(*words, "--strict", "--json")
    assert (strict.status, len(strict.out.splitlines())) == (5, 1)
    assert "drive.log: not all of it is in " in strict.err.splitlines()[-1]
    assert pq.read_table(tmp_path / "o.parquet").num_rows == 5
    assert run(*words, "--force").status == 0


def test_a_database_that_matches_nothing_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = log_of("18FEF100#0000000000000000", "101#00", "101#00")
    database = STATES.replace("BO_ 256", f"BO_ {0x98FEF155}").replace(" 256 ", f" {0x98FEF155} ")
    record = told(tmp_path, capsys, database, log)
    assert record["identifiers"]["known"] == 0
    loss, proposal = record["losses"]
    assert proposal.startswith("1 frames have the parameter group")
    assert loss == (
        "0 of 2 identifiers are in this database; nearest: 0x101 of the log to 0x18FEF155 Brake; 0x18FEF100 of the log "
        "to 0x18FEF155 Brake (the same J1939 parameter group, but the database does not call the message one of J1939)"
    )
    assert record["rows"] == 0
    with pytest.raises(IncompleteError, match="0 of 2 identifiers are in this database"):
        decoded(tmp_path, database, log, "--strict")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_has_the_status_that_a_shell_gives_it(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "car.dbc").write_text(STATES, encoding="utf-8")
    (tmp_path / "drive.log").write_text(STATE_LOG, encoding="ascii")
    words = ("decode", tmp_path / "drive.log", "--dbc", tmp_path / "car.dbc", "-o", tmp_path / "out.parquet")
    with service(tmp_path / "run", *words) as running:
        running.wait_until_it_catches(signal.SIGTERM)  # the later of the two
        running.send(number)
        ended = running.wait()
    assert (ended.status, ended.out) == (128 + number, "")
    assert ended.err == "diag-service: stopped early: no file was written\n"
    assert not list(tmp_path.glob("*parquet*"))
