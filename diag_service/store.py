"""The result store: an SQLite file that holds every result, the running state and what a broker has not seen yet.

A result and the state after it are one transaction, on disk before anyone is told. A key that is already there is
left alone, so nothing is counted twice. One service at a time owns a store: an advisory lock beside it says so.
"""

import fcntl
import json
import os
import sqlite3
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from diag_service.errors import ResultError, StoreError
from diag_service.records import ShiftResult
from diag_service.results import JsonObject, StoredResult, dump, parse_shift, shift_record

SCHEMA_VERSION = 1
APPLICATION_ID = 0x434C4449  # "CLDI", in the header of every store
_BUSY_TIMEOUT_S = 5.0  # for a person who reads the store with another program

_CREATE = f"""
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
  published INTEGER NOT NULL DEFAULT 0,
  UNIQUE (vehicle, stream, seq, algorithm_version, calibration_version)
);
CREATE INDEX unpublished ON result (vehicle, position) WHERE published = 0;
CREATE INDEX latest ON result (vehicle, clutch, position);
CREATE TABLE state (
  vehicle TEXT PRIMARY KEY,
  belief TEXT NOT NULL,
  condition TEXT NOT NULL,
  algorithm_version TEXT NOT NULL,
  calibration_version TEXT NOT NULL
);
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Versions:
    """What makes two results comparable and a state reusable."""

    algorithm: str
    calibration: str


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """Running state of one vehicle: friction belief and verdict memory, as their own modules wrote them."""

    belief: JsonObject
    condition: JsonObject
    versions: Versions


class ResultStore:
    """One open store. Methods may be called from any thread; each is one transaction."""

    def __init__(self, connection: sqlite3.Connection, lock_descriptor: int | None, where: str) -> None:
        self._connection = connection
        self._lock_descriptor = lock_descriptor
        self._guard = threading.Lock()
        self.where = where
        with self._transaction():
            self.stream = self._read_stream()

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open or create a store and own it until ``close``.

        Raises
        ------
        StoreError
            If it cannot be created, read or written, is not a store, is newer than this program or is in use.
        """
        path = path.absolute()
        descriptor = _own(path)
        try:
            return cls(_connect(path), descriptor, str(path))
        except BaseException:
            os.close(descriptor)
            raise

    @classmethod
    def in_memory(cls) -> Self:
        """Return a store that ends with the process."""
        connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        connection.executescript(_CREATE)
        return cls(connection, None, "memory")

    def close(self) -> None:
        """Close the store and let others have it; closing twice does no harm."""
        with self._guard:
            self._connection.close()
            if self._lock_descriptor is not None:
                os.close(self._lock_descriptor)
                self._lock_descriptor = None

    def next_seq(self) -> int:
        """Return the sequence number that the next result of the live stream gets; none is ever used again."""
        with self._transaction() as sql:
            return self._last_seq(sql) + 1

    def add(self, result: ShiftResult, state: VehicleState) -> bool:
        """Store a result and the state after it, both or neither; False if the key is already there.

        Raises
        ------
        StoreError
            If the disk does not take it; nothing was stored then.
        ResultError
            If the result holds a number that is not finite.
        """
        text, belief, condition = dump(shift_record(result)), dump(state.belief), dump(state.condition)
        with self._transaction() as sql:
            inserted = sql.execute(
                "INSERT OR IGNORE INTO result"
                " (vehicle, stream, seq, algorithm_version, calibration_version, clutch, json)"
                " VALUES (?, ?, ?, ?, ?, ?, ?)",
                (*_key(result), result.estimate.clutch, text),
            )
            if inserted.rowcount == 0:
                return False
            sql.execute(
                "INSERT OR REPLACE INTO state VALUES (?, ?, ?, ?, ?)",
                (result.vehicle, belief, condition, state.versions.algorithm, state.versions.calibration),
            )
            if result.stream == self.stream:
                last_seq = max(self._last_seq(sql), result.seq)
                sql.execute("INSERT OR REPLACE INTO meta VALUES ('last_seq', ?)", (str(last_seq),))
            return True

    def find(self, vehicle: str, stream: str, seq: int, versions: Versions) -> ShiftResult | None:
        """Return the result stored under a key, if any."""
        with self._transaction() as sql:
            row = sql.execute(
                "SELECT json FROM result WHERE vehicle = ? AND stream = ? AND seq = ?"
                " AND algorithm_version = ? AND calibration_version = ?",
                (vehicle, stream, seq, versions.algorithm, versions.calibration),
            ).fetchone()
        return None if row is None else self._parse(row[0])

    def state(self, vehicle: str) -> VehicleState | None:
        """Return the running state of a vehicle, whatever version wrote it."""
        with self._transaction() as sql:
            row = sql.execute(
                "SELECT belief, condition, algorithm_version, calibration_version FROM state WHERE vehicle = ?",
                (vehicle,),
            ).fetchone()
        if row is None:
            return None
        return VehicleState(
            belief=self._object(row[0]),
            condition=self._object(row[1]),
            versions=Versions(algorithm=row[2], calibration=row[3]),
        )

    def unpublished(self, vehicle: str, limit: int) -> list[StoredResult]:
        """Return the oldest results that no broker has acknowledged, in the order they were stored."""
        with self._transaction() as sql:
            rows = sql.execute(
                "SELECT position, json FROM result WHERE vehicle = ? AND published = 0 ORDER BY position LIMIT ?",
                (vehicle, limit),
            ).fetchall()
        return [StoredResult(position=position, result=self._parse(text)) for position, text in rows]

    def unpublished_count(self, vehicle: str) -> int:
        """Return how many results wait for a broker."""
        with self._transaction() as sql:
            row = sql.execute("SELECT count(*) FROM result WHERE vehicle = ? AND published = 0", (vehicle,)).fetchone()
        return int(row[0])

    def mark_published(self, position: int) -> None:
        """Note that a broker acknowledged a result."""
        with self._transaction() as sql:
            sql.execute("UPDATE result SET published = 1 WHERE position = ?", (position,))

    def latest_published(self, vehicle: str) -> list[ShiftResult]:
        """Return the last acknowledged result of each clutch: what subscribers should know by now."""
        with self._transaction() as sql:
            rows = sql.execute(
                "SELECT json FROM result WHERE position IN"
                " (SELECT max(position) FROM result WHERE vehicle = ? AND published = 1 GROUP BY clutch)"
                " ORDER BY clutch",
                (vehicle,),
            ).fetchall()
        return [self._parse(text) for (text,) in rows]

    def results(self, vehicle: str) -> Iterator[ShiftResult]:
        """Yield all results of a vehicle in the order they were stored."""
        with self._transaction() as sql:
            rows = sql.execute("SELECT json FROM result WHERE vehicle = ? ORDER BY position", (vehicle,)).fetchall()
        return (self._parse(text) for (text,) in rows)

    def _read_stream(self) -> str:
        row = self._connection.execute("SELECT value FROM meta WHERE key = 'stream'").fetchone()
        if row is not None:
            return str(row[0])
        stream = str(uuid.uuid4())
        self._connection.execute("INSERT INTO meta VALUES ('stream', ?)", (stream,))
        return stream

    @staticmethod
    def _last_seq(sql: sqlite3.Connection) -> int:
        row = sql.execute("SELECT value FROM meta WHERE key = 'last_seq'").fetchone()
        return 0 if row is None else int(row[0])

    def _parse(self, text: str) -> ShiftResult:
        try:
            return parse_shift(text)
        except ResultError as exc:
            raise StoreError(f"store {self.where} is damaged: {exc}") from exc

    def _object(self, text: str) -> JsonObject:
        try:
            table = json.loads(text)
        except ValueError as exc:
            raise StoreError(f"store {self.where} is damaged: {exc}") from exc
        if not isinstance(table, dict):
            raise StoreError(f"store {self.where} is damaged: a state is not an object")
        return table

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Run one transaction alone; a failure takes all of it back."""
        with self._guard, _translated(self.where):
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise


def _key(result: ShiftResult) -> tuple[str, str, int, str, str]:
    return (result.vehicle, result.stream, result.seq, result.algorithm_version, result.calibration_version)


def _own(path: Path) -> int:
    """Return a descriptor that holds the exclusive lock beside a store."""
    lock_path = path.with_name(path.name + ".lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as exc:
        raise StoreError(f"cannot use store {path}: {exc.strerror} ({exc.filename})") from exc
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
    except BlockingIOError as exc:
        owner = os.pread(descriptor, 32, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        raise StoreError(f"store {path} is in use by another diag-service (process {owner or 'unknown'})") from exc
    except OSError as exc:
        os.close(descriptor)
        raise StoreError(f"cannot lock store {path}: {exc.strerror}") from exc
    return descriptor


def _connect(path: Path) -> sqlite3.Connection:
    with _translated(str(path)):
        connection = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)
    try:
        with _translated(str(path)):
            _prepare(connection, path)
    except BaseException:
        connection.close()
        raise
    return connection


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
        connection.executescript(f"BEGIN IMMEDIATE; {_CREATE} COMMIT;")


@contextmanager
def _translated(where: str) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as exc:
        raise StoreError(f"cannot use store {where}: {exc}") from exc
