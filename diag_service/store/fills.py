"""Fluid fills in a store: noted by the workshop at the vehicle, or by its fleet; each once, until it is taken back."""

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

from clutch_results.event_kinds import DATED_NS
from clutch_results.records import FluidFill, iso_utc
from diag_service.errors import ConfigError, StoreError
from diag_service.store.file import connect, translated
from fleet_contract.orders import SAME_WITHIN, distinct, fill_meant, odometer_complaint

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
    rows = [(one.vehicle, one.filled_at, one.odometer_m, one.product, one.note, one.is_withdrawn) for one in fills]
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
    return distinct((one for one in all_fills(sql, vehicle) if not one.is_withdrawn), _moment)


def latest_fill(sql: sqlite3.Connection, vehicle: str, until: str) -> FluidFill | None:
    """Return the fluid that a vehicle had at a moment, if its fill is known."""
    return next((one for one in reversed(read_fills(sql, vehicle)) if one.filled_at <= until), None)


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
        near = [one for one in known if abs(_moment(one) - _moment(fill)) < SAME_WITHIN and not one.is_withdrawn]
        if near:
            raise StoreError(
                f"the fill of {fill.vehicle} at {near[0].filled_at} is noted already; --undo takes it back"
            )
        while any(one.filled_at == fill.filled_at for one in known):  # withdrawn: that moment is taken for good
            fill = replace(fill, filled_at=iso_utc(_moment(fill) + _NEXT))
        add_fills(connection, [fill])
    return fill


def withdraw_fill(path: Path, vehicle: str, moment: str | None) -> FluidFill:
    """Take back the last fill, or the nearest within a day of a moment, and return it; StoreError if there is none."""
    with closing(_open(path)) as connection, translated(str(path)), connection:
        connection.execute("BEGIN IMMEDIATE")
        known = [one for one in all_fills(connection, vehicle) if not one.is_withdrawn]
        meant = fill_meant(known, _moment, None if moment is None else datetime.fromisoformat(moment))
        if meant is None:
            raise StoreError(f"no fill of {vehicle} is noted{f' at {moment}' if moment else ''}")
        same = [one for one in known if timedelta(0) <= _moment(one) - _moment(meant) < SAME_WITHIN]
        add_fills(connection, [replace(one, is_withdrawn=True) for one in same])
    return meant


_HOW: Final = (("<=", "DESC"), (">", "ASC"))  # before a fill, after it


def _open(path: Path) -> sqlite3.Connection:
    if not path.is_file():
        raise StoreError(f"there is no store {path}")
    return connect(path)


def _moment(fill: FluidFill) -> datetime:
    return datetime.fromisoformat(fill.filled_at)
