"""The database itself: opened by its address, made durable, its errors translated."""

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from sqlite3 import SQLITE_CORRUPT, SQLITE_ERROR, SQLITE_NOTADB
from sqlite3 import Connection as SqliteConnection
from typing import Any, Final

from sqlalchemy import URL, Connection, Engine, create_engine, event, exc, make_url

from clutchdiag_io.files import create_private, keep_private
from fleet_backend.errors import BackendConfigError, DatabaseAwayError, DatabaseError, RowRefusedError

_DAMAGED: Final = frozenset({SQLITE_NOTADB, SQLITE_CORRUPT})
_NOT_OURS: Final = _DAMAGED | {SQLITE_ERROR}  # no pause puts these right
_IN_MEMORY: Final = frozenset({None, "", ":memory:"})
_BUSY_TIMEOUT_S: Final = 30  # two workers share one SQLite file
_POSTGRES_OPTIONS: Final = {  # a server that vanished is known after half a minute, not after two hours
    "connect_timeout": 5,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "application_name": "fleet-backend",
}


def default_database() -> str:
    """Return the address of the embedded database: a file in the user's state directory."""
    home = os.environ.get("XDG_STATE_HOME", "")
    state = Path(home) if Path(home).is_absolute() else Path.home() / ".local" / "state"
    return f"sqlite:///{state / 'clutchdiag' / 'fleet.sqlite'}"


def open_database(address: str, *, must_exist: bool = False, is_read_only: bool = False) -> Engine:
    """Return an engine for ``sqlite:///FILE`` or ``postgresql://[user[:password]@]host[:port]/NAME``.

    Nothing is connected yet, but an SQLite file is made, with its folder, unless it ``must_exist``. Who reads only
    keeps no writer waiting, and the database refuses what would write.

    Raises
    ------
    ConfigError
        If the address is none; the message does not repeat it, since it may hold a password.
    DatabaseError
        If there is no such file.
    """
    try:
        url = make_url(address)
        backend = url.get_backend_name()
    except exc.ArgumentError as error:
        raise BackendConfigError("the database must be sqlite:///FILE or postgresql://host/NAME") from error
    if backend == "sqlite":
        return _open_sqlite(url, must_exist=must_exist, is_read_only=is_read_only)
    if backend == "postgresql":
        return _open_postgres(url, is_read_only=is_read_only)
    raise BackendConfigError(f"the database must be SQLite or PostgreSQL, not {backend}")


def place_of(engine: Engine) -> str:
    """Return where a database is, for people; without its password."""
    if engine.dialect.name == "sqlite":  # whose file may have a name that is no text
        return f"sqlite:///{engine.url.database or ''}"
    return engine.url.render_as_string(hide_password=True)


def close_to_others(engine: Engine) -> None:
    """Let nobody but its owner read an SQLite database, which must be ours; a server sees to that itself."""
    if engine.dialect.name == "sqlite" and engine.url.database not in _IN_MEMORY:
        keep_private(Path(str(engine.url.database)))


@contextmanager
def transaction(engine: Engine) -> Iterator[Connection]:
    """Run one transaction; a failure takes all of it back.

    Raises
    ------
    DatabaseAwayError
        If the database does not answer, is locked or full, or took another transaction's side: try again.
    RowRefusedError
        If it does not take the values.
    DatabaseError
        If tables are missing or forbidden, or what others made of ours is in the way.
    """
    with translated(engine), engine.begin() as connection:
        yield connection


@contextmanager
def translated(engine: Engine) -> Iterator[None]:
    """Translate the errors of the database's driver."""
    try:
        yield
    except exc.DBAPIError as error:
        text = f"database {place_of(engine)}: {_first_line(error)}"
        state = str(getattr(error.orig, "sqlstate", ""))  # of PostgreSQL; class 2B: others' objects stand on ours
        if isinstance(error, exc.ProgrammingError) or state.startswith("2B") or _sqlite_code(error) in _NOT_OURS:
            advice = "; it is damaged, put a backup in its place" if _sqlite_code(error) in _DAMAGED else ""
            raise DatabaseError(f"{text}{advice}") from error
        refused = RowRefusedError if isinstance(error, exc.IntegrityError | exc.DataError) else DatabaseAwayError
        raise refused(text) from error
    except UnicodeDecodeError as error:  # SQLite's own words about it are no text
        raise DatabaseError(f"database {place_of(engine)}: damaged; put a backup in its place") from error
    except exc.StatementError as error:  # a value that the driver cannot even send
        raise RowRefusedError(f"database {place_of(engine)}: {_first_line(error)}") from error


def _open_postgres(url: URL, *, is_read_only: bool) -> Engine:
    engine = create_engine(url.set(drivername="postgresql+psycopg"), connect_args=_POSTGRES_OPTIONS)
    event.listen(engine, "connect", _prepare_postgres, insert=True)  # before the dialect reads what the server says
    return engine.execution_options(postgresql_readonly=True) if is_read_only else engine


def _open_sqlite(url: URL, *, must_exist: bool, is_read_only: bool) -> Engine:
    path = None if url.database in _IN_MEMORY else Path(str(url.database)).absolute()
    if url.host or url.query or (path is None and must_exist):
        raise BackendConfigError(
            "an SQLite database must be sqlite:///FILE, with three slashes, or four before a full path"
        )
    if path is not None:
        (_find_file if must_exist else _make_file)(path)
    engine = create_engine(url, connect_args={"timeout": _BUSY_TIMEOUT_S})
    event.listen(engine, "connect", _prepare_sqlite)
    if is_read_only:
        event.listen(engine, "connect", _write_nothing)
    else:
        event.listen(engine, "begin", _begin_immediate)
    return engine


def _find_file(path: Path) -> None:
    """Raise DatabaseError unless there is such a file, and this user may read it; SQLite would make an empty one."""
    try:
        path.open("rb").close()
    except FileNotFoundError as exc:
        raise DatabaseError(f"there is no database {path};{_hint(path)} fleet-backend migrate creates one") from exc
    except OSError as exc:
        raise DatabaseError(f"cannot open the database {path}: {exc.strerror}") from exc


def _hint(path: Path) -> str:
    with contextlib.suppress(OSError):
        if near := get_close_matches(path.name, [entry.name for entry in path.parent.iterdir()], n=1):
            return f" is it {near[0]}?"
    return ""


def _make_file(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        create_private(path)
    except OSError as error:
        raise BackendConfigError(f"cannot make {path}: {error.strerror}") from error
    _find_file(path)


def _prepare_postgres(connection: Any, _record: object) -> None:  # noqa: ANN401 - a driver's, which is an extra
    """Compile no plans: where there are many months these look dear, and compiling takes longer than they do.

    Raises DatabaseError for a database without an encoding.
    """
    if connection.info.parameter_status("server_encoding") == "SQL_ASCII":  # its texts come as bytes
        name = connection.info.dbname
        connection.close()
        raise DatabaseError(
            f"database {name} has the encoding SQL_ASCII, in which no text is safe: "
            "CREATE DATABASE ... ENCODING 'UTF8' TEMPLATE template0"
        )
    connection.execute("SET jit = off")
    connection.commit()


def _prepare_sqlite(connection: SqliteConnection, _record: object) -> None:
    """Make commits durable and leave transactions to us; the driver would begin them late."""
    connection.isolation_level = None
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
        connection.execute(f"PRAGMA {pragma}")


def _write_nothing(connection: SqliteConnection, _record: object) -> None:
    connection.execute("PRAGMA query_only = ON")


def _begin_immediate(connection: Connection) -> None:
    """Take the write lock at once; two readers that both want to write would refuse each other."""
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def _sqlite_code(error: exc.DBAPIError) -> int | None:
    """Return SQLite's own code; its driver calls a missing table and a locked file by one name."""
    code = getattr(error.orig, "sqlite_errorcode", None)
    return code & 0xFF if isinstance(code, int) else None  # the rest of it tells more of the same


def _first_line(error: exc.StatementError) -> str:
    """Return what the driver said, without the statement and its values."""
    lines = str(error.orig).strip().splitlines()
    return lines[0] if lines else type(error.orig).__name__
