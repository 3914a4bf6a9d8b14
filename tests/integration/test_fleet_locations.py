"""What tells where results are: it is what all results make it, and views by it say what views over them say."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import Connection, Engine, delete, insert

from diag_service.diagnosis.records import Condition
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.months import FILL, keep_months
from fleet_backend.office.retention import retain
from fleet_backend.office_tables import ALARM_ACKNOWLEDGEMENT
from fleet_backend.page import past
from fleet_backend.page.running import DatabaseSource
from fleet_backend.page.vehicle_state import Stored, state_of
from fleet_backend.rows import Row
from fleet_backend.schema import BLOCK, KEY_COLUMNS, SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of

WORN = Condition.CHANGE_FLUID
MOODS = (WORN, Condition.GOOD, Condition.WATCH, Condition.NO_VERDICT)
SAID = (((9, 0),), ((9, 0),), ((9, 0), (10, 0)), ((9, 0), (9, 1)))  # of a result: versions, and months later
VERDICTS = (WORN, *3 * (Condition.GOOD,), Condition.NO_VERDICT)
NOW = datetime(2026, 6, 15, 12, tzinfo=UTC)


@pytest.fixture(name="by_month")
def _by_month(postgres_url: str) -> Iterator[Engine]:
    opened = open_database(postgres_url)
    yield opened
    opened.dispose()


def tables(connection: Connection) -> list[set[tuple[object, ...]]]:
    found = (connection.exec_driver_sql(words) for words in ("TABLE clutch_stream", "TABLE clutch_block"))
    return [{tuple(row) for row in rows} for rows in found]


def check(engine: Engine) -> None:
    """Assert that both tables are what they would be if they were made anew."""
    with transaction(engine) as connection:
        kept = tables(connection)
        for statement in ("TRUNCATE clutch_stream, clutch_block", *FILL):
            connection.exec_driver_sql(statement)
        assert kept == tables(connection)


def history(seed: int, count: int = 60) -> list[Row]:
    """Return results whose positions, versions, verdicts, streams and months are anyhow; some come twice."""
    rng = np.random.default_rng(seed)
    rows: dict[tuple[object, ...], Row] = {}
    while len(rows) < count:
        seq = max(1, int(rng.integers(0, 5)) * BLOCK + int(rng.integers(-2, 3)))
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


def alarming_past(vehicle: str, rng: np.random.Generator) -> list[Row]:
    """Return results of up to four streams of up to eight blocks; many have another version, or another content."""
    blocks = [(stream, block) for stream in range(rng.integers(1, 5)) for block in range(rng.integers(1, 9))]
    rows = []
    for stream, block in blocks:
        mood = rng.choice(len(MOODS), p=(0.3, 0.3, 0.1, 0.3))
        for place in rng.choice((0, 1, 5, BLOCK - 2, BLOCK - 1), rng.integers(3)):
            seq = max(1, block * BLOCK + int(place))
            for version, later in SAID[rng.integers(len(SAID))]:
                result = fleet_result(
                    seq,
                    vehicle=vehicle,
                    stream=f"stream-{stream}",
                    clutch=1 + seq % 2,
                    condition=MOODS[mood if rng.random() < 0.7 else rng.integers(len(MOODS))],
                    algorithm=f"algorithm-{version}",
                    produced_at=f"2026-{1 + (stream + block // 3 + later) % 5:02}-07T00:00:00.000000Z",
                )
                rows.append(row_of(result))
    return rows


def test_runs_of_verdicts_are_found_from_the_alarming_ones_on(by_month: Engine, sqlite_url: str) -> None:
    one_table = open_database(sqlite_url)
    rng = np.random.default_rng(5)
    rows = [row for car in range(40) for row in alarming_past(f"car{car}", rng)]
    worn = {(row["vehicle"], row["stream"], row["seq"]) for row in rows if row["condition"] == "change_fluid"}
    noted = [dict(zip(("vehicle", "stream", "seq"), key, strict=True)) for key in sorted(worn)[::3]]
    coming = [rows[place] for place in rng.permutation(len(rows))]  # of two contents under one key the first stays
    for engine in (by_month, one_table):
        Writer(engine).store(Batch(shifts=coming))
        with transaction(engine) as connection:
            connection.execute(insert(ALARM_ACKNOWLEDGEMENT).values(acknowledged_at=NOW, acknowledged_by="ann"), noted)
    found, expected = (queries.clutch_alarms(engine, is_open_only=False) for engine in (by_month, one_table))
    assert len(found) > 60
    assert found == expected
    one_by_one = [alarm.raised_at for car in range(40) for alarm in past.alarms_of(by_month, f"car{car}")]
    assert set(one_by_one) == {alarm["raised_at"] for alarm in found}
    one_table.dispose()


def test_an_alarm_at_the_last_position_there_can_be_is_one(by_month: Engine) -> None:
    row = row_of(fleet_result(1, condition=WORN)) | {"seq": 2**63 - 1}
    Writer(by_month).store(Batch(shifts=[row]))
    assert [alarm["seq"] for alarm in queries.clutch_alarms(by_month, is_open_only=True)] == [2**63 - 1]


def stored_of(engine: Engine, vehicle: str) -> Sequence[Stored]:
    state = state_of(engine, vehicle)
    return () if state is None else state.stored


def found_version(engine: Engine, seq: int) -> str | None:
    found = past.shift_of(engine, "car1", "stream-1", seq)
    return None if found is None else found.algorithm_version


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
        lambda engine: queries.clutch_alarms(engine, is_open_only=False),
        queries.worst_first,
        queries.last_seen,
        lambda engine: [
            (one.vehicle, one.clutch, one.stream, one.seq) for one in DatabaseSource(engine).all_clutches()
        ],
        lambda engine: [(one.clutch, one.result_count, one.produced_at) for one in stored_of(engine, "car1")],
        lambda engine: {(row["seq"], row["algorithm_version"]) for row in past.results_of(engine, "car1", 1)},
        lambda engine: [found_version(engine, seq) for seq in range(BLOCK - 2, BLOCK + 3)],
        lambda engine: set(DatabaseSource(engine).vehicles_with_news(NOW)),
    )
    for ask in asked:
        assert ask(by_month) == ask(one_table)
    one_table.dispose()


def test_months_that_go_or_are_made_and_deletions_leave_both_tables_right(by_month: Engine) -> None:
    Writer(by_month).store(Batch(shifts=history(4, 80)))
    keep_months(by_month, datetime(2026, 1, 1, tzinfo=UTC), 0)
    keep_months(by_month, datetime(2026, 4, 1, tzinfo=UTC), 0, 3)
    check(by_month)
    retain(by_month, 2, now=NOW, by="ann")
    check(by_month)
    with transaction(by_month) as connection:
        connection.execute(delete(SHIFT_RESULT).where(SHIFT_RESULT.c.vehicle == "car1", SHIFT_RESULT.c.seq < BLOCK))
    check(by_month)
