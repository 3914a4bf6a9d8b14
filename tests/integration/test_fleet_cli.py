"""The backend's command line: what it shows, what it refuses, its exit status."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from urllib.request import urlopen

import pytest
from sqlalchemy import Engine, select

from clutch_results.records import Condition
from fleet_backend.cli import main
from fleet_backend.database import open_database, transaction
from fleet_backend.office_tables import AUDIT
from fleet_backend.rows import controller_row, quarantine_row
from fleet_backend.writer import Batch, Writer
from tests.golden import CONTROLLER
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import raise_alarms
from tests.support.patience import HANG_S


@pytest.fixture(autouse=True)
def _of_any_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no terminal break the lines: make passes its own width on."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(name="filled")
def _filled(sqlite_url: str) -> Iterator[Engine]:
    """Return a database with a worn and a good vehicle and a message with markup that was kept aside."""
    engine = open_database(sqlite_url)
    rows = [row_of(fleet_result(seq, vehicle="worn", condition=Condition.CHANGE_FLUID)) for seq in (1, 2, 3)]
    rows.append(row_of(fleet_result(1, vehicle="good")))
    old = datetime.now(UTC) - timedelta(days=30)
    Writer(engine).store(
        Batch(
            shifts=rows,
            quarantined=[
                quarantine_row(
                    old,
                    topic="clutchdiag/v1/good/shift",
                    vehicle="good",
                    payload=b"{",
                    reason="identity",
                    detail="[bold]",
                )
            ],
        )
    )
    yield engine
    engine.dispose()


def told(capsys: pytest.CaptureFixture[str], engine: Engine, *words: str) -> str:
    """Return what a command says when all is well."""
    assert main([words[0], "--database", engine.url.render_as_string(hide_password=False), *words[1:]]) == 0
    return capsys.readouterr().out


def told_json(capsys: pytest.CaptureFixture[str], engine: Engine, *words: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in told(capsys, engine, *words, "--json").splitlines()]


def test_the_table_begins_with_the_worst(capsys: pytest.CaptureFixture[str], filled: Engine) -> None:
    text = told(capsys, filled, "table")
    assert text.index("change fluid") < text.index("good ")
    assert "0.136 ±0.002" in text
    assert "There is no verdict on the fluid yet. Clutch 1: no event engaged it yet. Clutch 2:" in text
    assert [record["vehicle"] for record in told_json(capsys, filled, "table", "--limit", "1")] == ["worn"]


def test_what_commands_change_is_in_the_audit(
    capsys: pytest.CaptureFixture[str], filled: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOGNAME", "bob")
    raise_alarms(filled)
    told(capsys, filled, "alarms", "--acknowledge", "worn", "--clutch", "2", "--by", "ann", "--note", "on order")
    told(capsys, filled, "alarms", "--acknowledge", "good")
    told(capsys, filled, "alarms", "--acknowledge", "good")  # nothing more to acknowledge
    told(capsys, filled, "fill", "worn", "DCTF-II", "--at", "2025-12-01")
    told(capsys, filled, "quarantine", "--purge-days", "31")  # forgets none
    told(capsys, filled, "quarantine", "--purge-days", "29")
    with transaction(filled) as connection:
        entries = connection.execute(select(AUDIT).order_by(AUDIT.c.at)).all()
    assert {entry.role for entry in entries} == {"command line"}
    assert [(entry.who, entry.action) for entry in entries] == [
        ("ann", "acknowledge alarm"),
        ("bob", "acknowledge quarantine"),
        ("bob", "note fluid fill"),
        ("bob", "purge quarantine"),
    ]
    assert entries[0].subject == "worn/2/verdict/1: on order"
    assert entries[2].subject == "worn: DCTF-II since 2025-12-01T00:00:00+00:00: "


def test_trouble_codes_are_listed(capsys: pytest.CaptureFixture[str], filled: Engine) -> None:
    row = controller_row(CONTROLLER.record)
    Writer(filled).store(Batch(controllers=[{**row, "vehicle": "worn"}]))
    shown = told(capsys, filled, "codes")
    assert "Trouble codes: 1 of 1 vehicles" in shown
    assert "worn" in shown
    assert "P0897" in shown
    (code,) = told_json(capsys, filled, "codes")
    assert (code["code"], code["read_at"]) == ("P0897", "2026-01-01T00:00:06+00:00")
    assert isinstance(code["snapshots"], list)


def test_the_page_says_where_it_is_and_ends_in_order(filled: Engine) -> None:
    command = [sys.executable, "-m", "fleet_backend", "serve", "--database", str(filled.url), "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = process.stdout.readline()
        address, *_, place, _, _, _ = said.split()
        with urlopen(address, timeout=HANG_S) as answer:  # noqa: S310 - our own
            assert b"worn" in answer.read()
        process.send_signal(signal.SIGTERM)
        _, complaints = process.communicate(timeout=HANG_S)
    assert (process.returncode, "Traceback" in complaints) == (0, False)
    assert "2 vehicles of sqlite:///" in said
    assert place.startswith("sqlite:///")


def test_a_fill_closes_the_order_in_the_table_and_is_taken_back(
    capsys: pytest.CaptureFixture[str], filled: Engine
) -> None:
    before = told_json(capsys, filled, "table")
    assert {row["action"] for row in before if row["vehicle"] == "worn"} == {"change_now"}
    told(capsys, filled, "fill", "worn", "DCTF-II", "--at", "2026-03-01", "--odometer-km", "1")
    closed = [row for row in told_json(capsys, filled, "table") if row["vehicle"] == "worn"]
    assert {(row["condition"], row["action"], row["mu_c"]) for row in closed} == {("no_verdict", "new_fluid", None)}
    assert "New fluid since 2026-03-01 00:00 UTC: nothing is known of it yet." in told(capsys, filled, "table")
    told(capsys, filled, "fill", "worn", "--undo")
    assert told_json(capsys, filled, "table") == before
    told(capsys, filled, "fill", "worn", "DCTF-II", "--at", "2026-03-01", "--odometer-km", "1")  # a microsecond later
    told(capsys, filled, "fill", "worn", "--undo", "--at", "2026-03-01")
    assert told_json(capsys, filled, "table") == before
