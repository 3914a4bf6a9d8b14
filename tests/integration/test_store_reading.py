"""A store is read beside its first service, after a kill, and from wherever SQLite can; else one line says why."""

import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import date, timedelta
from itertools import count
from pathlib import Path

import pytest

from diag_service.store import APPLICATION_ID
from tests.plugins.disk import Mount
from tests.support.histories import fill_store, history
from tests.support.in_process import ended
from tests.support.service import Ended, Service, run_service, service
from tests.support.strangers import WRAPPER, given_away

HISTORY, REPORT, FLUID = "history", "report", "fluid-changed"
MAGIC = b"SQLite format 3\0"
_days = count(1, 2)  # of fills: two of one day are one


def read(command: str, store: Path) -> Ended:
    """Run a command that reads a store."""
    more = {
        HISTORY: (),
        REPORT: ("-o", store.with_suffix(".html"), "--force"),
        FLUID: ("--at", (date(2020, 1, 1) + timedelta(days=next(_days))).isoformat()),
    }
    return ended(command, store, *more[command])


def assert_all_read(store: Path, shift_count: int) -> None:
    records = ended(HISTORY, store, "--json").records
    assert sum(record["record"] == "event" for record in records) >= shift_count
    for command in (REPORT, FLUID):
        found = read(command, store)
        assert (found.status, found.err) == (0, ""), command


def is_only_in_the_log(store: Path) -> bool:
    """Return whether the file of a store does not yet say whose it is: all that was written is in its log."""
    head = store.read_bytes()[:100]
    return head.startswith(MAGIC) and APPLICATION_ID.to_bytes(4, "big") not in head


def copied(store: Path, folder: Path, *suffixes: str) -> Path:
    """Return a copy of a store, with these of the files that SQLite keeps beside it."""
    folder.mkdir()
    for suffix in ("", *suffixes):
        shutil.copy(store.with_name(store.name + suffix), folder)
    return folder / store.name


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstRun:
    """A service on its first store; a copy of the store's file, made before anybody read the store."""

    service: Service
    store: Path
    lone_copy: Path


@pytest.fixture(name="first_run", scope="module")
def _first_run(tmp_path_factory: pytest.TempPathFactory, cycle_log: Path) -> Iterator[FirstRun]:
    """Run a service on a store that was not there before, until it has told of some shifts."""
    folder = tmp_path_factory.mktemp("first")
    store = folder / "car1.sqlite"
    program = (sys.executable, "-m", "tests.support.fast_bus", str(cycle_log), "0")
    arguments = ("run", "--store", store, "--json", "--vehicle", "car1")
    with service(folder / "service", *arguments, program=program) as running:
        running.wait_for(lambda: running.out.count("\n") >= 3)
        yield FirstRun(service=running, store=store, lone_copy=copied(store, folder / "lone"))


def test_it_is_read_beside_its_first_service(first_run: FirstRun) -> None:
    running, store = first_run.service, first_run.store
    assert is_only_in_the_log(store)
    assert_all_read(store, 3)
    assert running.process.poll() is None


def test_it_is_read_after_its_first_service_was_killed(first_run: FirstRun, tmp_path: Path) -> None:
    running, store = first_run.service, first_run.store
    running.send(signal.SIGKILL)
    assert running.wait().status == -signal.SIGKILL
    for command in (HISTORY, REPORT, FLUID):
        left = copied(store, tmp_path / command, "-wal", "-shm")
        assert is_only_in_the_log(left)
        found = read(command, left)
        assert (found.status, found.err) == (0, ""), command
    assert_all_read(store, 3)


def is_refused(found: Ended, status: int, *words: str) -> None:
    found.assert_one_line(status, words[0])
    assert [word for word in words if word not in found.err] == []
    assert found.out == ""


def as_stranger(command: str, store: Path, output: Path) -> Ended:
    """Run a command as a user to whom files of others are closed."""
    more: tuple[str | Path, ...] = ("-o", output / "page.html") if command == REPORT else ()
    return run_service(output, command, store, *more, wrapper=WRAPPER)


@pytest.mark.parametrize("command", [HISTORY, REPORT, FLUID])
def test_a_copy_without_its_log_is_named(command: str, first_run: FirstRun, tmp_path: Path) -> None:
    store = copied(first_run.lone_copy, tmp_path / "copy")
    is_refused(read(command, store), 4, f"store {store} is empty", "car1.sqlite-wal", "copy both")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"(1.000000) can0 123#00\n", ("is not a result store", "file is not a database")),
        (b"", ("is empty",)),
        (MAGIC + bytes(200), ("is not a result store", "put a copy in its place")),
    ],
)
def test_what_is_no_store_is_named(content: bytes, words: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "car1.sqlite"
    path.write_bytes(content)
    for command in (HISTORY, FLUID):
        is_refused(read(command, path), 4, *words)
    assert path.read_bytes() == content


def test_a_database_of_another_program_is_named(tmp_path: Path) -> None:
    path = tmp_path / "car1.sqlite"
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE messages (ts REAL)")
    for command in (HISTORY, FLUID):
        is_refused(read(command, path), 4, "is an SQLite file of another program")
    is_refused(read(REPORT, path), 3, "an SQLite database")


@pytest.fixture(name="store")
def _store(tmp_path: Path) -> Path:
    """Return a store in a folder of its own."""
    path = tmp_path / "kept" / "car1.sqlite"
    path.parent.mkdir()
    fill_store(path, history(3))
    return path


@pytest.fixture(name="open_store")
def _open_store(store: Path, tmp_path: Path) -> Path:
    """Return a copy of a store that somebody has open: its last results are in its log."""
    with closing(sqlite3.connect(store)) as reader:
        reader.execute("SELECT count(*) FROM result").fetchone()
        fill_store(store, history(5, stream="stream-2"))
        return copied(store, tmp_path / "held", "-wal", "-shm")


@pytest.mark.parametrize(("command", "status"), [(HISTORY, 4), (REPORT, 3), (FLUID, 4)])
def test_a_store_of_another_user_is_named(command: str, status: int, store: Path, tmp_path: Path) -> None:
    with given_away(store, 0o600):
        is_refused(as_stranger(command, store, tmp_path / "out"), status, "Permission denied", "car1.sqlite")


@pytest.mark.parametrize(("command", "status"), [(HISTORY, 4), (REPORT, 3), (FLUID, 4)])
def test_a_folder_of_another_user_is_named(command: str, status: int, store: Path, tmp_path: Path) -> None:
    with given_away(store.parent, 0o700):
        is_refused(as_stranger(command, store, tmp_path / "out"), status, "Permission denied", "car1.sqlite")


@pytest.mark.parametrize("command", [HISTORY, REPORT, FLUID])
def test_a_log_of_another_user_is_named(command: str, open_store: Path, tmp_path: Path) -> None:
    with given_away(open_store.with_name("car1.sqlite-wal"), 0o600):
        is_refused(as_stranger(command, open_store, tmp_path / "out"), 4, "Permission denied", "car1.sqlite-wal")


def read_only(store: Path, mount: Mount, *suffixes: str) -> Path:
    """Return a copy of a store on a medium that cannot be written."""
    disk = mount("size=4m")
    moved = copied(store, disk / "car", *suffixes)
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    return moved


@pytest.mark.parametrize("command", [HISTORY, REPORT, FLUID])
def test_a_log_that_cannot_be_read_in_place_is_never_left_out(
    command: str, open_store: Path, mount: Mount, tmp_path: Path
) -> None:
    store, output = read_only(open_store, mount, "-wal"), tmp_path / "out"
    is_refused(as_stranger(command, store, output), 4, "cannot be written", "car1.sqlite-wal", "copy both")


def test_a_store_is_read_on_a_medium_that_cannot_be_written(
    store: Path, open_store: Path, mount: Mount, tmp_path: Path
) -> None:
    for place, suffixes in ((store, ()), (open_store, ("-wal", "-shm"))):
        medium = read_only(place, mount, *suffixes)
        found = run_service(tmp_path / "out", HISTORY, medium, "--json", wrapper=WRAPPER)
        assert sum(record["record"] == "event" for record in found.records) == 8
        page = as_stranger(REPORT, medium, tmp_path / "pages" / place.parent.name)
        assert (page.status, page.err) == (0, "")
        is_refused(as_stranger(FLUID, medium, tmp_path / "out"), 4, "cannot be written", str(medium))


@pytest.mark.parametrize("command", ["analyze", "run"])
def test_nobody_adds_to_what_he_cannot_write(command: str, store: Path, tmp_path: Path, cycle_log: Path) -> None:
    source = (cycle_log,) if command == "analyze" else ("-i", "virtual", "-c", "empty", "--duration", "0.1")
    for place, mode in ((store, 0o600), (store, 0o444), (store.parent, 0o555)):
        with given_away(place, mode):
            found = run_service(tmp_path / "out", command, *source, "--store", store, wrapper=WRAPPER)
        assert found.status == 4
        *_, last = found.err.splitlines()  # on another machine kernels are compiled first, which is said
        assert last.startswith("diag-service: error: ")
        assert str(store) in last
