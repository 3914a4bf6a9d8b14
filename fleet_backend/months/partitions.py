"""Results in PostgreSQL, one partition for each month of their making, without a gap: before, the months, after.

No partition is a default one: PostgreSQL then knows that they follow each other, and finds the newest result of a
clutch in the newest month without a look at the others. A result that no month takes is in the first or the last.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Final

from sqlalchemy import Connection, Engine, text

from fleet_backend.database import transaction
from fleet_backend.errors import ConfigError
from fleet_backend.months.locations import TABLE, moved_only

__all__ = [
    "AHEAD_MONTHS",
    "LOCK_S",
    "MOST_MONTHS",
    "TABLE",
    "Partition",
    "has_partitions",
    "keep_months",
    "lock",
    "make_before",
    "make_partitions",
    "month_of",
    "months",
    "months_between",
    "months_on",
    "name_of",
    "partitions",
]

AHEAD_MONTHS: Final = 3  # kept ready, so that a forgotten command costs a quarter before results gather in the last
MOST_MONTHS: Final = 120
LOCK_S: Final = 5  # new partitions need all to themselves for a moment; whoever reads long is not waited for longer
_LOCK: Final = 0x434C4450  # PostgreSQL's advisory lock of whoever makes partitions: "CLDP"
_FOUND: Final = """
SELECT c.relname AS name, pg_get_expr(c.relpartbound, c.oid) AS bound, pg_total_relation_size(c.oid) AS size_bytes,
  CASE WHEN c.reltuples < 0 THEN NULL ELSE c.reltuples::bigint END AS row_estimate
FROM pg_inherits AS i JOIN pg_class AS c ON c.oid = i.inhrelid
WHERE i.inhparent = CAST(:parent AS regclass) ORDER BY c.relname
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Partition:
    """A part of the results."""

    name: str
    month: date | None  # None: the part before all months, or the one after
    size_bytes: int  # with its indexes
    row_estimate: int | None  # PostgreSQL's own; None where it has not counted


def month_of(moment: datetime) -> date:
    """Return the first day of the month of an aware moment, in UTC."""
    return moment.astimezone(UTC).date().replace(day=1)


def months_on(month: date, count: int) -> date:
    """Return the first day of the month ``count`` months later; negative: earlier."""
    number = month.year * 12 + month.month - 1 + count
    return date(number // 12, number % 12 + 1, 1)


def months_between(first: date, end: date) -> Iterator[date]:
    """Yield the months from ``first`` on, without ``end``."""
    while first < end:
        yield first
        first = months_on(first, 1)


def has_partitions(engine: Engine) -> bool:
    """Return whether a database keeps its results by months; SQLite has one table."""
    return engine.dialect.name == "postgresql"


def make_partitions(connection: Connection, table: str, first: date, end: date) -> None:
    """Make all partitions of a new table: the months from ``first`` on without ``end``, one before, one after."""
    make_before(connection, table, first)
    _make_months(connection, table, months_between(first, end))
    _make_after(connection, table, end)


def make_before(connection: Connection, table: str, first: date) -> None:
    """Make the part before the month ``first``."""
    connection.exec_driver_sql(
        f"CREATE TABLE {TABLE}_before PARTITION OF {table} FOR VALUES FROM (MINVALUE) TO ({_bound(first)})"
    )


def _make_months(connection: Connection, table: str, wanted: Iterable[date]) -> None:
    for month in wanted:
        bounds = f"FROM ({_bound(month)}) TO ({_bound(months_on(month, 1))})"
        connection.exec_driver_sql(f"CREATE TABLE {name_of(month)} PARTITION OF {table} FOR VALUES {bounds}")


def _make_after(connection: Connection, table: str, end: date) -> None:
    connection.exec_driver_sql(
        f"CREATE TABLE {TABLE}_after PARTITION OF {table} FOR VALUES FROM ({_bound(end)}) TO (MAXVALUE)"
    )


def name_of(month: date) -> str:
    return f"{TABLE}_{month:%Y_%m}"


def partitions(engine: Engine) -> list[Partition]:
    """Return the partitions, the earliest first; none where a database has no partitions."""
    if not has_partitions(engine):
        return []
    with transaction(engine) as connection:
        found = [
            Partition(name=row.name, month=_month(row.name), size_bytes=row.size_bytes, row_estimate=row.row_estimate)
            for row in connection.execute(text(_FOUND), {"parent": TABLE})
        ]
    return sorted(found, key=lambda one: (one.name.endswith("_after"), one.month or date.min))


def keep_months(engine: Engine, now: datetime, ahead: int = AHEAD_MONTHS, back: int = 0) -> list[date]:
    """Make the months from ``back`` months ago until ``ahead`` months from now that are missing; return them.

    Results that waited in the first or last partition move into their months.

    Raises
    ------
    ConfigError
        If the database has no partitions, or so many months make no sense.
    DatabaseAwayError
        If somebody reads too long: try again, nothing was changed.
    """
    if not has_partitions(engine):
        raise ConfigError("only a PostgreSQL database has partitions; SQLite keeps all results in one table")
    if not (0 <= ahead <= MOST_MONTHS and 0 <= back <= MOST_MONTHS):
        raise ConfigError(f"months ahead and back must be 0 to {MOST_MONTHS}, got {ahead} and {back}")
    with transaction(engine) as connection:
        lock(connection)
        known = months(connection)
        first, end = months_on(month_of(now), -back), months_on(max(known), 1)
        early = list(months_between(first, min(known)))
        late = list(months_between(end, months_on(month_of(now), ahead + 1)))
        if early:
            with _taken_apart(connection, "before"):
                make_before(connection, TABLE, first)
                _make_months(connection, TABLE, early)
        if late:
            with _taken_apart(connection, "after"):
                _make_months(connection, TABLE, late)
                _make_after(connection, TABLE, months_on(late[-1], 1))
    return early + late


@contextmanager
def _taken_apart(connection: Connection, part: str) -> Iterator[None]:
    """Take a partition away while others are made in its place, and put its results into these."""
    waiting = f"{TABLE}_waiting"
    connection.exec_driver_sql(f"ALTER TABLE {TABLE} DETACH PARTITION {TABLE}_{part}")
    connection.exec_driver_sql(f"ALTER TABLE {TABLE}_{part} RENAME TO {waiting}")
    yield
    with moved_only(connection):
        connection.exec_driver_sql(f"INSERT INTO {TABLE} SELECT * FROM {waiting}")  # noqa: S608 - our own names
    connection.exec_driver_sql(f"DROP TABLE {waiting}")


def lock(connection: Connection) -> None:
    """Let nobody else change partitions until the transaction ends, and wait for readers a few seconds only."""
    connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
    connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{LOCK_S}s'")


def months(connection: Connection) -> Sequence[date]:
    """Return the months that have a partition of their own, in order."""
    found = (_month(row.name) for row in connection.execute(text(_FOUND), {"parent": TABLE}))
    return sorted(month for month in found if month is not None)


def _bound(month: date) -> str:
    return f"'{month.isoformat()} 00:00:00+00'"


def _month(name: str) -> date | None:
    year, _, month = name.removeprefix(f"{TABLE}_").partition("_")
    return date(int(year), int(month), 1) if year.isdecimal() and month.isdecimal() else None
