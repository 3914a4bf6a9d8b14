"""Results into PostgreSQL by COPY: a batch goes into a temporary table at once, and from there to where it belongs."""

import struct
from collections.abc import Mapping, Sequence
from operator import itemgetter
from types import MappingProxyType
from typing import Final

from sqlalchemy import BigInteger, Connection, Double, SmallInteger, exc

from fleet_backend.database import place_of
from fleet_backend.errors import RowRefusedError
from fleet_backend.rows import Row
from fleet_backend.schema import KEY_COLUMNS, SHIFT_RESULT, UtcDateTime

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
_TAKE: Final = (
    f"INSERT INTO {SHIFT_RESULT.name} ({_COLUMNS})"  # noqa: S608 - our own names
    f" SELECT DISTINCT ON ({_ORDER}) {_COLUMNS} FROM {_STAGE} ORDER BY {_ORDER}, content_digest"
    f" ON CONFLICT ({_ORDER}) DO UPDATE SET "
    + ", ".join(f"{name} = excluded.{name}" for name in _NAMES if name not in _KEY)
    + f" WHERE excluded.content_digest < {SHIFT_RESULT.name}.content_digest"
)


def copy_results(connection: Connection, rows: Sequence[Row]) -> None:
    """Store results, each as often as it comes: of two contents under one key the one with the smaller digest stays.

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
            cursor.execute(_TAKE)
    except base as error:
        is_gone = dialect.is_disconnect(error, driver, None)
        if is_gone:
            connection.invalidate()
        raise exc.DBAPIError.instance(
            _COPY, None, error, base, connection_invalidated=is_gone, dialect=dialect
        ) from error
    except (OverflowError, TypeError, ValueError, struct.error) as error:
        raise RowRefusedError(f"database {place_of(connection.engine)}: {error}") from error
