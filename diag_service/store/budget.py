"""The disk budget of a store: what goes first when it is spent, and the count of it."""

import sqlite3
from dataclasses import dataclass, fields
from typing import Final

from diag_service.store.schema import WAITING

_ROWS_AT_ONCE: Final = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class DroppedCounts:
    """Results that a store gave up for its budget, in the order in which they go."""

    delivered: int = 0  # someone else has them
    empty: int = 0  # not delivered, but without an estimate
    undelivered: int = 0  # lost

    @property
    def lost(self) -> int:
        """Results that nobody will ever have."""
        return self.empty + self.undelivered


# Oldest first within each class. A store holds results only: signals and metrics are never kept at their cost.
_ORDER: Final = {
    "delivered": f"published != {WAITING}",
    "empty": f"published = {WAITING} AND json_extract(json, '$.status') != 'valid'",
    "undelivered": f"published = {WAITING}",
}


def used_bytes(sql: sqlite3.Connection) -> int:
    """Return how much of the database file holds something."""
    (pages,) = sql.execute("PRAGMA page_count").fetchone()
    (free,) = sql.execute("PRAGMA freelist_count").fetchone()
    (page_bytes,) = sql.execute("PRAGMA page_size").fetchone()
    return int(pages - free) * int(page_bytes)


def enforce(sql: sqlite3.Connection, budget_bytes: int, own_position: int) -> None:
    """Drop what goes first until the database fits its budget; the result just added stays.

    Runs inside the transaction that adds a result, so what is dropped and what is added are one step.
    """
    for name, condition in _ORDER.items():
        while used_bytes(sql) > budget_bytes:
            dropped = _drop(sql, condition, own_position)
            _count(sql, name, dropped)
            if dropped < _ROWS_AT_ONCE:
                break


def read_counts(sql: sqlite3.Connection) -> DroppedCounts:
    """Return how many results this store has given up so far."""
    rows = dict(sql.execute("SELECT key, value FROM meta WHERE key LIKE 'dropped.%'").fetchall())
    return DroppedCounts(**{field.name: int(rows.get(f"dropped.{field.name}", 0)) for field in fields(DroppedCounts)})


def _drop(sql: sqlite3.Connection, condition: str, own_position: int) -> int:
    return sql.execute(
        f"DELETE FROM result WHERE position IN (SELECT position FROM result WHERE {condition} AND position != ?"  # noqa: S608 - our own words
        " AND position NOT IN (SELECT max(position) FROM result GROUP BY vehicle, clutch) ORDER BY position LIMIT ?)",
        (own_position, _ROWS_AT_ONCE),
    ).rowcount


def _count(sql: sqlite3.Connection, name: str, dropped: int) -> None:
    sql.execute(
        "INSERT INTO meta VALUES (?, ?) ON CONFLICT (key) DO UPDATE SET value = CAST(value AS INTEGER) + ?",
        (f"dropped.{name}", str(dropped), dropped),
    )
