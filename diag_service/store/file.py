"""The file of a store: whose it is, who uses it, and that a commit is on the disk."""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from clutchdiag_io.file_lock import lock
from clutchdiag_io.private_file import OPEN_FLAGS, PRIVATE_MODE, create_private
from diag_service.errors import StoreError, StoreFullError
from diag_service.store.schema import APPLICATION_ID, SCHEMA_VERSION, create_tables, migrate

_BUSY_TIMEOUT_S: Final = 5.0  # for a person who reads the store with another program
_NO_ROOM: Final = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_WRITE, sqlite3.SQLITE_IOERR_FSYNC})


def own(path: Path) -> int:
    """Return a descriptor that holds the exclusive lock beside a store."""
    lock_path = path.with_name(path.name + ".lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(lock_path, OPEN_FLAGS, PRIVATE_MODE)
    except OSError as exc:
        raise StoreError(f"cannot use store {path}: {exc.strerror} ({exc.filename})") from exc
    try:
        lock(descriptor)
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
    except BlockingIOError as exc:
        os.lseek(descriptor, 0, os.SEEK_SET)
        owner = os.read(descriptor, 32).decode("ascii", "replace").strip()
        os.close(descriptor)
        raise StoreError(f"store {path} is in use by another diag-service (process {owner or 'unknown'})") from exc
    except OSError as exc:
        os.close(descriptor)
        raise StoreError(f"cannot lock store {path}: {exc.strerror}") from exc
    return descriptor


def connect(path: Path) -> sqlite3.Connection:
    """Open or create the database of a store, in its present form."""
    try:
        create_private(path)
    except OSError as exc:
        raise StoreError(f"cannot use store {path}: {exc.strerror}") from exc
    with translated(str(path)):
        connection = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)
    try:
        with translated(str(path)):
            _prepare(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


def connect_in_memory() -> sqlite3.Connection:
    """Return the database of a store that ends with the process."""
    connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    create_tables(connection)
    return connection


@contextmanager
def translated(where: str) -> Iterator[None]:
    """Make SQLite's errors ours."""
    try:
        yield
    except sqlite3.Error as exc:
        kind = StoreFullError if getattr(exc, "sqlite_errorcode", None) in _NO_ROOM else StoreError
        raise kind(f"cannot use store {where}: {exc}") from exc


def _prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Check whose file it is, create the tables of a new one, and make every commit durable."""
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (table_count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if application_id != APPLICATION_ID and (table_count or application_id):
        raise StoreError(f"{path} is an SQLite file of another program, not a result store")
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"store {path} was written by a newer diag-service (schema {version}, this one knows {SCHEMA_VERSION})"
        )
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    if not table_count:
        create_tables(connection)
    elif version < SCHEMA_VERSION:
        migrate(connection, version)


def remove_store(path: Path) -> None:
    """Remove a store, its lock and what SQLite put beside it; what cannot be removed stays."""
    for suffix in ("", "-wal", "-shm", "-journal", ".lock"):
        with suppress(OSError):
            path.with_name(path.name + suffix).unlink()
