"""What disks, other programs and other versions do to a store: one clear line each, and nothing stored is lost."""

import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from diag_service.errors import StoreError
from diag_service.store import SCHEMA_VERSION, ResultStore, VehicleState, Versions
from tests.support.builders import shift_result

STATE = VehicleState(filter_state={"mark": 1}, condition={}, versions=Versions(algorithm="a", calibration="c"))


@pytest.fixture(name="path")
def _path(tmp_path: Path) -> Path:
    return tmp_path / "results" / "car1.sqlite"


@pytest.fixture(name="connections")
def _connections(monkeypatch: pytest.MonkeyPatch) -> list[sqlite3.Connection]:
    """Return the database connections that the test opens: some settings are known to a connection only."""
    opened: list[sqlite3.Connection] = []

    class Noted(sqlite3.Connection):
        def __init__(self, database: str | Path, **settings: Any) -> None:  # noqa: ANN401 - signature of sqlite3
            super().__init__(database, **settings)
            opened.append(self)

    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", partial(connect, factory=Noted))
    return opened


def fill(path: Path, count: int) -> str:
    with closing(ResultStore.open(path)) as store:
        for seq in range(1, count + 1):
            store.add(shift_result(seq, stream=store.stream), STATE)
        return store.stream


def edit(path: Path, sql: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(sql)


def test_a_store_is_made_with_its_folder_and_read_again(path: Path) -> None:
    stream = fill(path, 3)
    with closing(ResultStore.open(path)) as store:
        assert store.stream == stream
        assert list(store.results("car1")) == [shift_result(seq, stream=stream) for seq in (1, 2, 3)]
        assert store.state("car1") == STATE
        assert store.next_seq() == 4


@pytest.mark.parametrize("lock", ["of the lost store", "of the backup", "none"])
def test_a_store_that_was_put_back_uses_no_number_again(
    path: Path, lock: str, caplog: pytest.LogCaptureFixture
) -> None:
    stream, backup = fill(path, 3), path.parent / "backup"
    backup.mkdir()
    for name in (path.name, f"{path.name}.lock"):
        shutil.copyfile(path.parent / name, backup / name)
    fill(path, 5)  # the fleet has these; then the disk is lost, but for the lock perhaps
    path.unlink()
    shutil.move(backup / path.name, path)
    if lock != "of the lost store":
        path.with_name(f"{path.name}.lock").unlink()
    if lock == "of the backup":
        shutil.move(backup / f"{path.name}.lock", path.parent)
    with closing(ResultStore.open(path)) as store:
        assert (store.stream != stream, store.next_seq()) == (True, 1)
    assert "is a copy or was put back: its next results begin a new stream" in caplog.text
    caplog.clear()
    fill(path, 2)
    with closing(ResultStore.open(path)) as again:
        assert (again.stream, again.next_seq(), len(list(again.results("car1")))) == (store.stream, 3, 5)
    assert not caplog.text


def test_every_commit_is_durable(path: Path, connections: list[sqlite3.Connection]) -> None:
    with closing(ResultStore.open(path)):
        settings = [connections[0].execute(f"PRAGMA {name}").fetchone() for name in ("journal_mode", "synchronous")]
    assert settings == [("wal",), (2,)]  # 2: FULL


def test_two_services_do_not_share_a_store(path: Path) -> None:
    with closing(ResultStore.open(path)):
        with pytest.raises(StoreError, match=rf"in use by another diag-service \(process {os.getpid()}\)"):
            ResultStore.open(path)
        with pytest.raises(StoreError, match="in use"):  # by another name too
            ResultStore.open(path.parent / "." / path.name)
    ResultStore.open(path).close()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.mkdir(), "Is a directory"),
        (os.mkfifo, "it is a pipe"),
        (lambda path: path.write_bytes(b"x" * 5000), "file is not a database"),
        (lambda path: edit(path, "CREATE TABLE guests (name)"), "of another program"),
        (lambda path: edit(path, "PRAGMA application_id = 7"), "of another program"),
    ],
)
def test_what_is_no_store(path: Path, spoil: Callable[[Path], object], message: str) -> None:
    path.parent.mkdir()
    spoil(path)
    before = sorted(path.parent.iterdir())
    with pytest.raises(StoreError, match=message):
        ResultStore.open(path)
    if not path.is_file():  # it can never become a store: nothing is left beside it
        assert sorted(path.parent.iterdir()) == before


def test_a_store_of_a_newer_version_is_left_alone(path: Path) -> None:
    fill(path, 1)
    edit(path, f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    before = path.read_bytes()
    with pytest.raises(StoreError, match="written by a newer diag-service"):
        ResultStore.open(path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("sql", "read"),
    [
        ("UPDATE result SET json = '{'", lambda store: list(store.results("car1"))),
        ("UPDATE state SET belief = '[]'", lambda store: store.state("car1")),
        ("UPDATE state SET condition = 'x'", lambda store: store.state("car1")),
    ],
)
def test_damaged_values_are_told(path: Path, sql: str, read: Callable[[ResultStore], object]) -> None:
    fill(path, 1)
    edit(path, sql)
    with closing(ResultStore.open(path)) as store, pytest.raises(StoreError, match="damaged"):
        read(store)


def test_a_full_database_refuses_whole_results_and_keeps_the_others(
    path: Path, connections: list[sqlite3.Connection]
) -> None:
    stored = 0

    def fill_up(store: ResultStore) -> None:
        nonlocal stored
        for seq in range(1, 1000):
            store.add(shift_result(seq), replace(STATE, filter_state={"seq": seq}))
            stored = seq

    with closing(ResultStore.open(path)) as store:
        connections[0].execute("PRAGMA max_page_count = 12")
        with pytest.raises(StoreError, match="full"):
            fill_up(store)
        assert stored > 0
        assert [result.seq for result in store.results("car1")] == list(range(1, stored + 1))
        state = store.state("car1")
        assert state is not None
        assert state.filter_state == {"seq": stored}
