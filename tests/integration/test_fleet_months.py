"""Results by months: they gain months ahead, and go when they are old."""

import io
from dataclasses import replace
from datetime import UTC, date, datetime

import pytest
from sqlalchemy import Engine, select, text, update

from clutchdiag_io.console import PeopleConsole
from fleet_backend import queries, report
from fleet_backend.ageing.results import results_of
from fleet_backend.choices import Quotas, TrendAxis
from fleet_backend.cli import main
from fleet_backend.database import transaction
from fleet_backend.intake import MessageKind, Received, batch_of, receive_all
from fleet_backend.months import RANK, keep_months, partitions
from fleet_backend.office.retention import retain
from fleet_backend.office_tables import AUDIT
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.quotas import QuotaGate
from fleet_backend.rows import Row
from fleet_backend.schema import REVISION, SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, message_of, row_of

NOW = datetime(2026, 6, 15, 12, tzinfo=UTC)


def made_at(moment: str, seq: int = 1, **others: str) -> Row:
    return row_of(fleet_result(seq, produced_at=f"{moment}T00:00:00.000000Z", **others))  # type: ignore[arg-type]


def place_of_rows(engine: Engine) -> dict[str, int]:
    with transaction(engine) as connection:
        found = connection.execute(text("SELECT tableoid::regclass::text, count(*) FROM shift_result GROUP BY 1"))
        return {str(name): int(count) for name, count in found}


def test_months_are_made_ahead_and_take_what_waited_for_them(postgres_engine: Engine) -> None:
    end = datetime.now(UTC).year + 3
    Writer(postgres_engine).store(
        Batch(shifts=[made_at(f"{end}-02-03"), made_at("2020-01-01", 2), made_at("2999-01-01", 3)])
    )
    assert place_of_rows(postgres_engine) == {"shift_result_after": 2, "shift_result_before": 1}
    before = queries.table_hash(postgres_engine)
    made = keep_months(postgres_engine, datetime(end, 2, 1, tzinfo=UTC), 1)
    assert made[-1] == date(end, 3, 1)
    assert place_of_rows(postgres_engine)[f"shift_result_{end}_02"] == 1
    assert queries.table_hash(postgres_engine) == before
    assert keep_months(postgres_engine, datetime(end, 2, 1, tzinfo=UTC), 1) == []
    assert place_of_rows(postgres_engine)["shift_result_before"] == 1
    assert keep_months(postgres_engine, datetime(2021, 1, 1, tzinfo=UTC), 0, 12)[0] == date(2020, 1, 1)
    assert place_of_rows(postgres_engine)["shift_result_2020_01"] == 1
    assert queries.table_hash(postgres_engine) == before
    names = [one.name for one in partitions(postgres_engine)]
    assert (names[0], names[-2:]) == ("shift_result_before", [f"shift_result_{end}_03", "shift_result_after"])


def test_old_months_go_but_the_last_result_of_each_clutch(engine: Engine) -> None:
    days = ("2025-11-02", "2025-12-01", "2025-12-31", "2026-05-01", "2026-06-02")
    rows = [made_at(day, seq) for seq, day in enumerate(days, 1)]
    rows += [made_at(day, seq, vehicle="silent") for seq, day in enumerate(days[:3], 1)]
    Writer(engine).store(Batch(shifts=rows))
    worst = {(record["vehicle"], record["seq"]) for record in queries.worst_first(engine)}
    done = retain(engine, 2, now=NOW, by="ann")
    assert (done.before, done.gone_count, done.kept_count) == (date(2026, 4, 1), 5, 1)
    assert {(record["vehicle"], record["seq"]) for record in queries.worst_first(engine)} == worst
    assert queries.result_count(engine) == 3
    with transaction(engine) as connection:
        assert connection.execute(select(AUDIT.c.action)).scalars().all() == ["forget results"]
    assert retain(engine, 2, now=NOW, by="ann").gone_count == 0
    Writer(engine).store(Batch(shifts=rows))  # an outbox that never heard of the commit
    assert retain(engine, 2, now=NOW, by="ann").gone_count == 5


def test_results_of_a_clock_that_was_not_set_age_by_when_they_were_stored(engine: Engine) -> None:
    """Half a life is of 1970: nothing of it goes before its time, and nobody reads that year."""
    results = [fleet_result(seq, produced_at=f"1970-01-0{seq}T00:00:00.000000Z") for seq in (1, 2, 3)]
    undated = [
        replace(one, estimate=replace(one.estimate, start_ns=seq * 86_400 * 10**9, end_ns=(seq * 86_400 + 1) * 10**9))
        for seq, one in enumerate(results, 1)
    ]
    later = [fleet_result(seq, produced_at="2026-05-01T00:00:00.000000Z") for seq in (4, 5)]
    taken = [one for result in (*undated, *later) for one in receive_all(message_of(result), NOW)]
    Writer(engine).store(batch_of(taken))
    moments = {1: "2025-11-02", 2: "2026-05-03", 3: "2026-05-04"}
    with transaction(engine) as connection:
        for seq, day in moments.items():
            stored = update(SHIFT_RESULT).where(SHIFT_RESULT.c.seq == seq)
            connection.execute(stored.values(stored_at=datetime.fromisoformat(f"{day}T00:00:00+00:00")))
    assert [one["seq"] for one in queries.worst_first(engine)] == [5]
    assert [row["seq"] for row in results_of(engine, "car1", 2)] == [1, 2, 3, 4, 5]
    page = report.trend_table("car1", queries.trend(engine, "car1", 2, TrendAxis.SHIFT))
    out = io.StringIO()
    PeopleConsole(file=out).print(page)
    text_of_it = out.getvalue()
    assert text_of_it.count("clock not set") == 3
    assert "1970" not in text_of_it
    done = retain(engine, 2, now=NOW, by="ann")
    assert (done.gone_count, done.kept_count) == (1, 0)
    assert [row["seq"] for row in results_of(engine, "car1", 2)] == [2, 3, 4, 5]
    assert retain(engine, 2, now=NOW, by="ann").gone_count == 0


def test_without_a_clock_the_latest_result_is_the_one_that_came_last(engine: Engine) -> None:
    """A clock is lost after dated results: a stream without dates is as new as its arrival, and so is its fluid."""
    dated = [made_at(f"2026-03-0{seq}", seq) for seq in (1, 2)]
    lost: Row = {"produced_at": datetime(1970, 1, 2, tzinfo=UTC), "start_bus_ns": 1, "end_bus_ns": 2}
    lost |= {name: datetime(1970, 1, 2, tzinfo=UTC) for name in ("start_at", "end_at")}
    undated = [made_at("1970-01-02", 1, stream=stream) | lost for stream in ("z-first", "a-second")]
    Writer(engine).store(Batch(shifts=[*dated, *undated]))
    queries.note_fill(engine, "car1", "DCTF", at=datetime(2026, 5, 1, tzinfo=UTC), odometer_m=None, note=None)
    days = {"stream-1": "2026-04-01", "z-first": "2026-05-02", "a-second": "2026-05-03"}
    with transaction(engine) as connection:
        for stream, day in days.items():
            stored = update(SHIFT_RESULT).where(SHIFT_RESULT.c.stream == stream)
            connection.execute(stored.values(stored_at=datetime.fromisoformat(f"{day}T00:00:00+00:00")))
        if engine.dialect.name == "postgresql":
            connection.execute(text(RANK))
    (worst,) = queries.worst_first(engine)
    assert (worst["stream"], worst["condition"], worst["fluid"]) == ("a-second", "good", "DCTF")
    order = [("stream-1", 1), ("stream-1", 2), ("z-first", 1), ("a-second", 1)]
    rows = queries.trend(engine, "car1", 2, TrendAxis.SHIFT)
    assert [(row["stream"], row["seq"]) for row in rows] == order
    assert [row["fluid"] for row in rows] == [None, None, "DCTF", "DCTF"]
    assert [(row["stream"], row["seq"]) for row in results_of(engine, "car1", 2)] == order
    for source in (DatabaseSource(engine).all_clutches(), DatabaseSource(engine).clutches_of(["car1"])):
        assert [(one.stream, one.condition) for one in source] == [("a-second", "good")]
    assert str(queries.last_seen(engine)[0]["last_result_at"]).startswith("2026-05-03")


def test_revisions_come_and_go_with_their_results(engine: Engine) -> None:
    told: Row = {"vehicle": "car1", "stream": "stream-1", "clutch": 2, "content": "{}"}
    rows = [made_at(day, seq) for seq, day in enumerate(("2025-11-02", "2025-12-01", "2026-06-02"), 1)]
    old, new = (row["end_bus_ns"] for row in (rows[0], rows[2]))
    ends = [(2, old), (2, new), (3, old), (3, 7)]  # teller, and of what
    Writer(engine).store(Batch(shifts=rows, revisions=[told | {"seq": seq, "end_bus_ns": at} for seq, at in ends]))
    assert retain(engine, 2, now=NOW, by="ann").gone_count == 2
    with transaction(engine) as connection:
        left = connection.execute(select(REVISION.c.seq, REVISION.c.end_bus_ns)).all()
    assert {tuple(one) for one in left} == set(ends[1:])
    revised = replace(
        Received(message=message_of(fleet_result(4)), kind=MessageKind.SHIFT, row=rows[2]), revisions=[told]
    )
    one, other = QuotaGate(engine, Quotas(results=1)).judge([revised, revised], NOW)
    assert (one.revisions, other.kind, other.revisions) == ([told], MessageKind.WITHHELD, ())


def test_the_commands_say_what_they_did(
    postgres_engine: Engine, sqlite_url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Writer(postgres_engine).store(Batch(shifts=[made_at("2020-01-01"), made_at("2020-02-01", 2)]))
    place = ["--database", postgres_engine.url.render_as_string(hide_password=False)]
    assert main(["partitions", *place]) == 0
    assert "shift_result_before" in capsys.readouterr().out
    assert main(["retain", *place, "--months", "12"]) == 0
    assert "1 results from before" in capsys.readouterr().out
    for beyond in (["partitions", *place, "--ahead", "121"], ["retain", *place, "--months", "0"]):
        assert main(beyond) == 2
        assert "is not in the range" in capsys.readouterr().err
    assert main(["partitions", "--database", sqlite_url]) == 2
    assert "only a PostgreSQL database has partitions" in capsys.readouterr().err
