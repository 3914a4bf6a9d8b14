"""A vehicle is forgotten: every row about it goes in one transaction, and a second look proves it."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from hashlib import sha256
from typing import Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    Table,
    TableClause,
    delete,
    func,
    inspect,
    not_,
    or_,
    select,
    update,
)

from fleet_backend.audit_trail import COMMAND_LINE, note_change
from fleet_backend.database import transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.months.locations import CLUTCH_BLOCK, CLUTCH_STREAM
from fleet_backend.office_tables import ALARM_MESSAGE, AUDIT, METADATA
from fleet_backend.queries import check_vehicle
from fleet_backend.schema import QUARANTINE

FORGOTTEN: Final = "a forgotten vehicle"  # in the audit, which stays


@dataclass(frozen=True, slots=True, kw_only=True)
class Forgotten:
    """What was forgotten of a vehicle; its name is kept as a digest alone."""

    digest: str  # sha256 of the name
    gone: dict[str, int]  # rows, by table; of the audit those whose subject is told no more
    left: dict[str, int]  # of a second look: 0 each


def forget_vehicle(engine: Engine, vehicle: str, *, now: datetime, by: str) -> Forgotten:
    """Delete all rows about a vehicle; lines of the audit stay without its name.

    Raises
    ------
    UnknownVehicleError
        If nothing ever came from it.
    DatabaseError
        If anything would be left; then all stays.
    """
    check_vehicle(engine, vehicle)
    digest = sha256(vehicle.encode()).hexdigest()
    with transaction(engine) as connection:
        tables = list(_tables(connection))
        gone = {one.name: connection.execute(delete(one).where(_is_about(one, vehicle))).rowcount for one in tables}
        told = update(AUDIT).where(_is_about(AUDIT, vehicle)).values(subject=FORGOTTEN)
        gone[AUDIT.name] = connection.execute(told).rowcount
        left = {one.name: _count(connection, one, vehicle) for one in (*tables, AUDIT)}
        if any(left.values()):
            raise DatabaseError(f"rows about {vehicle} came meanwhile and nothing was deleted: stop its service first")
        subject = f"vehicle with sha256 {digest}"
        note_change(connection, at=now, who=by, role=COMMAND_LINE, action="forget vehicle", subject=subject)
    return Forgotten(digest=digest, gone=gone, left=left)


def _count(connection: Connection, table: Table | TableClause, vehicle: str) -> int:
    statement = select(func.count()).select_from(table).where(_is_about(table, vehicle))
    return int(connection.execute(statement).scalar_one())


def _tables(connection: Connection) -> Iterator[Table | TableClause]:
    """Yield the tables that have rows about vehicles, those that refer to others before these."""
    there = set(inspect(connection).get_table_names())
    for table in (CLUTCH_BLOCK, CLUTCH_STREAM, *reversed(METADATA.sorted_tables)):
        if table.name in there and ("vehicle" in table.c or table is ALARM_MESSAGE):
            yield table


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
