"""Brings a database to the schema of this program, from an empty one or any earlier schema, data included."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, inspect, text

from fleet_backend.database import close_to_others, place_of, transaction
from fleet_backend.errors import DatabaseAwayError, DatabaseError
from fleet_backend.months.moving import move_all

_FOLDER: Final = Path(__file__).with_name("migrations")
_LAST_WITHOUT_MONTHS: Final = "r0007"
_MONTHS: Final = "r0008"
_WHEREABOUTS: Final = "r0009"  # reads all results; who reads them meanwhile is not kept waiting
_MOST_ATTEMPTS: Final = 100
_PAUSE_S: Final = 0.3
_LOCK: Final = 0x434C4449  # PostgreSQL's advisory lock of whoever migrates: "CLDI"


def migrate(engine: Engine, revision: str = "head", tell: Callable[[int], None] = lambda _count: None) -> None:
    """Upgrade a database in one transaction; who comes second waits and finds nothing left to do.

    Results of a PostgreSQL that are not yet kept by months move there before, in batches: they stay readable, ``tell``
    hears how many have moved, and a migration that was interrupted goes on where it was. What reads all results or
    waits for readers is a transaction of its own there.

    Raises
    ------
    DatabaseAwayError
        If the database does not answer.
    DatabaseError
        If it was made by a newer program, or forbids the change.
    """
    found = _found(engine)
    if revision == "head" and engine.dialect.name == "postgresql" and found is not None:
        if _is_until(found, _LAST_WITHOUT_MONTHS):
            _upgrade(engine, _LAST_WITHOUT_MONTHS)
            move_all(engine, tell)
            _upgrade_between_readers(engine, _MONTHS)
            with transaction(engine) as connection:
                connection.execute(text("ANALYZE shift_result"))  # of a table as a whole, which no autovacuum looks at
        if _is_until(found, _MONTHS):
            _upgrade(engine, _WHEREABOUTS)
        _upgrade_between_readers(engine, revision)
    else:
        _upgrade(engine, revision)
    close_to_others(engine)


def _upgrade_between_readers(engine: Engine, revision: str) -> None:
    """Upgrade as soon as nobody reads for a moment; whoever reads is never made to wait for long."""
    for _ in range(_MOST_ATTEMPTS):
        with suppress(DatabaseAwayError):
            _upgrade(engine, revision)
            return
        time.sleep(_PAUSE_S)
    _upgrade(engine, revision)


def _upgrade(engine: Engine, revision: str) -> None:
    with transaction(engine) as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
        _refuse_unknown(engine, connection)
        config = _config()
        config.attributes["connection"] = connection
        command.upgrade(config, revision)


def check_schema(engine: Engine) -> None:
    """Raise DatabaseError unless a database has the schema of this program, DatabaseAwayError if it does not answer."""
    with transaction(engine) as connection:
        _refuse_unknown(engine, connection)
        found = _revision(connection)
    if found != newest_revision():
        state = "has no schema of fleet-backend" if found is None else f"has the older schema {found}"
        raise DatabaseError(f"database {place_of(engine)} {state}; run: fleet-backend migrate")


def make_ready(engine: Engine) -> None:
    """Make sure of the schema; an SQLite database of an earlier one, which is ours alone, is upgraded.

    Raises
    ------
    DatabaseAwayError
        If the database does not answer.
    DatabaseError
        If it has no schema of ours, or one that it may not be brought from to the present one.
    """
    if engine.dialect.name == "sqlite" and _has_schema(engine):
        migrate(engine)
    else:
        check_schema(engine)


def revisions() -> list[str]:
    """Return all revisions, oldest first."""
    return [script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()][::-1]


def newest_revision() -> str:
    """Return the revision that this program works with."""
    return revisions()[-1]


def _refuse_unknown(engine: Engine, connection: Connection) -> None:
    found = _revision(connection)
    if found is not None and found not in revisions():
        raise DatabaseError(f"database {place_of(engine)} was made by a newer program (schema {found})")
    if found is None and engine.dialect.name == "sqlite" and inspect(connection).get_table_names():
        raise DatabaseError(f"database {place_of(engine)} is another program's, not a fleet's")


def _found(engine: Engine) -> str | None:
    """Return the revision of a database; None of an empty one."""
    with transaction(engine) as connection:
        _refuse_unknown(engine, connection)
        return _revision(connection)


def _is_until(found: str, revision: str) -> bool:
    """Return whether a revision is this one or an earlier one."""
    known = revisions()
    return known.index(found) <= known.index(revision)


def _has_schema(engine: Engine) -> bool:
    with transaction(engine) as connection:
        return _revision(connection) is not None


def _revision(connection: Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_FOLDER))
    config.set_main_option("path_separator", "os")
    return config
