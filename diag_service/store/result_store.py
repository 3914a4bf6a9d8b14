"""One open store: results, running state, and what waits to be delivered.

A result and the state after it are one transaction, on disk before anyone is told. A key that is already there is
left alone, so nothing is counted twice. One service at a time owns a store: an advisory lock beside it says so.
"""

import json
import logging
import os
import sqlite3
import threading
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Final, Self

from clutch_results.records import FluidFill, ShiftResult, StoredResult, dump, shift_record
from clutchdiag_io.files import keep_private
from diag_service.errors import StoreError, StoreFullError
from diag_service.store import file
from diag_service.store.reading import add_fills, all_fills, latest_fill, read_fills
from fleet_contract import JsonObject, Outcome, Receipt, ResultKey

_ROWS_AT_ONCE: Final = 16
_LOG = logging.getLogger(__name__)


MOST_REPORT_BYTES: Final = 16 * 2**20  # of them all, unless the store has a budget
_REPORTS_SHARE: Final = 8  # of a budget, one part of so many
# In the order of the columns; a record may have more fields.
_KEY_VALUES: Final = attrgetter("vehicle", "stream", "seq", "algorithm_version", "calibration_version")
_VERSION_VALUES: Final = attrgetter("algorithm", "calibration")
_BY_KEY: Final = (
    " FROM result WHERE vehicle = ? AND stream = ? AND seq = ? AND algorithm_version = ? AND calibration_version = ?"
)
_ROWS: Final = (
    "SELECT position, vehicle, stream, seq, algorithm_version, calibration_version, clutch,"
    " json_extract(json, '$.produced_at'), json FROM result"
)
_KEEP: Final = "INSERT OR REPLACE INTO meta VALUES (?, ?)"
# The last of each stream, which an index finds.
_ENDS: Final = (
    " WHERE position IN (SELECT (SELECT position FROM result WHERE vehicle = ?1 AND stream = own.stream"
    " AND clutch = own.clutch AND algorithm_version = ?2 AND calibration_version = ?3 ORDER BY seq DESC LIMIT 1) FROM"
    " (SELECT stream, clutch FROM (SELECT DISTINCT stream FROM result WHERE vehicle = ?1),"
    " (SELECT DISTINCT clutch FROM result WHERE vehicle = ?1)) AS own)"
    " ORDER BY position"
)
_OUTCOMES: Final = {Outcome.ACCEPTED: file.DELIVERED, Outcome.QUARANTINED: file.QUARANTINED}
_END: Final = 2**63 - 1  # beyond the last position and sequence number: SQLite counts no further


@dataclass(frozen=True, slots=True, kw_only=True)
class Versions:
    """What makes two results comparable and a state reusable."""

    algorithm: str
    calibration: str


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """Running state of one vehicle: of its friction filter and its verdicts, as their own modules wrote them."""

    filter_state: JsonObject
    condition: JsonObject
    versions: Versions


class ResultStore:
    """One open store. Methods may be called from any thread; each is one transaction."""

    def __init__(
        self,
        connection: sqlite3.Connection,
        lock_descriptor: int | None,
        where: str,
        budget_bytes: int | None = None,
        *,
        keeps_state: bool = True,
        mark: str | None = None,  # what the lock said of the stream
    ) -> None:
        self.keeps_state = keeps_state
        self._connection = connection
        self._lock_descriptor = lock_descriptor
        self._budget_bytes = budget_bytes
        self._guard = threading.Lock()
        self.where = where
        with self._transaction() as sql:
            self.stream = str(_value(sql, "stream", str(uuid.uuid4())))
            last_seq = _value(sql, "last_seq")
            self._last_seq = int(last_seq or 0)  # of the live stream, which its owner alone writes
        if lock_descriptor is not None:
            is_used_up = self._last_seq >= _END
            if is_used_up or (
                mark is not None
                and (last_seq or mark)
                and file.is_put_back(lock_descriptor, mark, self.stream, self._last_seq)
            ):
                why = "has used up its numbers" if is_used_up else "is a copy or was put back"
                _LOG.warning("store %s %s: its next results begin a new stream", where, why)
                self.stream, self._last_seq = str(uuid.uuid4()), 0
                with suppress(StoreFullError), self._transaction() as sql:
                    sql.executemany(_KEEP, (("stream", self.stream), ("last_seq", "0")))
            file.note_mark(lock_descriptor, self.stream, self._last_seq)

    @classmethod
    def open(cls, path: Path | None, budget_bytes: int | None = None) -> Self:
        """Open or create a store and own it until ``close``; None: one in memory.

        It may grow to ``budget_bytes``, None: without limit; what is dropped then is counted. Raises StoreError if it
        cannot be created, read or written, is not a store, is newer than this program or is in use.
        """
        if path is None:
            return cls.in_memory()
        path = path.absolute()
        (descriptor, mark), is_new = file.own(path), not path.exists()
        try:
            store = cls(file.connect(path), descriptor, str(path), budget_bytes, mark=None if is_new else mark)
        except BaseException:
            if is_new:  # what a full disk left of it is no store
                for suffix in ("", "-wal", "-shm"):
                    Path(f"{path}{suffix}").unlink(missing_ok=True)
            os.close(descriptor)
            raise
        keep_private(path)
        return store

    @classmethod
    def in_memory(cls, *, keeps_state: bool = False) -> Self:
        """Return a store that ends with the process; nobody takes up a state in it unless a session follows another."""
        connection = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        file.create_tables(connection)
        return cls(connection, None, "memory", keeps_state=keeps_state)

    def close(self) -> None:
        """Close the store and let others have it; closing twice does no harm."""
        with self._guard:
            self._connection.close()
            if self._lock_descriptor is not None:
                os.close(self._lock_descriptor)
                self._lock_descriptor = None

    @property
    def holds_results(self) -> bool:
        """Whether there is any result in it; a store that cannot tell is taken for one that holds some."""
        try:
            with self._transaction() as sql:
                return bool(sql.execute("SELECT EXISTS (SELECT 1 FROM result)").fetchone()[0])
        except StoreError:
            return True

    def next_seq(self) -> int:
        """Return the next sequence number of the live stream; no number is used twice."""
        return self._last_seq + 1

    def add(self, result: ShiftResult, state: VehicleState | None) -> bool:
        """Store a result and the state after it, both or neither; False if the key is already there.

        Without a state the one that is stored stays.

        Raises StoreError if the disk does not take it; nothing was stored then. Raises ResultError if the result holds
        a number that is not finite.
        """
        text = dump(shift_record(result))
        running = None if state is None else (result.vehicle, dump(state.filter_state), dump(state.condition))
        with self._transaction() as sql:
            inserted = sql.execute(
                "INSERT OR IGNORE INTO result"
                " (vehicle, stream, seq, algorithm_version, calibration_version, clutch, json)"
                " VALUES (?, ?, ?, ?, ?, ?, ?)",
                (
                    *(result.vehicle, result.stream, result.seq, result.algorithm_version, result.calibration_version),
                    *(result.estimate.clutch, text),
                ),
            )
            if inserted.rowcount == 0:
                return False
            if running is not None and state is not None:
                made_by = _VERSION_VALUES(state.versions)
                sql.execute("INSERT OR REPLACE INTO state VALUES (?, ?, ?, ?, ?)", (*running, *made_by))
            last_seq = max(self._last_seq, result.seq) if result.stream == self.stream else self._last_seq
            if last_seq != self._last_seq:
                sql.executemany(_KEEP, (("stream", self.stream), ("last_seq", str(last_seq))))
            if self._budget_bytes is not None:
                _enforce_budget(sql, self._budget_bytes, int(inserted.lastrowid or 0))
        if last_seq != self._last_seq and self._lock_descriptor is not None:
            file.note_mark(self._lock_descriptor, self.stream, last_seq)
        self._last_seq = last_seq
        return True

    def find(self, vehicle: str, stream: str, seq: int, versions: Versions) -> ShiftResult | None:
        """Return the result stored under a key, if any."""
        key = (vehicle, stream, seq, versions.algorithm, versions.calibration)
        with self._transaction() as sql:
            row = sql.execute("SELECT json" + _BY_KEY, key).fetchone()
        return None if row is None else file.parsed(row[0], self.where)

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
            filter_state=self._object(row[0]),
            condition=self._object(row[1]),
            versions=Versions(algorithm=row[2], calibration=row[3]),
        )

    def waiting(self, vehicle: str, *, after: int, before: int = _END, limit: int) -> list[StoredResult]:
        """Return undelivered results with ``after < position < before``, the oldest first."""
        where = "vehicle = ? AND published = 0 AND position > ? AND position < ?"  # literal 0: the index knows it
        with self._transaction() as sql:
            chosen = f"{_ROWS} WHERE {where} ORDER BY position LIMIT ?"
            rows = sql.execute(chosen, (vehicle, after, before, limit))
            return [_stored_result(row) for row in rows]

    def stored(self, positions: Iterable[int]) -> list[StoredResult]:
        """Return the results at these positions, delivered or not; those dropped since are left out."""
        with self._transaction() as sql:
            rows = (sql.execute(f"{_ROWS} WHERE position = ?", (position,)).fetchone() for position in positions)
            return [_stored_result(row) for row in rows if row is not None]

    def newest(self, vehicle: str, limit: int) -> list[StoredResult]:
        """Return the newest results of a vehicle, the oldest of them first, delivered or not."""
        with self._transaction() as sql:
            rows = sql.execute(f"{_ROWS} WHERE vehicle = ? ORDER BY position DESC LIMIT ?", (vehicle, limit))
            return [_stored_result(row) for row in rows][::-1]

    def last_position(self, vehicle: str) -> int:
        """Return the position of the newest result; 0 without any."""
        with self._transaction() as sql:
            row = sql.execute("SELECT max(position) FROM result WHERE vehicle = ?", (vehicle,)).fetchone()
        return int(row[0] or 0)

    def unpublished_count(self, vehicle: str) -> int:
        """Return how many results wait to be delivered."""
        with self._transaction() as sql:
            row = sql.execute("SELECT count(*) FROM result WHERE vehicle = ? AND published = 0", (vehicle,)).fetchone()
        return int(row[0])

    def mark_published(self, positions: Iterable[int]) -> None:
        """Note that results need no further delivery."""
        with self._transaction() as sql:
            _mark(sql, [(file.DELIVERED, None, position) for position in positions])

    def note_receipts(self, receipts: Sequence[Receipt]) -> list[int]:
        """Note what a backend acknowledged; return the positions of what is known here, repetitions included."""
        with self._transaction() as sql:
            rows = [
                sql.execute("SELECT position" + _BY_KEY, _KEY_VALUES(receipt.key)).fetchone() for receipt in receipts
            ]
            known = [(int(row[0]), receipt) for row, receipt in zip(rows, receipts, strict=True) if row is not None]
            _mark(sql, [(_OUTCOMES[receipt.outcome], receipt.reason, position) for position, receipt in known])
        return [position for position, _ in known]

    def takes_bundles(self) -> bool:
        """Return whether the backend took several results in one message when it was last heard."""
        with self._transaction() as sql:
            return _value(sql, "takes_bundles") == "1"

    def note_takes_bundles(self, *, is_taken: bool) -> None:
        """Keep whether the backend takes several results in one message."""
        with self._transaction() as sql:
            sql.execute(_KEEP, ("takes_bundles", str(int(is_taken))))

    def connection_secret(self) -> str:
        """Return the random part of our client identifier, which lasts as long as the store."""
        with self._transaction() as sql:
            return str(_value(sql, "connection_secret", uuid.uuid4().hex))

    def ends(self, vehicle: str, versions: Versions | None = None) -> list[StoredResult]:
        """Return the last result of each clutch in each stream, of these versions or those stored last."""
        made_by = "SELECT algorithm_version, calibration_version FROM result WHERE vehicle = ? ORDER BY position DESC"
        with self._transaction() as sql:
            made_by_versions = (
                sql.execute(made_by, (vehicle,)).fetchone() if versions is None else _VERSION_VALUES(versions)
            )
            rows = sql.execute(_ROWS + _ENDS, (vehicle, *(made_by_versions or ("", ""))))
            return list(map(_stored_result, rows))

    def began_after(self, vehicle: str, moment: str) -> bool:
        """Return whether all events of a vehicle ended after a moment; not if none is known or the budget took some."""
        with self._transaction() as sql:
            known = "SELECT 1 FROM result WHERE vehicle = ?"
            earlier = sql.execute(f"{known} AND json_extract(json, '$.end_utc') <= ? LIMIT 1", (vehicle, moment))
            if earlier.fetchone() is not None or any(_read_dropped(sql).values()):
                return False
            return sql.execute(f"{known} LIMIT 1", (vehicle,)).fetchone() is not None

    def note_controller(self, vehicle: str, controller: str, said: str, text: str) -> bool:
        """Keep what a controller said, False if it said the same the last time.

        The oldest go when there are too many; the newest stays. ``said`` is what counts of the report, all but its
        time, and ``text`` is the report, as JSON.
        """
        most_bytes = MOST_REPORT_BYTES if self._budget_bytes is None else self._budget_bytes // _REPORTS_SHARE
        with self._transaction() as sql:
            last = sql.execute(
                "SELECT said FROM controller WHERE vehicle = ? AND controller = ? ORDER BY position DESC LIMIT 1",
                (vehicle, controller),
            ).fetchone()
            if last is not None and last[0] == said:
                return False
            sql.execute(
                "INSERT INTO controller (vehicle, controller, said, json) VALUES (?, ?, ?, ?)",
                (vehicle, controller, said, text),
            )
            sql.execute(
                "DELETE FROM controller WHERE position < (SELECT max(position) FROM controller) AND position IN"
                " (SELECT position FROM (SELECT position, sum(length(json) + length(said))"
                " OVER (ORDER BY position DESC) AS total FROM controller) WHERE total > ?)",
                (most_bytes,),
            )
            return True

    def controller_reports(self, vehicle: str) -> list[str]:
        """Return what controllers said, the oldest first, as JSON."""
        with self._transaction() as sql:
            rows = sql.execute("SELECT json FROM controller WHERE vehicle = ? ORDER BY position", (vehicle,))
            return [str(text) for (text,) in rows]

    def dropped_counts(self) -> dict[str, int]:
        """Return how many results were given up for the disk budget since the store exists, by the classes that go."""
        with self._transaction() as sql:
            return _read_dropped(sql)

    def used_bytes(self) -> int:
        """Return how much of the disk the results take."""
        with self._transaction() as sql:
            return _used_bytes(sql)

    def results(self, vehicle: str) -> Iterator[ShiftResult]:
        """Yield all results of a vehicle in the order they were stored."""
        with self._transaction() as sql:
            rows = sql.execute("SELECT json FROM result WHERE vehicle = ? ORDER BY position", (vehicle,)).fetchall()
        return (file.parsed(text, self.where) for (text,) in rows)

    def add_fills(self, fills: Iterable[FluidFill]) -> int:
        """Note fluid fills; return how many were not known before."""
        with self._transaction() as sql:
            return add_fills(sql, fills)

    def fills(self, vehicle: str) -> list[FluidFill]:
        """Return the fluid fills of a vehicle, the earliest first."""
        with self._transaction() as sql:
            return read_fills(sql, vehicle)

    def all_fills(self, vehicle: str) -> list[FluidFill]:
        """Return the fluid fills of a vehicle for the fleet, with withdrawn ones and duplicates."""
        with self._transaction() as sql:
            return all_fills(sql, vehicle)

    def fluid_at(self, vehicle: str, moment: str) -> FluidFill | None:
        """Return the fill of the fluid that a vehicle had at a moment (ISO 8601 UTC), if it is known."""
        with self._transaction() as sql:
            if sql.execute("SELECT 1 FROM fill WHERE vehicle = ? LIMIT 1", (vehicle,)).fetchone() is None:
                return None  # as for most vehicles, before each event
            return latest_fill(sql, vehicle, moment)

    def _object(self, text: str) -> JsonObject:
        with file.translated(self.where):
            table = json.loads(text)
            if not isinstance(table, dict):
                raise TypeError("a state is not an object")
        return table

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Run one transaction alone; a failure takes all of it back."""
        with self._guard:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException as exc:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                if isinstance(exc, file.STORE_FAILURES):
                    raise file.store_error(self.where, exc) from exc
                raise


def _value(sql: sqlite3.Connection, key: str, first: str | None = None) -> str | None:
    """Return what the store keeps under a key; ``first``, from now on, if it has nothing there."""
    if first is not None:
        sql.execute("INSERT OR IGNORE INTO meta VALUES (?, ?)", (key, first))
    row = sql.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return None if row is None else str(row[0])


def _mark(sql: sqlite3.Connection, changes: Iterable[tuple[int, str | None, int]]) -> None:
    sql.executemany(  # of those that wait
        "UPDATE result SET published = ?, refusal = ? WHERE position = ? AND published = 0", changes
    )


def _stored_result(row: tuple[int, str, str, int, str, str, int, str, str]) -> StoredResult:
    position, vehicle, stream, seq, algorithm, calibration, clutch, produced_at, text = row
    key = ResultKey(
        vehicle=vehicle, stream=stream, seq=seq, algorithm_version=algorithm, calibration_version=calibration
    )
    return StoredResult(position=position, key=key, clutch=clutch, produced_at=produced_at, text=text)


def _used_bytes(sql: sqlite3.Connection) -> int:
    """Return how much of the database file holds something."""
    (pages,) = sql.execute("PRAGMA page_count").fetchone()
    (free,) = sql.execute("PRAGMA freelist_count").fetchone()
    (page_bytes,) = sql.execute("PRAGMA page_size").fetchone()
    return int(pages - free) * int(page_bytes)


def _enforce_budget(sql: sqlite3.Connection, budget_bytes: int, own_position: int) -> None:
    """Drop what goes first until the database fits its budget; the result just added stays.

    Runs inside the transaction that adds a result, so what is dropped and what is added are one step.
    """
    for name, condition in file.GIVEN_UP.items():
        while _used_bytes(sql) > budget_bytes:
            dropped = sql.execute(
                f"DELETE FROM result WHERE position IN (SELECT position FROM result WHERE {condition} AND position != ?"  # noqa: S608 - our own words
                " AND position NOT IN (SELECT max(position) FROM result GROUP BY vehicle, clutch)"
                " ORDER BY position LIMIT ?)",
                (own_position, _ROWS_AT_ONCE),
            ).rowcount
            sql.execute(
                "INSERT INTO meta VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = CAST(value AS INTEGER) + ?",
                (f"dropped.{name}", str(dropped), dropped),
            )
            if dropped < _ROWS_AT_ONCE:
                break


def _read_dropped(sql: sqlite3.Connection) -> dict[str, int]:
    return {name: int(_value(sql, f"dropped.{name}") or 0) for name in file.GIVEN_UP}
