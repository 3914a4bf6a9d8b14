"""Results in PostgreSQL, one partition for each month of their making, without a gap: before, the months, after.

No partition is a default one: PostgreSQL then knows that they follow each other, and finds the newest result of a
clutch in the newest month without a look at the others. A result that no month takes is in the first or the last.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, date, datetime
from typing import Final

from sqlalchemy import Connection, Engine, column, table, text

from fleet_backend.database import transaction
from fleet_backend.errors import BackendConfigError
from fleet_backend.schema import KEY_COLUMNS, RANKED_AT, UtcDateTime

AHEAD_MONTHS: Final = 3  # kept ready, so that a forgotten command costs a quarter before results gather in the last
MOST_MONTHS: Final = 120
LOCK_S: Final = 5  # new partitions need all to themselves for a moment; whoever reads long is not waited for longer
_LOCK: Final = 0x434C4450  # PostgreSQL's advisory lock of whoever makes partitions: "CLDP"
_PARTITIONS: Final = """
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


def _make_months(connection: Connection, table: str, months: Iterable[date]) -> None:
    for month in months:
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
        parts = [
            Partition(name=row.name, month=_month(row.name), size_bytes=row.size_bytes, row_estimate=row.row_estimate)
            for row in connection.execute(text(_PARTITIONS), {"parent": TABLE})
        ]
    return sorted(parts, key=lambda part: (part.name.endswith("_after"), part.month or date.min))


def keep_months(engine: Engine, now: datetime, ahead: int = AHEAD_MONTHS, back: int = 0) -> list[date]:
    """Make the months from ``back`` months ago until ``ahead`` months from now that are missing; return them.

    Results that waited in the first or last partition move into their months. Raises ConfigError if the database has no
    partitions, DatabaseAwayError if somebody reads too long: try again, nothing was changed.
    """
    if not has_partitions(engine):
        raise BackendConfigError("only a PostgreSQL database has partitions; SQLite keeps all results in one table")
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
    named = (_month(row.name) for row in connection.execute(text(_PARTITIONS), {"parent": TABLE}))
    return sorted(month for month in named if month is not None)


def _bound(month: date) -> str:
    return f"'{month.isoformat()} 00:00:00+00'"


def _month(name: str) -> date | None:
    year, _, month = name.removeprefix(f"{TABLE}_").partition("_")
    return date(int(year), int(month), 1) if year.isdecimal() and month.isdecimal() else None


TABLE: Final = "shift_result"
_RANKED_AT: Final = RANKED_AT["postgresql"]
_STREAM: Final = "vehicle, clutch, stream"
_LAST: Final = "last_seq, last_version_rank, last_produced_at, last_digest"
CLUTCH_STREAM: Final = table(
    "clutch_stream",
    *(column(name) for name in ("vehicle", "clutch", "stream", "result_count", "last_seq")),
    *(column(name, UtcDateTime) for name in ("last_at", "last_stored_at")),
)
MAKE: Final = (
    f"ALTER TABLE {TABLE} ADD PRIMARY KEY ({', '.join(KEY_COLUMNS)}, produced_at)",
    f"""
CREATE TABLE clutch_stream (
  vehicle text, clutch smallint, stream text COLLATE "C",
  result_count bigint NOT NULL, last_at timestamptz NOT NULL, last_stored_at timestamptz NOT NULL,
  last_seq bigint NOT NULL, last_version_rank text COLLATE "C" NOT NULL, last_produced_at timestamptz NOT NULL,
  last_digest bigint NOT NULL,
  PRIMARY KEY ({_STREAM}), FOREIGN KEY (vehicle, clutch) REFERENCES clutch (vehicle, clutch)
) WITH (fillfactor = 70)
""",
)


def _streams(source: str, count: str = "count(*) OVER w") -> str:
    """Return the statement for the rows of ``clutch_stream`` that results make."""
    return (
        f"SELECT DISTINCT ON (n.vehicle, n.clutch, n.stream) n.vehicle, n.clutch, n.stream, {count},"  # noqa: S608
        f" max({_RANKED_AT.format('n.')}) OVER w,"
        " max(n.stored_at) OVER w, n.seq, n.version_rank, n.produced_at, n.content_digest"
        f" FROM {source} AS n WINDOW w AS (PARTITION BY n.vehicle, n.clutch, n.stream)"
        " ORDER BY n.vehicle, n.clutch, n.stream, n.seq DESC, n.version_rank DESC, n.content_digest"
    )


_LATER: Final = (
    "((excluded.last_seq, excluded.last_version_rank) > (e.last_seq, e.last_version_rank)"
    " OR (excluded.last_seq, excluded.last_version_rank) = (e.last_seq, e.last_version_rank)"
    " AND excluded.last_digest < e.last_digest)"
)
_JOIN: Final = (
    f" ON CONFLICT ({_STREAM}) DO UPDATE SET result_count = e.result_count + excluded.result_count,"
    " last_at = greatest(e.last_at, excluded.last_at),"
    " last_stored_at = greatest(e.last_stored_at, excluded.last_stored_at), "
    + ", ".join(f"{name} = CASE WHEN {_LATER} THEN excluded.{name} ELSE e.{name} END" for name in _LAST.split(", "))
)
_INTO_STREAMS: Final = f"INSERT INTO clutch_stream AS e ({_STREAM}, result_count, last_at, last_stored_at, {_LAST}) "
RANK: Final = (
    f"UPDATE clutch_stream AS e SET last_at = s.at FROM (SELECT {_STREAM}, max({_RANKED_AT.format('')}) AS at"  # noqa: S608
    f" FROM {TABLE} GROUP BY {_STREAM}) AS s WHERE s.at <> e.last_at"
    " AND s.vehicle = e.vehicle AND s.clutch = e.clutch AND s.stream = e.stream"
)
_LEFT: Final = f"(SELECT s.* FROM {TABLE} AS s WHERE s.vehicle IN (SELECT vehicle FROM gone))"  # noqa: S608
_CAME: Final = f"""
CREATE OR REPLACE FUNCTION shift_result_came() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  {_INTO_STREAMS} {_streams("fresh", "CASE TG_OP WHEN 'INSERT' THEN count(*) OVER w ELSE 0 END")} {_JOIN};
  RETURN NULL;
END $$
"""
_WENT: Final = f"""
CREATE OR REPLACE FUNCTION shift_result_went() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  DELETE FROM clutch_stream WHERE vehicle IN (SELECT vehicle FROM gone);
  {_INTO_STREAMS} {_streams(_LEFT)};
  RETURN NULL;
END $$
"""  # noqa: S608 - our own names, in this and what follows
# A trigger per statement, not per row: a batch of hundreds of results touches a few streams.
_TRIGGERS: Final = tuple(
    f"CREATE TRIGGER shift_result_{word} AFTER {event} ON {TABLE} REFERENCING {rows} FOR EACH STATEMENT"
    f" EXECUTE FUNCTION shift_result_{function}()"
    for word, event, rows, function in (
        ("came", "INSERT", "NEW TABLE AS fresh", "came"),
        ("changed", "UPDATE", "NEW TABLE AS fresh", "came"),
        ("went", "DELETE", "OLD TABLE AS gone", "went"),
    )
)
FUNCTIONS: Final = (_CAME, _WENT)
FOLLOW: Final = (*FUNCTIONS, *_TRIGGERS)
_GONE: Final = f"""
CREATE TEMPORARY TABLE gone ON COMMIT DROP AS
SELECT {_STREAM}, sum(part) AS gone_count FROM (
  SELECT {_STREAM}, 1 AS part FROM {TABLE} WHERE produced_at < :edge
  UNION ALL SELECT {_STREAM}, -1 FROM kept
) AS parts GROUP BY {_STREAM}
"""  # noqa: S608 - our own names, in this and what follows
_OLD: Final = "last_at < :edge OR last_produced_at < :edge"
_STILL_THERE: Final = f"(SELECT s.* FROM old AS o JOIN {TABLE} AS s USING ({_STREAM}))"  # noqa: S608
_FORGET: Final = (
    """
UPDATE clutch_stream AS e SET result_count = e.result_count - g.gone_count FROM gone AS g
WHERE g.vehicle = e.vehicle AND g.clutch = e.clutch AND g.stream = e.stream
""",
    f"CREATE TEMPORARY TABLE old ON COMMIT DROP AS SELECT {_STREAM} FROM clutch_stream WHERE {_OLD}",  # noqa: S608
    f"DELETE FROM clutch_stream WHERE {_OLD}",  # noqa: S608
    _INTO_STREAMS + _streams(_STILL_THERE),
)


def note_going(connection: Connection, edge: datetime) -> None:
    """Count the results from before a moment that are not in the temporary table ``kept``; `forget` needs it."""
    connection.execute(text(_GONE), {"edge": edge})


def forget(connection: Connection, edge: datetime) -> None:
    """Bring `CLUTCH_STREAM` to what is left once the results counted by `note_going`, of whole months, are gone."""
    for statement in _FORGET:
        connection.execute(text(statement), {"edge": edge} if ":edge" in statement else {})


@contextmanager
def moved_only(connection: Connection) -> Iterator[None]:
    """Let results move from one part to another: neither more nor other ones."""
    connection.exec_driver_sql(f"ALTER TABLE {TABLE} DISABLE TRIGGER USER")
    yield
    connection.exec_driver_sql(f"ALTER TABLE {TABLE} ENABLE TRIGGER USER")
