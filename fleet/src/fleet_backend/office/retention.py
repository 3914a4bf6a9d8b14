"""What goes: old results month by month, but for the last result of each clutch; or all of one vehicle.

A vehicle is forgotten in one transaction, and a second look proves it.
"""

from dataclasses import dataclass
from datetime import UTC, date, datetime, time
from hashlib import sha256
from typing import Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    Table,
    TableClause,
    TextClause,
    bindparam,
    delete,
    exists,
    func,
    not_,
    or_,
    select,
    text,
    tuple_,
    update,
)

from fleet_backend.database import transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.months import (
    CLUTCH_STREAM,
    TABLE,
    forget,
    has_partitions,
    keep_months,
    lock,
    make_before,
    month_of,
    months,
    months_on,
    moved_only,
    name_of,
    note_going,
)
from fleet_backend.office_tables import ALARM_MESSAGE, AUDIT, METADATA, note_change
from fleet_backend.queries import check_vehicle
from fleet_backend.schema import IS_OLD, QUARANTINE, REVISION, SHIFT_RESULT, UtcDateTime

_KEY: Final = ("vehicle", "stream", "seq")
_LAST: Final = "SELECT r.vehicle, r.stream, r.seq FROM running_condition AS r"


@dataclass(frozen=True, slots=True, kw_only=True)
class Retained:
    """What a retention did."""

    before: date  # results of earlier months are gone
    gone_count: int
    kept_count: int  # earlier results that stay: the last of their clutches


def retain(engine: Engine, kept_months: int, *, now: datetime, by: str) -> Retained:
    """Forget the results of all months but the last ``kept_months`` and this one.

    The last result of a clutch is never forgotten: a vehicle that has been silent for long keeps its condition. Raises
    DatabaseAwayError if somebody reads too long: try again, nothing was changed.
    """
    first = months_on(month_of(now), -kept_months)
    until = datetime.combine(first, time(), UTC)
    if has_partitions(engine):
        keep_months(engine, now)  # a month of its own for what stays
    with transaction(engine) as connection:
        forget = _drop_months if has_partitions(engine) else _delete
        gone_count = forget(connection, first, until)
        kept_count = _old_count(connection, until)
        if gone_count:
            _drop_revisions(connection)
            note_change(connection, "forget results", f"{gone_count} results from before {first:%Y-%m}", at=now, by=by)
    return Retained(before=first, gone_count=gone_count, kept_count=kept_count)


def _until(statement: str) -> TextClause:
    return text(statement).bindparams(bindparam("until", type_=UtcDateTime))


def _delete(connection: Connection, _first: date, until: datetime) -> int:
    """Delete row by row, as SQLite has to; return how many results are gone."""
    key = tuple_(*(SHIFT_RESULT.c[name] for name in _KEY))
    last = text(_LAST).columns(*(SHIFT_RESULT.c[name] for name in _KEY))
    statement = delete(SHIFT_RESULT).where(_until(IS_OLD.format("")), key.not_in(last))
    return connection.execute(statement, {"until": until}).rowcount


def _drop_months(connection: Connection, first: date, until: datetime) -> int:
    """Drop partitions; the last results that were in them go into the part before the months."""
    lock(connection)
    connection.exec_driver_sql(f"LOCK TABLE {TABLE} IN SHARE ROW EXCLUSIVE MODE")  # others read on, and write later
    old_count, known = _old_count(connection, until), months(connection)
    edge = min(month for month in known if month >= first)
    edge_at = datetime.combine(edge, time(), UTC)
    connection.execute(
        text(
            f"CREATE TEMPORARY TABLE kept ON COMMIT DROP AS SELECT s.* FROM {TABLE} AS s"  # noqa: S608 - our own names
            f" WHERE s.produced_at < :edge AND (NOT {IS_OLD.format('s.')} OR (s.vehicle, s.stream, s.seq) IN ({_LAST}))"
        ),
        {"edge": edge_at, "until": until},
    )
    note_going(connection, edge_at)
    for name in [f"{TABLE}_before", *(name_of(month) for month in known if month < first)]:
        connection.exec_driver_sql(f"ALTER TABLE {TABLE} DETACH PARTITION {name}")
        connection.exec_driver_sql(f"DROP TABLE {name}")
    make_before(connection, TABLE, edge)
    with moved_only(connection):
        connection.exec_driver_sql(f"INSERT INTO {TABLE} SELECT * FROM kept")  # noqa: S608 - our own names
    forget(connection, edge_at)
    return old_count - _old_count(connection, until)


def _drop_revisions(connection: Connection) -> None:
    """Delete revisions of which both are gone: the result that told it, and the one that it is about."""
    revision, result = REVISION.c, SHIFT_RESULT.c
    pairs = (("vehicle", "stream", "seq"), ("vehicle", "clutch", "end_bus_ns"))
    gone = (~exists().where(*(result[name] == revision[name] for name in names)) for names in pairs)
    connection.execute(delete(REVISION).where(*gone))


def _old_count(connection: Connection, until: datetime) -> int:
    statement = select(func.count()).select_from(SHIFT_RESULT).where(_until(IS_OLD.format("")))
    return int(connection.execute(statement, {"until": until}).scalar_one())


FORGOTTEN: Final = "a forgotten vehicle"  # in the audit, which stays


@dataclass(frozen=True, slots=True, kw_only=True)
class Forgotten:
    """What was forgotten of a vehicle; its name is kept as a digest alone."""

    digest: str  # sha256 of the name
    gone: dict[str, int]  # rows, by table; of the audit those whose subject is told no more
    left: dict[str, int]  # of a second look: 0 each


def forget_vehicle(engine: Engine, vehicle: str, *, now: datetime, by: str) -> Forgotten:
    """Delete all rows about a vehicle; lines of the audit stay without its name.

    Raises UnknownVehicleError if nothing ever came from it, DatabaseError if anything would be left; then all stays.
    """
    check_vehicle(engine, vehicle)
    digest = sha256(vehicle.encode()).hexdigest()
    with transaction(engine) as connection:
        # Tables that refer to others come before these.
        tables = [CLUTCH_STREAM] if has_partitions(engine) else []
        tables += [
            table for table in reversed(METADATA.sorted_tables) if "vehicle" in table.c or table is ALARM_MESSAGE
        ]
        deletions = {table.name: delete(table).where(_is_about(table, vehicle)) for table in tables}
        gone = {name: connection.execute(deletion).rowcount for name, deletion in deletions.items()}
        renaming = update(AUDIT).where(_is_about(AUDIT, vehicle)).values(subject=FORGOTTEN)
        gone[AUDIT.name] = connection.execute(renaming).rowcount
        left = {table.name: _count(connection, table, vehicle) for table in (*tables, AUDIT)}
        if any(left.values()):
            raise DatabaseError(f"rows about {vehicle} came meanwhile and nothing was deleted: stop its service first")
        note_change(connection, "forget vehicle", f"vehicle with sha256 {digest}", at=now, by=by)
    return Forgotten(digest=digest, gone=gone, left=left)


def _count(connection: Connection, table: Table | TableClause, vehicle: str) -> int:
    statement = select(func.count()).select_from(table).where(_is_about(table, vehicle))
    return int(connection.execute(statement).scalar_one())


def _is_about(table: Table | TableClause, vehicle: str) -> ColumnElement[bool]:
    """Return the condition for the rows about a vehicle."""
    if table is QUARANTINE:  # also what came on its topics in a form that nobody could read
        return or_(table.c.vehicle == vehicle, table.c.topic.contains(f"/{vehicle}/", autoescape=True))
    if table is ALARM_MESSAGE:
        return table.c.key.startswith(f"{vehicle}/", autoescape=True)
    if table is AUDIT:
        text = table.c.subject
        words = (f"{vehicle} ", f"{vehicle}/", f"{vehicle},", f"{vehicle}:")
        begins = (text.startswith(word, autoescape=True) for word in words)
        inside = (text.contains(f" {word}", autoescape=True) for word in words)
        is_named = or_(text == vehicle, text.endswith(f" {vehicle}", autoescape=True), *begins, *inside)
        return not_(text == FORGOTTEN) & is_named
    return table.c.vehicle == vehicle
