"""Results are for their owner's eyes: modes of the files that hold them, and warnings where they travel in the open."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from diag_service.cli import main
from diag_service.store import ResultStore
from tests.support.builders import shift_result
from tests.support.outboxes import STATE

CANDUMP = "(1767225600.000000) vcan0 123#0011223344556677\n" * 4


@pytest.fixture(autouse=True)
def _usual_mask() -> Iterator[None]:
    """Let new files be readable by all, as they usually are."""
    before = os.umask(0o022)
    yield
    os.umask(before)


def modes(folder: Path) -> set[int]:
    return {path.stat().st_mode & 0o777 for path in folder.iterdir()}


def test_a_store_and_what_lies_beside_it_is_private(tmp_path: Path) -> None:
    with closing(ResultStore.open(tmp_path / "car.sqlite")) as store:
        store.add(shift_result(1), STATE)
        names = {path.name for path in tmp_path.iterdir()}
        assert names >= {"car.sqlite", "car.sqlite-wal", "car.sqlite-shm", "car.sqlite.lock"}
        assert modes(tmp_path) == {0o600}
    assert modes(tmp_path) == {0o600}


def test_a_store_that_others_could_read_is_closed_to_them(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "car.sqlite"
    ResultStore.open(path).close()
    path.chmod(0o664)
    with closing(sqlite3.connect(path)) as reader:
        reader.execute("SELECT * FROM result").fetchall()  # keeps what SQLite puts beside it, open as the store is
        with closing(ResultStore.open(path)):
            assert {file.stat().st_mode & 0o777 for file in tmp_path.glob("car.sqlite*")} == {0o600}
    told = [record.getMessage() for record in caplog.records]
    assert f"{path} could be read by other users (mode 664) and is closed to them now" in told
    caplog.clear()
    ResultStore.open(path).close()
    assert caplog.records == []


def test_the_journal_of_a_folder_run_is_private_and_its_output_is_not(tmp_path: Path) -> None:
    folder, output = tmp_path / "logs", tmp_path / "all.jsonl"
    folder.mkdir()
    (folder / "a.log").write_text(CANDUMP, encoding="utf-8")
    assert main(["analyze", str(folder), "-o", str(output), "--jobs", "1"]) == 0
    assert (output.stat().st_mode & 0o777, (tmp_path / "all.jsonl.journal").stat().st_mode & 0o777) == (0o644, 0o600)


@pytest.mark.parametrize(("url", "count"), [("mqtt://broker.invalid", 1), ("mqtt://127.0.0.1:9", 0), ("mqtts://b", 0)])
def test_a_broker_on_another_machine_without_encryption_is_warned_of_once(
    capsys: pytest.CaptureFixture[str], url: str, count: int
) -> None:
    assert main(["config", "check", "--broker", url]) == 0
    assert capsys.readouterr().err.count("unencrypted") == count
