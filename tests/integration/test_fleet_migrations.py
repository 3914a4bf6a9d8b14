"""The schema of a fleet database: made from nothing, or from any since release 0.8 with its data; on both databases."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import Connection, Engine, column, inspect, table

from fleet_backend import queries
from fleet_backend.choices import Axis
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseAwayError, DatabaseError
from fleet_backend.migrate import check_schema, migrate, newest_revision, revisions
from fleet_backend.office_tables import METADATA
from fleet_backend.queries import (
    CLUTCH_ALARM,
    CLUTCH_TREND,
    FLEET_WORST_FIRST,
    IDENTITY_ALARM,
    LAST_SEEN,
)
from fleet_backend.rows import moment
from fleet_backend.schema import UtcDateTime
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.ports import free_port

EARLIER = revisions()[:-1]
GOLDEN = Path(__file__).parents[1] / "golden"
GOLDEN_HASH = queries.TableHash(row_count=11, sha256="ab018ef2103354453145cab0296b9dd43709b7bf4f70cb523bac9d5ee75151ca")


@pytest.fixture(name="empty")
def _empty(empty_database: str) -> Iterator[Engine]:
    engine = open_database(empty_database)
    yield engine
    engine.dispose()


def insert_golden(connection: Connection) -> None:
    """Store what the program of an earlier schema had stored, in the columns that it knew."""
    tables = json.loads((GOLDEN / "fleet-results.json").read_text(encoding="utf-8"))
    for row in tables["vehicle"]:
        row |= {"metrics": "{}", "metrics_at": "2026-01-01T00:00:00.000000Z"}
    for name in ("vehicle", "clutch", "shift_result", "quarantine"):
        for row in tables[name]:
            columns = [column(key, UtcDateTime if key.endswith("_at") else None) for key in row]
            values = {key: moment(value) if key.endswith("_at") else value for key, value in row.items()}
            connection.execute(table(name, *columns).insert().values(values))


@pytest.mark.parametrize("revision", EARLIER)
def test_data_survive_the_upgrade_from_every_earlier_schema_and_results_go_on(empty: Engine, revision: str) -> None:
    migrate(empty, revision)
    with transaction(empty) as connection:
        insert_golden(connection)
    with pytest.raises(DatabaseError, match=f"older schema {revision}; run: fleet-backend migrate"):
        check_schema(empty)
    migrate(empty)
    check_schema(empty)
    assert queries.table_hash(empty) == GOLDEN_HASH
    (seen, _) = sorted(queries.last_seen(empty), key=lambda record: str(record["vehicle"]))
    assert (seen["vehicle"], bool(seen["is_online"]), seen["service_version"]) == ("car1", True, "0.1.0")
    worst = queries.worst_first(empty)[0]
    assert (worst["vehicle"], worst["condition"]) == ("car2", "change_fluid")
    assert len(queries.trend(empty, "car1", 2, Axis.SHIFT)) == 3  # the newer algorithm stands for its shift
    assert [record["reason"] for record in queries.quarantined(empty, 9)] == ["identity"]
    assert [record["vehicle"] for record in queries.identity_alarms(empty)] == ["car1"]
    rows = [row_of(fleet_result(seq, clutch=1 + seq % 2)) for seq in range(1, 6)]
    Writer(empty).store(Batch(shifts=rows))  # an outbox that sends again what the old program had stored
    assert queries.table_hash(empty) == GOLDEN_HASH
    Writer(empty).store(Batch(shifts=[row_of(fleet_result(6, clutch=1))]))
    assert queries.result_count(empty) == GOLDEN_HASH.row_count + 1


def test_there_is_an_earlier_schema_to_come_from() -> None:
    assert EARLIER == ["r0011", "r0012", "r0013", "r0014", "r0015", "r0016", "r0017", "r0018", "r0019", "r0020"]


def is_of_both(item: Any, name: str | None, kind: str, *_told: object) -> bool:  # noqa: ANN401 - any part of a schema
    """Return whether a thing is in both databases: neither a partition nor what tells where results are."""
    if kind == "foreign_key_constraint":
        return bool(item.table.name != "shift_result")
    return not (kind == "table" and str(name).startswith(("shift_result_", "clutch_stream", "clutch_block")))


@pytest.mark.filterwarnings("ignore:Skipped unsupported reflection of expression-based index")
def test_the_migrations_make_what_the_program_uses(empty: Engine) -> None:
    migrate(empty)
    with transaction(empty) as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "include_object": is_of_both})
        assert compare_metadata(context, METADATA) == []
        views = set(inspect(connection).get_view_names())
        current_shift = table("current_shift", column("vehicle"), column("stream"), column("seq"))
        for view in (CLUTCH_ALARM, current_shift, FLEET_WORST_FIRST, IDENTITY_ALARM, LAST_SEEN, CLUTCH_TREND):
            assert view.name in views
            connection.execute(view.select())


def test_migrating_again_changes_nothing(empty: Engine) -> None:
    migrate(empty)
    migrate(empty)
    check_schema(empty)


def test_an_empty_database_is_not_taken_for_a_ready_one(empty: Engine) -> None:
    with pytest.raises(DatabaseError, match="has no schema of fleet-backend; run: fleet-backend migrate"):
        check_schema(empty)


def test_the_database_of_a_newer_program_is_left_alone(empty: Engine) -> None:
    migrate(empty)
    with transaction(empty) as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = 'r9999'")
    for use in (check_schema, migrate):
        with pytest.raises(DatabaseError, match="made by a newer program"):
            use(empty)


def test_the_database_of_a_release_before_0_8_is_left_to_that_release(empty: Engine) -> None:
    migrate(empty)
    with transaction(empty) as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = 'r0007'")
    for use in (check_schema, migrate):
        with pytest.raises(DatabaseError, match=r"schema r0007 of a release before 0\.8: migrate it by release 0\.8"):
            use(empty)


def test_an_interrupted_migration_leaves_the_schema_before_it(empty: Engine) -> None:
    migrate(empty, EARLIER[0])
    with transaction(empty) as connection:
        connection.exec_driver_sql("CREATE TABLE calibration (vehicle TEXT)")  # in the way of the new one
    with pytest.raises(DatabaseError):
        migrate(empty)
    with transaction(empty) as connection:
        assert "withdrawn_fill" not in inspect(connection).get_table_names()
        connection.exec_driver_sql("DROP TABLE calibration")
    migrate(empty)
    check_schema(empty)


def test_a_database_that_does_not_answer_is_said_to_be_away() -> None:
    engine = open_database(f"postgresql://clutchdiag:secret@127.0.0.1:{free_port()}/fleet")
    with pytest.raises(DatabaseAwayError) as caught:
        check_schema(engine)
    assert "secret" not in str(caught.value)
    assert newest_revision() == "r0021"
