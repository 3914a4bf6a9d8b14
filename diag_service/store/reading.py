"""A store that is only read: results and fills of fluid, without owning it, also while its service runs."""

import errno
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, Self
from urllib.parse import quote

from canlog.files import open_plain_file
from clutch_results.event_kinds import DATED_NS
from clutch_results.records import FluidFill, ShiftResult, fill_words, iso_utc
from diag_service.errors import ConfigError, StoreError
from diag_service.store.file import (
    EMPTY,
    connect,
    form_of,
    is_of_another_program,
    parsed,
    primary_code,
    store_error,
    translated,
)
from fleet_contract import JsonObject
from fleet_contract.orders import SAME_WITHIN, distinct, fill_meant, odometer_complaint

_MAGIC: Final = b"SQLite format 3\0"
_POSITIONS: Final = 2**63  # SQLite counts no further
# SQLite may not write what it keeps beside a store; where nothing waits there, it reads the file alone.
_CLOSED: Final = frozenset({sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY})


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A result and where it stands in its store."""

    position: int
    result: ShiftResult


def is_store(path: Path) -> bool:
    """Return whether a file is to be opened as a store of results: SQLite reads it, and it is of no other program.

    One that SQLite cannot read counts as a store: whoever opens it says why.
    """
    with suppress(OSError), open_plain_file(path) as file:
        if file.read(len(_MAGIC)) == _MAGIC:
            try:
                with closing(_connect(path)) as connection, translated(str(path)):
                    return not is_of_another_program(connection)
            except StoreError:
                return True
    return False


class StoreReader:
    """A store opened for reading; each query sees what its service has written until then."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection = connection
        self.where = where

    @classmethod
    @contextmanager
    def open(cls, path: Path) -> Iterator[Self]:
        """Open a store for reading while entered; raises StoreError if it is none that this program can read."""
        with closing(_connect(path)) as connection, translated(str(path)):
            if form_of(connection, path) == EMPTY:
                raise StoreError(
                    f"store {path} is empty; of a copy that was made while its service ran {_log_of(path).name} is"
                    " missing: copy both"
                )
            yield cls(connection, str(path))

    def vehicle(self, named: str | None) -> str:
        """Return the vehicle that is meant: the one that was named, or else the only one there is.

        Raises
        ------
        StoreError
            If the store has no results of the one that was named, or several vehicles and none was.
        """
        rows = self._connection.execute("SELECT DISTINCT vehicle FROM result ORDER BY vehicle")
        known = [str(vehicle) for (vehicle,) in rows]
        if not known:
            raise StoreError(f"store {self.where} holds no results; a drive without a shift leaves none: name its log")
        if named is None and len(known) > 1:
            raise StoreError(f"store {self.where} has several vehicles: name one by --vehicle, of {', '.join(known)}")
        if named is not None and named not in known:
            raise StoreError(f"store {self.where} has no results of {named}; it has {', '.join(known)}")
        return named or known[0]

    def rows(self, vehicle: str) -> Iterator[Row]:
        """Yield the results of a vehicle in the order in which they were stored, whatever version made them."""
        rows = self._connection.execute(
            "SELECT position, json FROM result WHERE vehicle = ? ORDER BY position", (vehicle,)
        )
        for position, text in rows:
            yield Row(position=int(position), result=parsed(text, self.where))

    def record(self, position: int) -> JsonObject:
        """Return the record of the result at a position, as it was stored; raises StoreError if there is none."""
        row = None
        if abs(position) < _POSITIONS:
            row = self._connection.execute("SELECT json FROM result WHERE position = ?", (position,)).fetchone()
        if row is None:
            (last,) = self._connection.execute("SELECT coalesce(max(position), 0) FROM result").fetchone()
            raise StoreError(f"store {self.where} has no shift {position}; the newest is {last}")
        parsed(row[0], self.where)
        record: JsonObject = json.loads(row[0])
        return record

    def fills(self, vehicle: str) -> list[FluidFill]:
        """Return the fills of a vehicle, the earliest first."""
        return read_fills(self._connection, vehicle)


def _connect(path: Path) -> sqlite3.Connection:
    """Open a database for queries; raises StoreError, which says what is in the way."""
    _check_readable(path)
    address = f"file:{quote(os.fsencode(path.absolute()))}"
    for mode in ("mode=rw", "mode=ro"):
        try:
            return _opened(f"{address}?{mode}")
        except sqlite3.Error as exc:
            if primary_code(exc) not in _CLOSED:
                raise store_error(str(path), exc) from exc
    with suppress(FileNotFoundError):
        if _log_of(path).stat().st_size:
            raise StoreError(
                f"store {path} cannot be read where it is: its last results are in {_log_of(path).name}, and the folder"
                " cannot be written, as SQLite must to read them; copy both files elsewhere"
            )
    with translated(str(path)):
        return _opened(f"{address}?mode=ro&immutable=1")


def _log_of(path: Path) -> Path:
    """Return where SQLite keeps what is not in the file of a store yet."""
    return path.with_name(f"{path.name}-wal")


def _check_readable(path: Path) -> None:
    """Raise StoreError if there is no store, or this user may not read one of its files."""
    for file in (path, _log_of(path)):
        try:
            open_plain_file(file).close()
        except FileNotFoundError as exc:
            if file == path:
                raise StoreError(f"there is no store {path}") from exc
        except OSError as exc:
            advice = "; be the user whose service keeps it, or ask for a copy" if exc.errno == errno.EACCES else ""
            raise StoreError(f"cannot read store {path}: {exc.strerror} ({file.name}){advice}") from exc


def _opened(address: str) -> sqlite3.Connection:
    connection = sqlite3.connect(address, uri=True, isolation_level=None)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


_LAST: Final = "SELECT json_extract(json, '$.end_bus_ns') FROM result WHERE vehicle = ? ORDER BY position DESC LIMIT 1"
_NEXT: Final = timedelta(microseconds=1)
_READING: Final = (
    "SELECT json_extract(json, '$.odometer_m') FROM result WHERE vehicle = ? AND json_extract(json, '$.odometer_m')"
    " IS NOT NULL AND json_extract(json, '$.end_utc') {} ? ORDER BY json_extract(json, '$.end_utc') {} LIMIT 1"
)


def add_fills(sql: sqlite3.Connection, fills: Iterable[FluidFill]) -> int:
    """Note fills within a transaction; one that is known already stays as it is. Return how many were news.

    A fill that is withdrawn is so for good: whoever tells of it again has not heard of that yet.
    """
    before = sql.total_changes
    rows = [
        (fill.vehicle, fill.filled_at, fill.odometer_m, fill.product, fill.note, fill.is_withdrawn) for fill in fills
    ]
    sql.executemany(
        "INSERT INTO fill VALUES (?, ?, ?, ?, ?, ?)"
        " ON CONFLICT DO UPDATE SET is_withdrawn = 1 WHERE excluded.is_withdrawn > is_withdrawn",
        rows,
    )
    return sql.total_changes - before


def all_fills(sql: sqlite3.Connection, vehicle: str) -> list[FluidFill]:
    """Return all fills of a vehicle, withdrawn ones too, the earliest first; none in a store of an earlier program."""
    if not sql.execute("SELECT 1 FROM sqlite_master WHERE name = 'fill'").fetchone():
        return []
    cursor = sql.execute("SELECT * FROM fill WHERE vehicle = ? ORDER BY filled_at", (vehicle,))
    names = [column for column, *_ in cursor.description]
    rows = (dict(zip(names, row, strict=True)) for row in cursor)
    fills = [FluidFill(**{**row, "is_withdrawn": bool(row.get("is_withdrawn"))}) for row in rows]
    for fill in fills:
        _moment(fill)
        if not isinstance(fill.odometer_m, float | int | None):
            raise TypeError(f"the odometer of a fill is {fill.odometer_m!r}")
    return fills


def read_fills(sql: sqlite3.Connection, vehicle: str) -> list[FluidFill]:
    """Return the fills of a vehicle, the earliest first; what was noted twice is one."""
    return distinct((fill for fill in all_fills(sql, vehicle) if not fill.is_withdrawn), _moment)


def latest_fill(sql: sqlite3.Connection, vehicle: str, until: str) -> FluidFill | None:
    """Return the fluid that a vehicle had at a moment, if its fill is known."""
    return next((fill for fill in reversed(read_fills(sql, vehicle)) if fill.filled_at <= until), None)


def note_fill(path: Path, fill: FluidFill, *, is_insisted: bool = False) -> FluidFill:
    """Note a fill in a store, also while a service owns it: it looks before each shift. Return it as it is kept.

    Raises
    ------
    StoreError
        If there is no such store, or the fill is noted already.
    ConfigError
        If the vehicle's results have no date: none could ever count as later. If its odometer does not fit to the
        results before and after it, and nobody insists.
    """
    with closing(_open(path)) as connection, translated(str(path)), connection:
        (end_ns,) = connection.execute(_LAST, (fill.vehicle,)).fetchone() or (DATED_NS,)
        if end_ns < DATED_NS:
            raise ConfigError(f"the results of {fill.vehicle} have no date: nobody can tell which are of new fluid")
        if fill.odometer_m is not None and not is_insisted:  # looks at all results: a service must not wait for that
            readings = [connection.execute(_READING.format(*how), (fill.vehicle, fill.filled_at)) for how in _HOW]
            before_m, after_m = ((reading.fetchone() or [None])[0] for reading in readings)
            if complaint := odometer_complaint(fill.odometer_m, before_m, after_m):
                raise ConfigError(complaint)
        connection.execute("BEGIN IMMEDIATE")
        known = all_fills(connection, fill.vehicle)
        near = [
            other for other in known if abs(_moment(other) - _moment(fill)) < SAME_WITHIN and not other.is_withdrawn
        ]
        if near:
            raise StoreError(
                f"the fill of {fill.vehicle} at {fill_words(near[0])} is noted already; --undo takes it back"
            )
        while any(other.filled_at == fill.filled_at for other in known):  # withdrawn: that moment is taken for good
            fill = replace(fill, filled_at=iso_utc(_moment(fill) + _NEXT))
        add_fills(connection, [fill])
    return fill


def withdraw_fill(path: Path, vehicle: str, moment: str | None) -> FluidFill:
    """Take back the last fill, or the nearest within a day of a moment, and return it; StoreError if there is none."""
    with closing(_open(path)) as connection, translated(str(path)), connection:
        connection.execute("BEGIN IMMEDIATE")
        known = [fill for fill in all_fills(connection, vehicle) if not fill.is_withdrawn]
        meant = fill_meant(known, _moment, None if moment is None else datetime.fromisoformat(moment))
        if meant is None:
            raise StoreError(f"no fill of {vehicle} is noted{f' at {moment}' if moment else ''}")
        same = [fill for fill in known if timedelta(0) <= _moment(fill) - _moment(meant) < SAME_WITHIN]
        add_fills(connection, [replace(fill, is_withdrawn=True) for fill in same])
    return meant


_HOW: Final = (("<=", "DESC"), (">", "ASC"))  # before a fill, after it


def _open(path: Path) -> sqlite3.Connection:
    _check_readable(path)
    return connect(path)


def _moment(fill: FluidFill) -> datetime:
    return datetime.fromisoformat(fill.filled_at)
