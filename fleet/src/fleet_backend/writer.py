"""One transaction per batch: results, states and poison, each as often as it comes and in any order, with one outcome.

A result that is stored stays as it is. Of states the winner depends on what they say, not on who came first. Rows are
sorted by key, so that workers which write the same rows wait for each other instead of deadlocking.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from types import MappingProxyType
from typing import Final

from sqlalchemy import (
    BigInteger,
    Connection,
    Double,
    Engine,
    Insert,
    SmallInteger,
    Table,
    and_,
    delete,
    exc,
    false,
    or_,
    select,
    text,
    true,
)
from sqlalchemy.dialects import postgresql, sqlite

from fleet_backend.database import place_of, transaction
from fleet_backend.errors import RowRefusedError
from fleet_backend.rows import Row, message_fill
from fleet_backend.schema import (
    CALIBRATION,
    CLUTCH,
    FLUID_FILL,
    KEY_COLUMNS,
    QUARANTINE,
    REVISION,
    SHIFT_RESULT,
    VEHICLE,
    WITHDRAWN_FILL,
    UtcDateTime,
)
from fleet_contract import JsonObject

_STAGE: Final = "shift_stage"
_NAMES: Final = tuple(column.name for column in SHIFT_RESULT.columns if column.name != "stored_at")
_KEY: Final = (*KEY_COLUMNS, "produced_at")
_KINDS: Final[Mapping[type, str]] = MappingProxyType(
    {BigInteger: "int8", SmallInteger: "int2", Double: "float8", UtcDateTime: "timestamptz"}
)
_TYPES: Final = tuple(_KINDS.get(type(SHIFT_RESULT.c[name].type), "text") for name in _NAMES)
_VALUES_OF: Final = itemgetter(*_NAMES)  # a tuple
_COLUMNS: Final = ", ".join(_NAMES)
# Gone with the transaction, its rows at least: whoever pools connections may hand it to another worker meanwhile.
_MAKE: Final = (
    f"CREATE TEMPORARY TABLE IF NOT EXISTS {_STAGE} (LIKE {SHIFT_RESULT.name} INCLUDING DEFAULTS) ON COMMIT DELETE ROWS"
)
_COPY: Final = f"COPY {_STAGE} ({_COLUMNS}) FROM STDIN (FORMAT BINARY)"
_ORDER: Final = ", ".join(_KEY)
# By months another time of making is another key: such rivals are looked for, in all months, of what comes late alone.
_RIVALS: Final = (
    f"{_STAGE} AS s CROSS JOIN LATERAL (SELECT r.* FROM {SHIFT_RESULT.name} AS r"  # noqa: S608 - our own names
    " WHERE (r.vehicle, r.stream, r.seq, r.version_rank) = (s.vehicle, s.stream, s.seq, s.version_rank)"
    " AND r.produced_at <> s.produced_at AND s.seq <= (SELECT max(e.last_seq) FROM clutch_stream AS e"
    " WHERE e.vehicle = s.vehicle AND e.stream = s.stream) OFFSET 0) AS r"
)
_HAS_RIVALS: Final = f"SELECT EXISTS (SELECT FROM {_RIVALS})"  # noqa: S608
_IDENTITY: Final = (*KEY_COLUMNS, "content_digest")  # of a result and its content
_IDENTITIES: Final = ", ".join(f"s.{name}" for name in _IDENTITY)
_YIELD: Final = f"DELETE FROM {_STAGE} AS t USING {_RIVALS} WHERE t.ctid = s.ctid RETURNING {_IDENTITIES}"  # noqa: S608
_TAKE: Final = (
    f"INSERT INTO {SHIFT_RESULT.name} ({_COLUMNS})"  # noqa: S608 - our own names
    f" SELECT DISTINCT ON ({', '.join(KEY_COLUMNS)}) {_COLUMNS} FROM {_STAGE}"
    f" ORDER BY {', '.join(KEY_COLUMNS)}, ctid ON CONFLICT ({_ORDER}) DO NOTHING"
)
_LEFT: Final = (
    f"SELECT {_IDENTITIES} FROM {_STAGE} AS s WHERE NOT EXISTS (SELECT FROM {SHIFT_RESULT.name} AS r"  # noqa: S608
    f" WHERE r.produced_at = s.produced_at AND {' AND '.join(f'r.{name} = s.{name}' for name in _IDENTITY)})"
)
_STORED: Final = text(  # an index look-up for each; of a list of rows SQLite makes a scan of the table
    f"SELECT {_IDENTITIES} FROM json_each(:identities) AS j CROSS JOIN {SHIFT_RESULT.name} AS s WHERE "  # noqa: S608
    + " AND ".join(f"s.{name} = json_extract(j.value, '$[{place}]')" for place, name in enumerate(KEY_COLUMNS))
)
Identity = tuple[object, ...]


def identity_of(row: Row) -> Identity:
    """Return what tells a result and its content from all others."""
    return tuple(row[name] for name in _IDENTITY)


def copy_results(connection: Connection, rows: Sequence[Row]) -> set[Identity]:
    """Store results, each as often as it comes; return those under whose key another content came first.

    Raises
    ------
    RowRefusedError
        If a value has no place in its column.
    sqlalchemy.exc.DBAPIError
        Of its kind, if the database refuses the rows or goes away.
    """
    driver = connection.connection.driver_connection
    if driver is None:  # SQLAlchemy's type allows it; a connection in a transaction has one
        raise RowRefusedError("no connection")
    dialect = connection.dialect
    base = dialect.loaded_dbapi.Error
    try:
        with driver.cursor() as cursor:
            cursor.execute(_MAKE)
            with cursor.copy(_COPY) as copy:
                copy.set_types(_TYPES)
                for row in rows:
                    copy.write_row(_VALUES_OF(row))
            has_rivals = cursor.execute(_HAS_RIVALS).fetchone()[0]
            aside = set(cursor.execute(_YIELD).fetchall()) if has_rivals else set()
            if cursor.execute(_TAKE).rowcount + len(aside) < len(rows):  # some came before
                aside |= set(cursor.execute(_LEFT).fetchall())
            return aside
    except base as error:
        is_gone = dialect.is_disconnect(error, driver, None)
        if is_gone:
            connection.invalidate()
        raise exc.DBAPIError.instance(
            _COPY, None, error, base, connection_invalidated=is_gone, dialect=dialect
        ) from error
    except (OverflowError, TypeError, ValueError, struct.error) as error:
        raise RowRefusedError(f"database {place_of(connection.engine)}: {error}") from error


_KEPT: Final = (VEHICLE, CALIBRATION, REVISION, CLUTCH, FLUID_FILL, WITHDRAWN_FILL, QUARANTINE)
_MAX_KNOWN: Final = 100_000  # clutches that a worker remembers to have stored


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Rows that are stored together."""

    shifts: Sequence[Row] = ()
    statuses: Sequence[Row] = ()
    calibrations: Sequence[Row] = ()
    revisions: Sequence[Row] = ()
    metrics: Sequence[Row] = ()
    controllers: Sequence[Row] = ()
    fills: Sequence[Row] = ()
    quarantined: Sequence[Row] = ()


class Writer:
    """Stores batches; one per thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._known: set[tuple[object, object]] = set()
        make = postgresql.insert if engine.dialect.name == "postgresql" else sqlite.insert
        self._status = _later_status_wins(make(VEHICLE))
        self._metrics = _later_wins(make(VEHICLE), "metrics")
        self._controller = _later_wins(make(VEHICLE), "controller")
        self._first_comes = {table.name: make(table).on_conflict_do_nothing() for table in (SHIFT_RESULT, *_KEPT)}

    def store(self, batch: Batch) -> set[Identity]:
        """Store a batch, all of it or nothing; return the results that another of the same key keeps out.

        Raises
        ------
        DatabaseAwayError
            If the database does not answer now; nothing was stored.
        RowRefusedError
            If the database does not take one of the rows; nothing was stored.
        """
        try:
            return self._store(batch)
        except RowRefusedError:
            if not self._known:
                raise
            self._known.clear()  # another database under the old address may not know our clutches
            return self._store(batch)

    def fills(self, vehicles: Sequence[str]) -> dict[str, list[JsonObject]]:
        """Return the fluid fills of those vehicles that have any, the earliest first, as messages carry them.

        Raises DatabaseAwayError if the database does not answer now.
        """
        fills: dict[str, list[JsonObject]] = {}
        with transaction(self._engine) as connection:
            for table in (FLUID_FILL, WITHDRAWN_FILL):
                statement = select(table).where(table.c.vehicle.in_(vehicles)).order_by(table.c.filled_at)
                for row in connection.execute(statement).mappings():
                    fills.setdefault(str(row["vehicle"]), []).append(message_fill(dict(row)))
        return fills

    def _store(self, batch: Batch) -> set[Identity]:
        names = {(row["vehicle"], row["clutch"]): row["element"] for row in batch.shifts}
        clutches = names.keys() - self._known
        vehicles = {vehicle for vehicle, _ in clutches} | {row["vehicle"] for row in batch.fills}
        with transaction(self._engine) as connection:
            self._put(connection, VEHICLE, [{"vehicle": vehicle} for vehicle in sorted(map(str, vehicles))])
            self._put(
                connection,
                CLUTCH,
                [{"vehicle": v, "clutch": c, "element": names[v, c]} for v, c in sorted(clutches, key=str)],
            )
            _execute(connection, self._status, _sorted(batch.statuses, "vehicle"))
            self._put(connection, CALIBRATION, _sorted(batch.calibrations, "vehicle", "calibration_version"))
            _execute(connection, self._metrics, _sorted(batch.metrics, "vehicle"))
            _execute(connection, self._controller, _sorted(batch.controllers, "vehicle"))
            aside = self._put_results(connection, batch.shifts)
            revisions = batch.revisions
            if aside:
                stored = set(map(identity_of, batch.shifts)) - aside
                gone = {identity[:3] for identity in aside} - {identity[:3] for identity in stored}
                revisions = [row for row in revisions if (row["vehicle"], row["stream"], row["seq"]) not in gone]
            self._put(connection, REVISION, _sorted(revisions, *REVISION.primary_key.columns.keys()))
            self._put_fills(connection, _sorted(batch.fills, "vehicle", "filled_at"))
            self._put(connection, QUARANTINE, _sorted(batch.quarantined, "digest"))
        if len(self._known) > _MAX_KNOWN:
            self._known.clear()
        self._known |= clutches
        return aside

    def _put_results(self, connection: Connection, rows: Sequence[Row]) -> set[Identity]:
        """Store results; return those under whose key another content came first."""
        if not rows:
            return set()
        if connection.dialect.name == "postgresql":
            return copy_results(connection, rows)
        counted = connection.execution_options(preserve_rowcount=True)
        if counted.execute(self._first_comes[SHIFT_RESULT.name], _sorted(rows, *KEY_COLUMNS)).rowcount == len(rows):
            return set()
        identities = set(map(identity_of, rows))
        stored = connection.execute(_STORED, {"identities": json.dumps(list(identities))})
        return identities.difference(map(tuple, stored))

    def _put_fills(self, connection: Connection, rows: Sequence[Row]) -> None:
        """Store fills; those that anybody has taken back go, whoever still knows them."""
        self._put(connection, WITHDRAWN_FILL, [row for row in rows if "product" not in row])
        self._put(connection, FLUID_FILL, [row for row in rows if "product" in row])
        for vehicle in {row["vehicle"] for row in rows}:
            gone = select(WITHDRAWN_FILL.c.filled_at).where(WITHDRAWN_FILL.c.vehicle == vehicle)
            is_gone = (FLUID_FILL.c.vehicle == vehicle, FLUID_FILL.c.filled_at.in_(gone))
            connection.execute(delete(FLUID_FILL).where(*is_gone))

    def _put(self, connection: Connection, table: Table, rows: list[Row]) -> None:
        _execute(connection, self._first_comes[table.name], rows)


def _execute(connection: Connection, statement: Insert, rows: list[Row]) -> None:
    if rows:
        connection.execute(statement, rows)


def _sorted(rows: Sequence[Row], *names: str) -> list[Row]:
    return sorted(rows, key=lambda row: tuple(str(row[name]) for name in names))


def _later_status_wins(insert: "postgresql.Insert | sqlite.Insert") -> Insert:
    """Let a later connection tell more than an earlier one, and its end more than its beginning."""
    new, known = insert.excluded, VEHICLE.c
    names = ("is_online", "connected_at", "service_version", "algorithm_version", "calibration_version")
    ends = and_(new.connected_at == known.connected_at, new.is_online == false(), known.is_online == true())
    return insert.on_conflict_do_update(
        index_elements=["vehicle"],
        set_={name: new[name] for name in names},
        where=or_(known.connected_at.is_(None), new.connected_at > known.connected_at, ends),
    )


def _later_wins(insert: "postgresql.Insert | sqlite.Insert", name: str) -> Insert:
    """Keep what was said last of what a vehicle says now and then; a column beside it tells when that was."""
    new, known = insert.excluded, VEHICLE.c
    at = f"{name}_at"
    return insert.on_conflict_do_update(
        index_elements=["vehicle"],
        set_={name: new[name], at: new[at]},
        where=or_(known[at].is_(None), new[at] > known[at]),
    )
