"""The schema of a fleet database: made from nothing, or from the one before with its data; on both databases."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine, bindparam, column, create_engine, inspect, make_url, table, text

from clutch_results.records import Condition
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseAwayError, DatabaseError
from fleet_backend.migrate import check_schema, migrate
from fleet_backend.office_tables import ALARM
from fleet_backend.schema import UtcDateTime
from fleet_backend.writer import Batch, Writer
from tests.golden import earlier
from tests.support.fleet import NOW, fleet_result, row_of


@pytest.fixture(name="empty")
def _empty(empty_database: str) -> Iterator[Engine]:
    engine = open_database(empty_database)
    yield engine
    engine.dispose()


@pytest.fixture(name="new")
def _new(empty: Engine, request: pytest.FixtureRequest) -> Iterator[Engine]:
    """Yield a database of the same kind that was made from nothing."""
    engine = open_database(request.getfixturevalue("sqlite_url" if is_sqlite(empty) else "postgres_url"))
    yield engine
    engine.dispose()


def is_sqlite(engine: Engine) -> bool:
    return engine.dialect.name == "sqlite"


def make_old(engine: Engine) -> None:
    """Give an empty database the schema r0021, as the program of then had made it."""
    if is_sqlite(engine):
        earlier.database("fleet.sql", Path(str(engine.url.database)))
        return
    connection = engine.raw_connection()
    driver = connection.driver_connection
    assert driver is not None
    driver.execute(earlier.text("postgres.sql"))
    driver.execute("RESET ALL; INSERT INTO alembic_version VALUES ('r0021')")
    driver.commit()
    connection.close()


@contextmanager
def columns_of_today(engine: Engine) -> Iterator[None]:
    """Let the writer of today store results in an old database: what later schemas add to them is there meanwhile."""
    added = {"tier": "SMALLINT", "indices": "TEXT"}
    with transaction(engine) as connection:
        for name, kind in added.items():
            connection.exec_driver_sql(f"ALTER TABLE shift_result ADD COLUMN {name} {kind}")
    yield
    with transaction(engine) as connection:
        for name in added:
            connection.exec_driver_sql(f"ALTER TABLE shift_result DROP COLUMN {name}")


def schema_of(engine: Engine) -> set[str]:
    """Return what there is, in words of the database: without months, and of tables without how they were written."""
    if not is_sqlite(engine):
        url = engine.url.set(drivername="postgresql").render_as_string(hide_password=False)
        told = subprocess.run(["pg_dump", "--schema-only", "-d", url], check=True, capture_output=True, text=True)
        parts = re.split(r";\n\n", re.sub(r"^(--|\\).*$", "", told.stdout, flags=re.MULTILINE))
        return {
            " ".join(one.split()) for one in parts if not re.search(r"shift_result_\d{4}_\d\d|FOR VALUES FROM", one)
        }
    with transaction(engine) as connection:
        made = connection.exec_driver_sql("SELECT name, sql FROM sqlite_master WHERE type <> 'table'")
        found = {f"{name}: {' '.join(str(sql).split())}" for name, sql in made}
        for name in inspect(connection).get_table_names():
            for pragma in ("table_xinfo", "foreign_key_list"):
                found |= {f"{name}: {row[1:]}" for row in connection.exec_driver_sql(f"PRAGMA {pragma}({name})")}
    return found


def test_a_database_of_the_schema_before_becomes_what_a_new_one_is(empty: Engine, new: Engine) -> None:
    make_old(empty)
    assert schema_of(empty) != schema_of(new)
    rows = [row_of(fleet_result(seq, vehicle="car9", clutch=1 + seq % 2)) for seq in range(1, 4)]
    undated = {"start_bus_ns": 1, "end_bus_ns": 2, "produced_at": datetime(1970, 1, 2, tzinfo=UTC)}
    rows.append(row_of(fleet_result(1, vehicle="car9", stream="without a clock")) | undated)
    with columns_of_today(empty):
        Writer(empty).store(Batch(shifts=rows))
    with pytest.raises(DatabaseError, match="older schema r0021; run: fleet-backend migrate"):
        check_schema(empty)
    worn = [row_of(fleet_result(seq, vehicle="worn", condition=Condition.CHANGE_FLUID)) for seq in (1, 2)]
    raised = {"vehicle": "worn", "clutch": 2, "rule": "verdict", "number": 1, "raised_at": NOW, "reason": "worn fluid"}
    noted = {"vehicle": "worn", "stream": "stream-1", "seq": 2, "acknowledged_at": NOW, "acknowledged_by": "ann"}
    acknowledgement = table("alarm_acknowledgement", *(column(name) for name in noted))
    with columns_of_today(empty):
        Writer(empty).store(Batch(shifts=worn))
    with transaction(empty) as connection:
        connection.execute(ALARM.insert().values(raised))
        connection.execute(
            acknowledgement.insert().values(noted | {"acknowledged_at": bindparam("at", NOW, UtcDateTime())})
        )
    before = queries.table_hash(empty)
    migrate(empty)
    check_schema(empty)
    assert schema_of(empty) == schema_of(new)
    with transaction(empty) as connection:
        (alarm,) = connection.execute(ALARM.select().where(ALARM.c.vehicle == "worn")).all()
    assert (alarm.number, alarm.acknowledged_by, alarm.acknowledged_at, alarm.cleared_at) == (1, "ann", NOW, None)
    assert queries.table_hash(empty) == before
    assert {(one["tier"]) for one in queries.worst_first(empty)} == {None}
    latest = {(one["clutch"], one["stream"]) for one in queries.worst_first(empty) if one["vehicle"] == "car9"}
    assert latest == {(1, "stream-1"), (2, "without a clock")}
    Writer(empty).store(Batch(shifts=rows))  # an outbox that sends again what the old program had stored
    assert queries.table_hash(empty) == before


@pytest.mark.parametrize(
    ("revision", "told"),
    [
        ("r9999", "made by a newer program"),
        ("r0011", r"schema r0011, which is too old to be upgraded: make a new database and take its rows over"),
    ],
)
def test_a_database_of_another_program_is_left_alone_and_told_what_to_do(new: Engine, revision: str, told: str) -> None:
    with transaction(new) as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = :told"), {"told": revision})
    for use in (check_schema, migrate):
        with pytest.raises(DatabaseError, match=told):
            use(new)


def test_a_database_without_an_encoding_is_named_with_what_to_do(postgres_url: str) -> None:
    """Of SQL_ASCII the driver gives bytes in place of text."""
    engine = create_engine(make_url(postgres_url).set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text("CREATE DATABASE anything ENCODING 'SQL_ASCII' LOCALE 'C' TEMPLATE template0"))
    engine.dispose()
    engine = open_database(make_url(postgres_url).set(database="anything").render_as_string(hide_password=False))
    with pytest.raises(DatabaseError, match=r"anything.*encoding SQL_ASCII.*ENCODING 'UTF8'"):
        migrate(engine)
    engine.dispose()


def test_an_interrupted_migration_leaves_the_schema_before_it(empty: Engine) -> None:
    make_old(empty)
    before = schema_of(empty)
    with transaction(empty) as connection:
        if is_sqlite(empty):
            connection.exec_driver_sql("DROP INDEX shift_by_rank")  # which the step takes for granted
        else:
            connection.exec_driver_sql("CREATE VIEW in_the_way AS SELECT * FROM fleet_worst_first")
    broken = schema_of(empty)
    with pytest.raises(DatabaseError) as caught:
        migrate(empty)
    assert not isinstance(caught.value, DatabaseAwayError)  # no waiting would mend it
    assert schema_of(empty) == broken != before
    with pytest.raises(DatabaseError, match="older schema r0021"):
        check_schema(empty)
