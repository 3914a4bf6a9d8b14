"""Where results are: two tables beside them by which PostgreSQL finds the few months that a question needs.

``clutch_stream`` has a row per clutch and stream: how many results, and which is the last. ``clutch_block`` has a row
for whatever there is in a block of positions: clutch, month, version, verdict. Triggers keep them, whoever writes; each
row depends on what results say, never on who came first. What they must be is what `FILL` makes of all results.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, time, timedelta
from typing import Final

from sqlalchemy import Connection, and_, column, func, select, table, text

from fleet_backend.schema import UtcDateTime

TABLE: Final = "shift_result"
BLOCK: Final = 1024  # positions of a stream
_NO_VERSION: Final = "''"  # what was replaced may have said something else: two versions are nothing certain
_STREAM: Final = "vehicle, clutch, stream"
_LAST: Final = "last_seq, last_version_rank, last_produced_at, last_digest"
_MONTH: Final = "CAST(date_trunc('month', n.produced_at AT TIME ZONE 'UTC') AS date)"
CLUTCH_STREAM: Final = table(
    "clutch_stream",
    *(column(name) for name in ("vehicle", "clutch", "stream", "result_count", "last_seq")),
    *(column(name, UtcDateTime) for name in ("last_at", "last_stored_at")),
)
CLUTCH_BLOCK: Final = table(
    "clutch_block", *(column(name) for name in ("vehicle", "stream", "block", "month", "version_rank"))
)
MAKE: Final = (
    f"""
CREATE TABLE clutch_stream (
  vehicle text, clutch smallint, stream text COLLATE "C",
  result_count bigint NOT NULL, last_at timestamptz NOT NULL, last_stored_at timestamptz NOT NULL,
  last_seq bigint NOT NULL, last_version_rank text COLLATE "C" NOT NULL, last_produced_at timestamptz NOT NULL,
  last_digest bigint NOT NULL,
  PRIMARY KEY ({_STREAM}), FOREIGN KEY (vehicle, clutch) REFERENCES clutch (vehicle, clutch)
) WITH (fillfactor = 70)
""",
    """
CREATE TABLE clutch_block (
  vehicle text, stream text COLLATE "C", block bigint, clutch smallint, month date, version_rank text COLLATE "C",
  condition text, PRIMARY KEY (vehicle, stream, block, clutch, month, version_rank, condition)
)
""",
    "CREATE INDEX clutch_block_alarming ON clutch_block (vehicle) WHERE condition = 'change_fluid'",
)


def _streams(source: str, count: str = "count(*) OVER w") -> str:
    """Return the statement for the rows of ``clutch_stream`` that results make."""
    return (
        f"SELECT DISTINCT ON (n.vehicle, n.clutch, n.stream) n.vehicle, n.clutch, n.stream, {count},"  # noqa: S608
        " max(least(n.produced_at, n.stored_at)) OVER w,"  # a clock that is ahead orders nothing
        " max(n.stored_at) OVER w, n.seq, n.version_rank, n.produced_at, n.content_digest"
        f" FROM {source} AS n WINDOW w AS (PARTITION BY n.vehicle, n.clutch, n.stream)"
        " ORDER BY n.vehicle, n.clutch, n.stream, n.seq DESC, n.version_rank DESC, n.content_digest"
    )


def _blocks(source: str, rank: str = "n.version_rank") -> str:
    """Return the statement for the rows of ``clutch_block`` that results make."""
    return (
        f"SELECT DISTINCT n.vehicle, n.stream, n.seq / {BLOCK}, n.clutch, {_MONTH}, {rank}, n.condition"  # noqa: S608
        f" FROM {source} AS n ORDER BY 1, 2, 3, 4, 5, 6, 7"
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
_INTO_BLOCKS: Final = "INSERT INTO clutch_block "
FILL: Final = (_INTO_STREAMS + _streams(TABLE), _INTO_BLOCKS + _blocks(TABLE))
_LEFT: Final = f"(SELECT s.* FROM {TABLE} AS s WHERE s.vehicle IN (SELECT vehicle FROM gone))"  # noqa: S608
_CAME: Final = f"""
CREATE OR REPLACE FUNCTION shift_result_came() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  {_INTO_STREAMS} {_streams("fresh", "CASE TG_OP WHEN 'INSERT' THEN count(*) OVER w ELSE 0 END")} {_JOIN};
  {_INTO_BLOCKS} {_blocks("fresh")} ON CONFLICT DO NOTHING;
  IF TG_OP = 'UPDATE' THEN
    {_INTO_BLOCKS} {_blocks("fresh", _NO_VERSION)} ON CONFLICT DO NOTHING;
  END IF;
  RETURN NULL;
END $$
"""
_WENT: Final = f"""
CREATE OR REPLACE FUNCTION shift_result_went() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  DELETE FROM clutch_stream WHERE vehicle IN (SELECT vehicle FROM gone);
  DELETE FROM clutch_block WHERE vehicle IN (SELECT vehicle FROM gone);
  {_INTO_STREAMS} {_streams(_LEFT)};
  {_INTO_BLOCKS} {_blocks(_LEFT)};
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
    "DELETE FROM clutch_block WHERE month < :month",
    f"{_INTO_BLOCKS}{_blocks('kept')} ON CONFLICT DO NOTHING",
)


def months_with(connection: Connection, vehicle: str, stream: str, seq: int) -> tuple[datetime, datetime] | None:
    """Return when the first month begins and the last ends in which results near a position are; None without any."""
    block = CLUTCH_BLOCK.c
    here = and_(block.vehicle == vehicle, block.stream == stream, block.block == seq // BLOCK)
    first, last = connection.execute(select(func.min(block.month), func.max(block.month)).where(here)).one()
    if first is None:
        return None
    after = last.replace(day=28) + timedelta(days=4)  # some day of the month after it
    return datetime.combine(first, time(), UTC), datetime.combine(after.replace(day=1), time(), UTC)


def note_going(connection: Connection, edge: datetime) -> None:
    """Count the results from before a moment that are not in the temporary table ``kept``; `forget` needs it."""
    connection.execute(text(_GONE), {"edge": edge})


def forget(connection: Connection, edge: datetime) -> None:
    """Bring both tables to what is left once the results counted by `note_going`, of whole months, are gone."""
    for statement in _FORGET:
        known = {"edge": edge, "month": edge.astimezone(UTC).date()}
        connection.execute(text(statement), {name: value for name, value in known.items() if f":{name}" in statement})


@contextmanager
def moved_only(connection: Connection) -> Iterator[None]:
    """Let results move from one part to another: neither more nor other ones."""
    connection.exec_driver_sql(f"ALTER TABLE {TABLE} DISABLE TRIGGER USER")
    yield
    connection.exec_driver_sql(f"ALTER TABLE {TABLE} ENABLE TRIGGER USER")
