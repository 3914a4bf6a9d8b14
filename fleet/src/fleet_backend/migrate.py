"""Brings a database to the schema of this program, from an empty one or any schema since r0021, data included."""

import time
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
from fleet_backend.months import LOCK_S

_FOLDER: Final = Path(__file__).with_name("migrations")
_MOST_ATTEMPTS: Final = 100
_PAUSE_S: Final = 0.3
_LOCK: Final = 0x434C4449  # PostgreSQL's advisory lock of whoever migrates: "CLDI"


def migrate(engine: Engine, revision: str = "head") -> None:
    """Upgrade a database in one transaction; who comes second waits and finds nothing left to do.

    A PostgreSQL that is in use is upgraded as soon as nobody reads for a moment.

    Raises
    ------
    DatabaseAwayError
        If the database does not answer.
    DatabaseError
        If it was made by a newer program or has a schema before the first one known, or forbids the change.
    """
    with transaction(engine) as connection:
        is_in_use = engine.dialect.name == "postgresql" and _revision(connection) is not None
    for _ in range(_MOST_ATTEMPTS if is_in_use else 0):  # whoever reads is never made to wait for long
        with suppress(DatabaseAwayError):
            _upgrade(engine, revision)
            break
        time.sleep(_PAUSE_S)
    else:
        _upgrade(engine, revision)
    close_to_others(engine)


def _upgrade(engine: Engine, revision: str) -> None:
    with transaction(engine) as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{LOCK_S}s'")  # others wait behind us
        _refuse_unknown(engine, connection)
        config = _config()
        config.attributes["connection"] = connection
        command.upgrade(config, revision)


def check_schema(engine: Engine) -> None:
    """Raise DatabaseError unless a database has the schema of this program, DatabaseAwayError if it does not answer."""
    with transaction(engine) as connection:
        _refuse_unknown(engine, connection)
        revision = _revision(connection)
    if revision != newest_revision():
        state = "has no schema of fleet-backend" if revision is None else f"has the older schema {revision}"
        raise DatabaseError(f"database {place_of(engine)} {state}; run: fleet-backend migrate")


def make_ready(engine: Engine) -> None:
    """Make sure of the schema; an SQLite database of an earlier one, which is ours alone, is upgraded.

    Raises DatabaseAwayError if the database does not answer, DatabaseError if it has no schema of ours, or one that it
    may not be brought from to the present one.
    """
    with transaction(engine) as connection:
        is_known = _revision(connection) is not None
    if engine.dialect.name == "sqlite" and is_known:
        migrate(engine)
    else:
        check_schema(engine)


def revisions() -> list[str]:
    """Return all revisions, oldest first."""
    return [script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()][::-1]


def newest_revision() -> str:
    return revisions()[-1]


def _refuse_unknown(engine: Engine, connection: Connection) -> None:
    revision, known = _revision(connection), revisions()
    if revision is not None and revision not in known:
        reason = f"was made by a newer program (schema {revision})"
        if revision < known[0]:
            reason = (
                f"has the schema {revision}, which is too old to be upgraded: make a new database and take its rows"
                " over (docs/fleet.md, Backup and restore)"
            )
        raise DatabaseError(f"database {place_of(engine)} {reason}")
    if revision is None and engine.dialect.name == "sqlite" and inspect(connection).get_table_names():
        raise DatabaseError(f"database {place_of(engine)} is another program's, not a fleet's")


def _revision(connection: Connection) -> str | None:
    return MigrationContext.configure(connection).get_current_revision()


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_FOLDER))
    config.set_main_option("path_separator", "os")
    return config
