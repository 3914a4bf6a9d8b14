"""A store that is only read: of results only, without owning it, also while its service runs."""

import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self
from urllib.parse import quote

from canlog.files import open_plain_file
from clutch_results.records import FluidFill, ShiftResult
from diag_service.errors import StoreError
from diag_service.store.file import APPLICATION_ID, parsed, refuse_newer, translated
from diag_service.store.fills import read_fills
from fleet_contract import JsonObject

_MODES: Final = ("mode=rw", "mode=ro", "mode=ro&immutable=1")  # the last where nothing may be written beside it
_MAGIC: Final = b"SQLite format 3\0"
_APPLICATION_ID: Final = slice(68, 72)  # of the header, big-endian
_POSITIONS: Final = 2**63  # SQLite counts no further


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A result and where it stands in its store."""

    position: int
    result: ShiftResult


def is_store(path: Path) -> bool:
    """Return whether a file is a store of results, by its first bytes."""
    with suppress(OSError), open_plain_file(path) as file:
        head = file.read(_APPLICATION_ID.stop)
        return head.startswith(_MAGIC) and head[_APPLICATION_ID] == APPLICATION_ID.to_bytes(4, "big")
    return False


class StoreReader:
    """An open store; what its service writes meanwhile is seen by the next question."""

    def __init__(self, connection: sqlite3.Connection, where: str) -> None:
        self._connection = connection
        self.where = where

    @classmethod
    @contextmanager
    def open(cls, path: Path) -> Iterator[Self]:
        """Open a store for reading while entered; raises StoreError if it is none that this program can read."""
        if not path.is_file():
            raise StoreError(f"there is no store {path}")
        if not is_store(path):
            raise StoreError(f"{path} is not a result store")
        with closing(_connect(path)) as connection, translated(str(path)):
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            refuse_newer(version, path)
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
            raise StoreError(f"store {self.where} holds no results")
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
    """Open a database for questions alone: so that nothing is left beside it, or as far as the disk lets us."""
    address = f"file:{quote(os.fsencode(path.absolute()))}"
    with translated(str(path)):
        for mode in _MODES[:-1]:
            with suppress(sqlite3.OperationalError):
                return _opened(f"{address}?{mode}")
        return _opened(f"{address}?{_MODES[-1]}")


def _opened(address: str) -> sqlite3.Connection:
    connection = sqlite3.connect(address, uri=True, isolation_level=None)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection
