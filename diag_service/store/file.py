"""The file of a store: tables, migrations, ownership, lock and durable commits."""

import errno
import logging
import os
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from clutch_results.records import ShiftResult, parse_shift
from clutchdiag_io.files import OPEN_FLAGS, PRIVATE_MODE, check_plain_file, create_private, lock
from diag_service.errors import StoreError, StoreFullError
from fleet_contract.errors import ResultError

APPLICATION_ID: Final = 0x434C4449  # "CLDI", in the header of every store
SCHEMA_VERSION: Final = 6
EMPTY: Final = 0  # the version of a database in which nothing is yet

WAITING, DELIVERED, QUARANTINED = range(3)  # values of result.published

_CONTROLLER: Final = """
CREATE TABLE controller (
  position INTEGER PRIMARY KEY AUTOINCREMENT,
  vehicle TEXT NOT NULL,
  controller TEXT NOT NULL,
  said TEXT NOT NULL,
  json TEXT NOT NULL
);
"""
_CREATE_FILL: Final = """
CREATE TABLE fill (
  vehicle TEXT NOT NULL,
  filled_at TEXT NOT NULL,
  odometer_m REAL,
  product TEXT,
  note TEXT,
  PRIMARY KEY (vehicle, filled_at)
);
"""
# What goes for the disk budget, oldest first within each class: what someone else has, what has no estimate, the rest.
GIVEN_UP: Final = {
    "delivered": f"published != {WAITING}",
    "empty": f"published = {WAITING} AND CASE WHEN json_valid(json) THEN json_extract(json, '$.status') != 'valid' END",
    "undelivered": f"published = {WAITING}",
}
_FOUND_BY: Final = "".join(  # the last in the order of the table; else all of a store is read for the few that go
    f"CREATE INDEX IF NOT EXISTS {name} ON result (position) WHERE {GIVEN_UP[name]};" for name in ("delivered", "empty")
)
_WITHDRAWN: Final = "ALTER TABLE fill ADD COLUMN is_withdrawn INTEGER NOT NULL DEFAULT 0;"
_CREATE: Final = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE result (
  position INTEGER PRIMARY KEY AUTOINCREMENT,
  vehicle TEXT NOT NULL,
  stream TEXT NOT NULL,
  seq INTEGER NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL,
  clutch INTEGER NOT NULL,
  json TEXT NOT NULL,
  published INTEGER NOT NULL DEFAULT {WAITING},
  refusal TEXT,
  UNIQUE (vehicle, stream, seq, algorithm_version, calibration_version)
);
CREATE INDEX unpublished ON result (vehicle, position) WHERE published = {WAITING};
CREATE INDEX latest ON result (vehicle, clutch, position);
{_FOUND_BY}
CREATE TABLE state (
  vehicle TEXT PRIMARY KEY,
  belief TEXT NOT NULL,
  condition TEXT NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL
);
{_CONTROLLER}
{_CREATE_FILL}
{_WITHDRAWN}
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
"""

# From the version that is the key to the next; a store goes through all that are behind its own.
_STEPS: Final = {
    1: "ALTER TABLE result ADD COLUMN refusal TEXT; PRAGMA user_version = 2;",  # why a backend cannot use a result
    2: f"{_CONTROLLER} PRAGMA user_version = 3;",  # what a controller says of its trouble codes
    3: f"{_CREATE_FILL} PRAGMA user_version = 4;",  # which fluid since when
    4: f"{_WITHDRAWN} PRAGMA user_version = 5;",  # which fills were noted by mistake
    5: f"{_FOUND_BY} PRAGMA user_version = 6;",  # what goes for the disk budget
}


def create_tables(connection: sqlite3.Connection) -> None:
    """Make an empty database a store, in one transaction."""
    connection.executescript(f"BEGIN IMMEDIATE; {_CREATE} COMMIT;")


def migrate(connection: sqlite3.Connection, version: int) -> None:
    """Bring a store to the present form; each step is a transaction, so a power cut between two does no harm."""
    for step in range(version, SCHEMA_VERSION):
        connection.executescript(f"BEGIN IMMEDIATE; {_STEPS[step]} COMMIT;")


_BUSY_TIMEOUT_S: Final = 5.0  # for a person who reads the store with another program
_NO_ROOM: Final = frozenset({
    *(sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE, sqlite3.SQLITE_IOERR_FSYNC, sqlite3.SQLITE_IOERR_SHMSIZE)
})  # fmt: skip
_PRIMARY: Final = 0xFF  # of a result code of SQLite
_NO_CODE: Final = 0  # of an error that Python found
_DAMAGED: Final = "store {where} is damaged: {exc}; put a copy in its place, or move it away to begin a new one"
_CLOSED: Final = "store {where} cannot be written: this user may not write it, or nobody may in its folder"
_UNUSABLE: Final = "cannot use store {where}: {exc}"
_SENTENCES: Final = {
    sqlite3.SQLITE_CORRUPT: _DAMAGED,
    sqlite3.SQLITE_NOTADB: "{where} is not a result store: {exc}; if it was one, put a copy in its place",
    sqlite3.SQLITE_CANTOPEN: _CLOSED,
    sqlite3.SQLITE_READONLY: _CLOSED,
}
STORE_FAILURES: Final = (sqlite3.Error, ValueError, TypeError, ArithmeticError)
_MARK_AT, _LONGEST_LOCK = 32, 256  # in a lock [bytes]: behind the process stands the mark
_LOG = logging.getLogger(__name__)


def own(path: Path) -> tuple[int, str | None]:
    """Lock a store; return the descriptor of the lock file and the mark in it, None if an earlier program wrote it."""
    lock_path = path.with_name(path.name + ".lock")
    try:
        if path.exists() and not path.is_file():  # it can never become a store: no lock is left beside it
            _check_place(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(lock_path, OPEN_FLAGS, PRIVATE_MODE)
    except OSError as exc:
        raise StoreError(f"cannot use store {path}: {exc.strerror} ({exc.filename})") from exc
    try:
        lock(descriptor)
        text = os.read(descriptor, _LONGEST_LOCK)
        _sign(descriptor)
    except BlockingIOError as exc:
        os.lseek(descriptor, 0, os.SEEK_SET)
        owner = os.read(descriptor, _MARK_AT).decode("ascii", "replace").strip()
        os.close(descriptor)
        raise StoreError(f"store {path} is in use by another diag-service (process {owner or 'unknown'})") from exc
    except OSError as exc:
        os.close(descriptor)
        raise StoreError(f"cannot lock store {path}: {exc.strerror}") from exc
    return descriptor, None if 0 < len(text) < _MARK_AT else text[_MARK_AT:].decode("ascii", "replace")


def _sign(descriptor: int) -> None:
    """Write the process id into a lock file, unless the disk is full."""
    try:
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, f"{os.getpid():<{_MARK_AT - 1}}\n".encode())
    except OSError as exc:
        if exc.errno != errno.ENOSPC:
            raise


def note_mark(descriptor: int, stream: str, seq: int) -> None:
    """Write the stream and its last sequence number into a lock file; errors of the disk are ignored."""
    with suppress(OSError):
        os.lseek(descriptor, _MARK_AT, os.SEEK_SET)
        os.write(descriptor, f"{_mark_of(descriptor, stream)} {seq:020}\n".encode())


def is_put_back(descriptor: int, mark: str, stream: str, seq: int) -> bool:
    """Return whether the mark shows a copied or restored store: its next sequence numbers may have been used."""
    head, _, furthest = mark.strip().rpartition(" ")
    return head != _mark_of(descriptor, stream) or not furthest.isdecimal() or int(furthest) > seq


def _mark_of(descriptor: int, stream: str) -> str:
    return f"{stream} {os.fstat(descriptor).st_ino}"  # whoever copies a lock makes another file


def _check_place(path: Path) -> None:
    """Make the file of a store unless it is there; raises StoreError if something else has its place."""
    try:
        create_private(path)
        with suppress(FileNotFoundError):  # a link to what SQLite will make
            check_plain_file(path, most_bytes=sys.maxsize)
    except OSError as exc:
        raise StoreError(f"cannot use store {path}: {exc.strerror}") from exc


def connect(path: Path) -> sqlite3.Connection:
    """Open or create the database of a store, in its present form, on a full disk as well if it is there already."""
    is_new = not path.exists()
    _check_place(path)
    try:
        return _opened(path)
    except StoreFullError:
        if is_new:
            raise
        # Without others SQLite keeps in memory what they would share, so that it needs no room to begin.
        connection = _opened(path, "PRAGMA locking_mode = EXCLUSIVE")
        _LOG.warning("the disk of store %s is full; until the next start no other program can read it", path)
        return connection


def _opened(path: Path, *pragmas: str) -> sqlite3.Connection:
    with translated(str(path)):
        connection = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)
    try:
        with translated(str(path)):
            for pragma in pragmas:
                connection.execute(pragma)
            _prepare(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


@contextmanager
def translated(where: str) -> Iterator[None]:
    """Raise StoreError in place of SQLite's errors, and of errors over damaged content."""
    try:
        yield
    except STORE_FAILURES as exc:
        raise store_error(where, exc) from exc


def store_error(where: str, exc: Exception) -> StoreError:
    """Return the StoreError for an error of SQLite, or for one over damaged content."""
    sentence = _SENTENCES.get(primary_code(exc), _UNUSABLE) if isinstance(exc, sqlite3.Error) else _DAMAGED
    kind = StoreFullError if getattr(exc, "sqlite_errorcode", _NO_CODE) in _NO_ROOM else StoreError
    return kind(sentence.format(where=where, exc=exc))


def primary_code(exc: sqlite3.Error) -> int:
    """Return what kind of error of SQLite it is; 0 if SQLite itself has not seen it."""
    return getattr(exc, "sqlite_errorcode", _NO_CODE) & _PRIMARY


def _prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Check whose file it is, create the tables of a new one, and make every commit durable."""
    form = form_of(connection, path)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    if form == EMPTY:
        create_tables(connection)
    elif form < SCHEMA_VERSION:
        migrate(connection, form)


def is_of_another_program(connection: sqlite3.Connection) -> bool:
    """Return whether a database is no store and not empty."""
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (table_count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return application_id != APPLICATION_ID and bool(application_id or version or table_count)


def form_of(connection: sqlite3.Connection, path: Path) -> int:
    """Return the schema version of a store, or EMPTY of a database that is to become one.

    Raises StoreError for a database of another program, and for a store of a form that a later program made.
    """
    if is_of_another_program(connection):
        raise StoreError(f"{path} is an SQLite file of another program, not a result store")
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"store {path} was written by a newer diag-service (schema {version}, this one knows {SCHEMA_VERSION})"
        )
    return version


def parsed(text: str, where: str) -> ShiftResult:
    """Return a result that a store holds; raises StoreError if it is none."""
    try:
        return parse_shift(text)
    except ResultError as exc:
        raise store_error(where, exc) from exc


def remove_store(path: Path) -> None:
    """Remove a store, its lock and what SQLite put beside it; what cannot be removed stays."""
    for suffix in ("", "-wal", "-shm", "-journal", ".lock"):
        with suppress(OSError):
            path.with_name(path.name + suffix).unlink()
