"""The schema of the fleet database: made from nothing or from any earlier schema with its data, on both databases."""

from collections.abc import Iterator

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import Connection, Engine, inspect

from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseAwayError, DatabaseError
from fleet_backend.migrate import check_schema, migrate, newest_revision, revisions
from fleet_backend.rows import Row
from fleet_backend.schema import CLUTCH, METADATA, SHIFT_RESULT, VEHICLE
from fleet_backend.views import CLUTCH_ALARM, CURRENT_SHIFT, FLEET, IDENTITY_ALARM, LAST_SEEN, TREND
from fleet_backend.writer import Batch, Writer
from tests.fleet import fleet_result, row_of
from tests.plugins.broker import free_port

EARLIER = revisions()[:-1]


@pytest.fixture(name="empty")
def _empty(empty_database: str) -> Iterator[Engine]:
    engine = open_database(empty_database)
    yield engine
    engine.dispose()


def insert_by_hand(connection: Connection, rows: list[Row]) -> None:
    """Store rows with what every schema has had, as its own program would have."""
    for table, row in ((VEHICLE, {"vehicle": "car1"}), (CLUTCH, {"vehicle": "car1", "clutch": 2})):
        connection.execute(table.insert().values(row))
    connection.execute(SHIFT_RESULT.insert(), rows)


@pytest.mark.parametrize("revision", EARLIER)
def test_data_survive_the_upgrade_from_every_earlier_schema(empty: Engine, revision: str) -> None:
    migrate(empty, revision)
    rows = [row_of(fleet_result(seq)) for seq in range(1, 11)]
    with transaction(empty) as connection:
        insert_by_hand(connection, rows)
    before = queries.table_hash(empty)
    with pytest.raises(DatabaseError, match=f"older schema {revision}; run: fleet-backend migrate"):
        check_schema(empty)
    migrate(empty)
    check_schema(empty)
    assert queries.table_hash(empty) == before
    Writer(empty).store(Batch(shifts=[*rows, row_of(fleet_result(11))]))
    assert len(queries.trend(empty, "car1", 2, queries.Axis.SHIFT)) == 11


def test_there_is_an_earlier_schema_to_come_from() -> None:
    assert EARLIER == ["r0001"]


def test_the_migrations_make_what_the_program_uses(empty: Engine) -> None:
    migrate(empty)
    with transaction(empty) as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, METADATA) == []
        views = set(inspect(connection).get_view_names())
        for view in (CLUTCH_ALARM, CURRENT_SHIFT, FLEET, IDENTITY_ALARM, LAST_SEEN, TREND):
            assert view.name in views
            connection.execute(view.select())


def test_migrating_again_changes_nothing(empty: Engine) -> None:
    migrate(empty)
    migrate(empty)
    check_schema(empty)


def test_an_empty_database_is_not_taken_for_a_ready_one(empty: Engine) -> None:
    with pytest.raises(DatabaseError, match="is empty; run: fleet-backend migrate"):
        check_schema(empty)


def test_the_database_of_a_newer_program_is_left_alone(empty: Engine) -> None:
    migrate(empty)
    with transaction(empty) as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = 'r9999'")
    for use in (check_schema, migrate):
        with pytest.raises(DatabaseError, match="made by a newer program"):
            use(empty)


def test_an_interrupted_migration_leaves_the_schema_before_it(empty: Engine) -> None:
    migrate(empty, "r0001")
    with transaction(empty) as connection:
        connection.exec_driver_sql("CREATE TABLE last_seen (vehicle TEXT)")  # in the way of the new view
    with pytest.raises(DatabaseError):
        migrate(empty)
    with transaction(empty) as connection:
        assert "fluid_fill" not in inspect(connection).get_table_names()
        connection.exec_driver_sql("DROP TABLE last_seen")
    migrate(empty)
    check_schema(empty)


def test_a_database_that_does_not_answer_is_said_to_be_away() -> None:
    engine = open_database(f"postgresql://clutchdiag:secret@127.0.0.1:{free_port()}/fleet")
    with pytest.raises(DatabaseAwayError) as caught:
        check_schema(engine)
    assert "secret" not in str(caught.value)
    assert newest_revision() == "r0002"
