"""What tells where results are: it is what all results make it, and views by it say what views over them say."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import Connection, Engine

from diag_service.diagnosis.records import Condition
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.months import FILL, has_partitions
from fleet_backend.page import past
from fleet_backend.page.running import DatabaseSource
from fleet_backend.page.vehicle_state import Stored, state_of
from fleet_backend.rows import Row
from fleet_backend.schema import KEY_COLUMNS
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of

WORN = Condition.CHANGE_FLUID
FAR = 1024  # positions apart
VERDICTS = (WORN, *3 * (Condition.GOOD,), Condition.NO_VERDICT)
NOW = datetime(2026, 6, 15, 12, tzinfo=UTC)


@pytest.fixture(name="by_month")
def _by_month(postgres_url: str) -> Iterator[Engine]:
    opened = open_database(postgres_url)
    yield opened
    opened.dispose()


def streams(connection: Connection) -> set[tuple[object, ...]]:
    return {tuple(row) for row in connection.exec_driver_sql("TABLE clutch_stream")}


def check(engine: Engine) -> None:
    """Assert that the table of streams is what it would be if it were made anew."""
    with transaction(engine) as connection:
        kept = streams(connection)
        for statement in ("TRUNCATE clutch_stream", FILL):
            connection.exec_driver_sql(statement)
        assert kept == streams(connection)


def history(seed: int, count: int = 60) -> list[Row]:
    """Return results whose positions, versions, verdicts, streams and months are anyhow; some come twice."""
    rng = np.random.default_rng(seed)
    rows: dict[tuple[object, ...], Row] = {}
    while len(rows) < count:
        seq = max(1, int(rng.integers(0, 5)) * FAR + int(rng.integers(-2, 3)))
        result = fleet_result(
            seq,
            vehicle=f"car{rng.integers(2)}",
            stream=f"stream-{rng.integers(2)}",
            clutch=1 + seq % 2,
            condition=VERDICTS[rng.integers(len(VERDICTS))],
            algorithm=f"algorithm-{9 + rng.integers(5) // 4}",
            produced_at=f"2026-{1 + seq * 7 % 5:02}-07T00:00:00.000000Z",  # a clock that jumps
        )
        row = row_of(result)
        rows[tuple(row[name] for name in KEY_COLUMNS)] = row
    return [*rows.values(), *list(rows.values())[: count // 4]]


def stored_of(engine: Engine, vehicle: str) -> Sequence[Stored]:
    state = state_of(engine, vehicle)
    return () if state is None else state.stored


def found_version(engine: Engine, seq: int) -> str | None:
    found = past.shift_of(engine, "car1", "stream-1", seq)
    return None if found is None else found.algorithm_version


def newest_moments(engine: Engine) -> list[list[datetime]]:
    """Return when the newest results of a clutch were made, of a few and of more than there are."""
    with transaction(engine) as connection:
        asked = (past.current_results("car1", 1, most, is_by_month=has_partitions(engine)) for most in (1, 2, 5, 9, 60))
        return [[row.produced_at for row in connection.execute(statement)] for statement in asked]


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_found_by_months_is_what_one_table_says(by_month: Engine, sqlite_url: str, seed: int) -> None:
    one_table = open_database(sqlite_url)
    rows = history(seed)
    for first in range(0, len(rows), 9):
        for engine in (by_month, one_table):
            Writer(engine).store(Batch(shifts=rows[first : first + 9]))
    check(by_month)
    with transaction(by_month) as connection:
        assert connection.exec_driver_sql("SHOW jit").scalar_one() == "off"
    asked = (
        queries.worst_first,
        queries.last_seen,
        lambda engine: [
            (one.vehicle, one.clutch, one.stream, one.seq) for one in DatabaseSource(engine).all_clutches()
        ],
        lambda engine: [(one.clutch, one.result_count, one.produced_at) for one in stored_of(engine, "car1")],
        lambda engine: {(row["seq"], row["algorithm_version"]) for row in past.results_of(engine, "car1", 1)},
        newest_moments,
        lambda engine: [found_version(engine, seq) for seq in range(FAR - 2, FAR + 3)],
        lambda engine: set(DatabaseSource(engine).vehicles_with_news(NOW)),
    )
    for ask in asked:
        assert ask(by_month) == ask(one_table)
    one_table.dispose()
