"""The backend's tables before terminals, in pipes and in pipes that break; names that are mistyped."""

import json
import re
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from clutch_results.records import Condition
from fleet_backend.cli import main
from fleet_backend.database import open_database
from fleet_backend.rows import quarantine_row
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of

VIN, LONGEST = "WVWZZZ1JZ3W386752", "bus-" + "0123456789" * 6
QUESTIONS = (["table"], ["trend", VIN, "2"], ["alarms"], ["quarantine"], ["seen"])


@pytest.fixture(name="database")
def _database(sqlite_url: str) -> str:
    """Return the address of a database with vehicles of short and long names and something to say of each."""
    engine = open_database(sqlite_url)
    rows = [row_of(fleet_result(seq, vehicle=VIN, condition=Condition.CHANGE_FLUID)) for seq in (1, 2, 3)]
    rows += [row_of(fleet_result(1, vehicle=name)) for name in (LONGEST, "taxi-1", "taxi-2")]
    detail = "not of the schema:\tdata.estimate [bold]\x1b[31m\nsecond line \udc80"
    now = datetime.now(UTC)
    Writer(engine).store(
        Batch(
            shifts=rows,
            quarantined=[
                quarantine_row(
                    now, topic=f"clutchdiag/v1/{VIN}/shift", vehicle=VIN, payload=b"{", reason="identity", detail=detail
                )
            ],
        )
    )
    engine.dispose()
    return sqlite_url


@pytest.mark.parametrize("question", QUESTIONS, ids=" ".join)
def test_a_pipe_gets_a_line_per_record_in_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, database: str, question: list[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    assert main([*question, "--database", database]) == 0
    told = capsys.readouterr()
    _title, head, _rule, *rows = filter(None, map(str.strip, told.out.splitlines()))
    assert ("\x1b" in told.out, told.err) == (False, "")
    assert main([*question, "--json", "--database", database]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fields = [re.split(r" {2,}", row) for row in rows]
    assert [len(row) for row in fields] == [len(re.split(r" {2,}", head))] * len(records)
    if "vehicle" in head:
        place = re.split(r" {2,}", head).index("vehicle")
        assert [row[place] for row in fields] == [record["vehicle"] for record in records]


@pytest.mark.parametrize(
    "words", [*(["trend", "{}", "2"], ["fill", "{}", "oil"], ["alarms", "--acknowledge", "{}"])], ids=" ".join
)
@pytest.mark.parametrize(("name", "hint"), [("taxi1", "did you mean taxi-1, taxi-2?"), ("zzz", "fleet-backend seen")])
def test_an_unknown_vehicle_is_an_error(
    database: str, capsys: pytest.CaptureFixture[str], words: list[str], name: str, hint: str
) -> None:
    assert main([*(word.format(name) for word in words), "--database", database]) == 5
    captured = capsys.readouterr()
    assert re.fullmatch(rf"fleet-backend: error: no vehicle {name} is known; .*\n", captured.err)
    assert hint in captured.err
    assert captured.out == ""


ALL = [
    ["table"],
    ["fill", "taxi-1", "oil"],
    ["ingest", "--broker", "mqtt://127.0.0.1"],
]  # reads, writes, prepares itself


@pytest.mark.parametrize("words", ALL, ids=" ".join)
@pytest.mark.parametrize("damage", [b"TABLE \xe8\xe8", b"TABLE ( ("])
def test_a_damaged_database_is_told_with_what_to_do(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: list[str], damage: bytes
) -> None:
    path = tmp_path / "fleet.sqlite"
    assert main(["migrate", "--database", f"sqlite:///{path}"]) == 0
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
    path.write_bytes(re.sub(rb"TABLE \w\w\w", lambda name: damage.ljust(len(name[0])), path.read_bytes()))
    capsys.readouterr()
    assert main([*words, "--database", f"sqlite:///{path}"]) == 4
    assert re.fullmatch(
        rf"fleet-backend: error: database sqlite:///{path}: .*damaged.* put a backup in its place\n",
        capsys.readouterr().err,
    )


def test_migrate_makes_a_database_that_others_cannot_read(tmp_path: Path) -> None:
    path = tmp_path / "new" / "fleet.sqlite"
    assert main(["migrate", "--database", f"sqlite:///{path}"]) == 0
    assert main(["table", "--database", f"sqlite:///{path}"]) == 0
    assert {file.name: oct(file.stat().st_mode & 0o777) for file in path.parent.iterdir()} == {path.name: "0o600"}
