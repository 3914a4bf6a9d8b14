"""Results of one PostgreSQL table move into months: in batches that can be interrupted, while others read and write.

A trigger repeats in the new table what is written into the old one; a batch takes the next rows in the order of their
keys and notes the last. When all are there, the new table takes the name of the old.
"""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import Connection, Engine, inspect, text

from fleet_backend.database import transaction
from fleet_backend.months.partitions import AHEAD_MONTHS, LOCK_S, TABLE, make_partitions, month_of, months_on

BATCH_ROWS: Final = 20_000
NEW: Final = "shift_result_by_month"
KEY: Final = ("vehicle", "stream", "seq", "version_rank")
_PROGRESS: Final = "shift_result_move"
_MOST_PAST: Final = 60  # months of their own; a clock without a battery says 1970
_INDEXES: Final = {
    "shift_by_time": "(vehicle, clutch, produced_at, stream)",
    "shift_by_arrival": "(stored_at)",
    "shift_alarming": "(vehicle, clutch) WHERE condition = 'change_fluid'",
}
_KEY_TEXT: Final = ", ".join(KEY)


def move_all(engine: Engine, tell: Callable[[int], None], batch_rows: int = BATCH_ROWS) -> None:
    """Copy all results that are not yet in the new table; killed, the next call goes on where this one was.

    Parameters
    ----------
    tell : callable
        Hears after each batch how many results have moved so far.

    Raises
    ------
    DatabaseAwayError
        If the database does not answer.
    """
    with transaction(engine) as connection:
        prepare(connection)
    count = 1
    while count:
        with transaction(engine) as connection:
            count, moved_count = move_some(connection, batch_rows)
        if count:
            tell(moved_count)


def prepare(connection: Connection) -> None:
    """Make the new table, the trigger that fills it and the note of how far the move is, unless they are there."""
    if inspect(connection).has_table(_PROGRESS):
        return
    connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{LOCK_S}s'")
    earliest = connection.exec_driver_sql(f"SELECT min(produced_at) FROM {TABLE}").scalar()  # noqa: S608
    this = month_of(datetime.now(UTC))
    first = min(this, max(months_on(this, -_MOST_PAST), this if earliest is None else month_of(earliest)))
    connection.exec_driver_sql(f"CREATE TABLE {NEW} (LIKE {TABLE} INCLUDING DEFAULTS) PARTITION BY RANGE (produced_at)")
    make_partitions(connection, NEW, first, months_on(this, AHEAD_MONTHS + 1))
    connection.exec_driver_sql(f"ALTER TABLE {NEW} ADD PRIMARY KEY ({_KEY_TEXT}, produced_at)")
    connection.exec_driver_sql(
        f"ALTER TABLE {NEW} ADD FOREIGN KEY (vehicle, clutch) REFERENCES clutch (vehicle, clutch)"
    )
    for name, columns in _INDEXES.items():
        connection.exec_driver_sql(f"CREATE INDEX {name}_new ON {NEW} {columns}")
    connection.exec_driver_sql(
        f"CREATE TABLE {_PROGRESS} AS SELECT {_KEY_TEXT}, 0::bigint AS moved_count FROM {TABLE} WITH NO DATA"  # noqa: S608
    )
    connection.exec_driver_sql(
        f"INSERT INTO {_PROGRESS} (vehicle, stream, seq, version_rank, moved_count) VALUES ('', '', 0, '', 0)"  # noqa: S608
    )
    _follow(connection)


def move_some(connection: Connection, limit: int | None) -> tuple[int, int]:
    """Copy the next results; return how many these were, and how many have moved in all."""
    rows = "" if limit is None else f"LIMIT {limit}"
    done = f"SELECT {_KEY_TEXT} FROM {_PROGRESS}"  # noqa: S608 - our own names, in this and what follows
    behind = f"FROM {TABLE} WHERE ({_KEY_TEXT}) > ({done})"
    order = ", ".join(f"{name} DESC" for name in KEY)
    last = connection.exec_driver_sql(
        f"SELECT {_KEY_TEXT}, count(*) OVER () AS row_count"  # noqa: S608
        f" FROM (SELECT {_KEY_TEXT} {behind} ORDER BY {_KEY_TEXT} {rows}) AS next ORDER BY {order} LIMIT 1"
    ).first()
    if last is not None:
        names = {name: last[place] for place, name in enumerate(KEY)}
        places = ", ".join(f":{name}" for name in KEY)
        until = f"({_KEY_TEXT}) <= ({places})"
        statement = f"INSERT INTO {NEW} SELECT * {behind} AND {until} ON CONFLICT DO NOTHING"
        connection.execute(text(statement), names)
        statement = f"UPDATE {_PROGRESS} SET ({_KEY_TEXT}, moved_count) = ({places}, moved_count + :row_count)"  # noqa: S608
        connection.execute(text(statement), {**names, "row_count": last.row_count})
    moved_count = connection.exec_driver_sql(f"SELECT moved_count FROM {_PROGRESS}").scalar_one()  # noqa: S608
    return 0 if last is None else int(last.row_count), int(moved_count)


def swap(connection: Connection) -> None:
    """Let the new table take the place of the old one, on which no view may stand any more."""
    connection.exec_driver_sql(f"DROP TABLE {TABLE}, {_PROGRESS}")
    connection.exec_driver_sql("DROP FUNCTION shift_result_follow()")
    connection.exec_driver_sql(f"ALTER TABLE {NEW} RENAME TO {TABLE}")
    for name in _INDEXES:
        connection.exec_driver_sql(f"ALTER INDEX {name}_new RENAME TO {name}")


def _follow(connection: Connection) -> None:
    """Repeat in the new table whatever is written into the old one."""
    columns: Sequence[str] = [column["name"] for column in inspect(connection).get_columns(TABLE)]
    others = ", ".join(f"{name} = excluded.{name}" for name in columns if name not in (*KEY, "produced_at"))
    same = " AND ".join(f"{name} = OLD.{name}" for name in (*KEY, "produced_at"))
    connection.exec_driver_sql(
        "CREATE FUNCTION shift_result_follow() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN"  # noqa: S608
        f" IF TG_OP <> 'INSERT' THEN DELETE FROM {NEW} WHERE {same}; END IF;"
        " IF TG_OP = 'DELETE' THEN RETURN NULL; END IF;"
        f" INSERT INTO {NEW} SELECT NEW.* ON CONFLICT ({_KEY_TEXT}, produced_at) DO UPDATE SET {others};"
        " RETURN NULL; END $$"
    )
    connection.exec_driver_sql(
        f"CREATE TRIGGER shift_result_follow AFTER INSERT OR UPDATE OR DELETE ON {TABLE}"
        " FOR EACH ROW EXECUTE FUNCTION shift_result_follow()"
    )
