"""Fluid fills in a store: noted by the workshop at the vehicle, or by its fleet; each once."""

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Final

from diag_service.diagnosis.records import FluidFill
from diag_service.errors import StoreError
from diag_service.store.file import connect, translated

_COLUMNS: Final = "vehicle, filled_at, odometer_m, product, note"


def add_fills(sql: sqlite3.Connection, fills: Iterable[FluidFill]) -> int:
    """Note fills within a transaction; one that is known already stays as it is. Return how many were new."""
    before = sql.total_changes
    rows = [(one.vehicle, one.filled_at, one.odometer_m, one.product, one.note) for one in fills]
    sql.executemany(f"INSERT OR IGNORE INTO fill ({_COLUMNS}) VALUES (?, ?, ?, ?, ?)", rows)  # noqa: S608 - our words
    return sql.total_changes - before


def read_fills(sql: sqlite3.Connection, vehicle: str) -> list[FluidFill]:
    """Return the fills of a vehicle, the earliest first; none in a store of an earlier program."""
    if not sql.execute("SELECT 1 FROM sqlite_master WHERE name = 'fill'").fetchone():
        return []
    rows = sql.execute(f"SELECT {_COLUMNS} FROM fill WHERE vehicle = ? ORDER BY filled_at", (vehicle,))  # noqa: S608 - ours
    return [_fill(row) for row in rows]


def latest_fill(sql: sqlite3.Connection, vehicle: str, until: str) -> FluidFill | None:
    """Return the fluid that a vehicle had at a moment, if its fill is known."""
    row = sql.execute(
        f"SELECT {_COLUMNS} FROM fill WHERE vehicle = ? AND filled_at <= ? ORDER BY filled_at DESC LIMIT 1",  # noqa: S608 - ours
        (vehicle, until),
    ).fetchone()
    return None if row is None else _fill(row)


def note_fill(path: Path, fill: FluidFill) -> None:
    """Note a fill in a store, also while a service owns it: it looks before each shift.

    Raises
    ------
    StoreError
        If there is no such store, or the fill is noted already.
    """
    if not path.is_file():
        raise StoreError(f"there is no store {path}")
    with closing(connect(path)) as connection, translated(str(path)):
        connection.execute("BEGIN IMMEDIATE")
        count = add_fills(connection, [fill])
        connection.execute("COMMIT")
    if not count:
        raise StoreError(f"the fill of {fill.vehicle} at {fill.filled_at} is noted already")


def _fill(row: tuple[str, str, float | None, str | None, str | None]) -> FluidFill:
    vehicle, filled_at, odometer_m, product, note = row
    return FluidFill(vehicle=vehicle, filled_at=filled_at, odometer_m=odometer_m, product=product, note=note)
