"""The outbox inside a store: which results still have to be delivered, read and marked in batches."""

import sqlite3
from collections.abc import Iterable, Sequence
from typing import Final

from diag_service.diagnosis.results import StoredResult
from diag_service.store.schema import DELIVERED, QUARANTINED, WAITING
from fleet_contract import Outcome, Receipt, ResultKey

_SELECT: Final = (
    "SELECT position, vehicle, stream, seq, algorithm_version, calibration_version, clutch,"
    " json_extract(json, '$.produced_at'), json FROM result"
)
_BETWEEN: Final = "vehicle = ? AND published = 0 AND position > ? AND position < ?"  # literal 0: the index knows it
_OUTCOMES: Final = {Outcome.ACCEPTED: DELIVERED, Outcome.QUARANTINED: QUARANTINED}

Row = tuple[int, str, str, int, str, str, int, str, str]


def oldest(sql: sqlite3.Connection, vehicle: str, after: int, before: int, limit: int) -> list[StoredResult]:
    """Return the oldest waiting results between two positions, oldest first."""
    rows = sql.execute(f"{_SELECT} WHERE {_BETWEEN} ORDER BY position LIMIT ?", (vehicle, after, before, limit))
    return [_result(row) for row in rows]


def newest(sql: sqlite3.Connection, vehicle: str, after: int, before: int, limit: int) -> list[StoredResult]:
    """Return the newest waiting results between two positions, newest first."""
    rows = sql.execute(f"{_SELECT} WHERE {_BETWEEN} ORDER BY position DESC LIMIT ?", (vehicle, after, before, limit))
    return [_result(row) for row in rows]


def at(sql: sqlite3.Connection, positions: Iterable[int]) -> list[StoredResult]:
    """Return the results at some positions; those that are gone are left out."""
    rows = (sql.execute(f"{_SELECT} WHERE position = ?", (position,)).fetchone() for position in positions)
    return [_result(row) for row in rows if row is not None]


def latest(sql: sqlite3.Connection, vehicle: str) -> list[StoredResult]:
    """Return the newest result of each clutch of a vehicle."""
    rows = sql.execute("SELECT max(position) FROM result WHERE vehicle = ? GROUP BY clutch ORDER BY clutch", (vehicle,))
    return at(sql, [position for (position,) in rows.fetchall()])


def count(sql: sqlite3.Connection, vehicle: str) -> int:
    """Return how many results of a vehicle wait."""
    return int(sql.execute("SELECT count(*) FROM result WHERE vehicle = ? AND published = 0", (vehicle,)).fetchone()[0])


def mark(sql: sqlite3.Connection, positions: Iterable[int]) -> None:
    """Note that results are where they belong."""
    _note(sql, [(DELIVERED, None, position) for position in positions])


def settle(sql: sqlite3.Connection, receipts: Sequence[Receipt]) -> list[int]:
    """Note what a backend acknowledged, and return where the results are; a key that is not here is not ours."""
    found = [(_position(sql, receipt.key), receipt) for receipt in receipts]
    known = [(position, receipt) for position, receipt in found if position is not None]
    _note(sql, [(_OUTCOMES[receipt.outcome], receipt.reason, position) for position, receipt in known])
    return [position for position, _ in known]


def _note(sql: sqlite3.Connection, changes: Sequence[tuple[int, str | None, int]]) -> None:
    sql.executemany(
        "UPDATE result SET published = ?, refusal = ? WHERE position = ? AND published = ?",
        [(*change, WAITING) for change in changes],
    )


def _position(sql: sqlite3.Connection, key: ResultKey) -> int | None:
    row = sql.execute(
        "SELECT position FROM result WHERE vehicle = ? AND stream = ? AND seq = ?"
        " AND algorithm_version = ? AND calibration_version = ?",
        (key.vehicle, key.stream, key.seq, key.algorithm_version, key.calibration_version),
    ).fetchone()
    return None if row is None else int(row[0])


def _result(row: Row) -> StoredResult:
    position, vehicle, stream, seq, algorithm, calibration, clutch, produced_at, text = row
    key = ResultKey(
        vehicle=vehicle, stream=stream, seq=seq, algorithm_version=algorithm, calibration_version=calibration
    )
    return StoredResult(position=position, key=key, clutch=clutch, produced_at=produced_at, text=text)
