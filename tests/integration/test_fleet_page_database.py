"""What the page reads from each database: what changed and why, lists in parts, plans that read no whole table."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import Connection, Engine, event, text

from clutch_results.event_kinds import EventKind
from clutch_results.prognosis import history_of, prognose
from clutch_results.prognosis.sentence import outlook_line
from clutch_results.records import Causes, Condition, LikelyCause, Reason, Revision, ShiftQuality, ShiftResult, Status
from fleet_backend import queries
from fleet_backend.alarms.rules import Rule
from fleet_backend.choices import Axis
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.intake import batch_of, take_all
from fleet_backend.office.watching import Orders
from fleet_backend.office.watching import Watch as WatchOfOffice
from fleet_backend.page import (
    changes_view,
    clutches_view,
    maintenance_view,
    quarantine_view,
    shift_view,
    vehicle_view,
)
from fleet_backend.page.asking import Ask, read_words
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.news import News
from fleet_backend.page.past import results_of, shift_of
from fleet_backend.page.records import Due
from fleet_backend.page.running import DatabaseSource
from fleet_backend.page.view import Sources, View
from fleet_backend.rows import moment
from fleet_backend.writer import Batch, Writer
from fleet_contract.orders import Action
from tests.support.fleet import NOW, fleet_result, message_of, row_of
from tests.support.fleet_page import sources_of
from tests.support.histories import CALIBRATION, history

BEFORE, AFTER = datetime(2026, 2, 1, tzinfo=UTC), datetime(2026, 3, 1, tzinfo=UTC)
SHIFT = {"stream": "stream-1", "seq": "9"}


def ask(view: View, vehicle: str | None = None, **query: str) -> Ask:
    path = {} if vehicle is None else {"vehicle": vehicle}
    return read_words(view.parameters, path, query.items(), NOW)


def store(engine: Engine, rows: list[Any], at: datetime) -> None:
    """Store results as if it were then."""
    Writer(engine).store(Batch(shifts=rows))
    with transaction(engine) as connection:
        new = "UPDATE shift_result SET stored_at = :at WHERE stored_at > '2026-06-01'"
        moment = at.strftime("%Y-%m-%d %H:%M:%S.%f") if engine.dialect.name == "sqlite" else at
        connection.execute(text(new), {"at": moment})


def test_what_became_different_is_told_with_its_reasons(engine: Engine) -> None:
    first = [
        row_of(fleet_result(seq, vehicle=name)) for name in ("aged", "again", "quiet", "refilled") for seq in (1, 2)
    ]
    store(engine, first, BEFORE)
    second = [row_of(fleet_result(seq, vehicle="aged", condition=Condition.WATCH)) for seq in (3, 4)]
    second += [row_of(fleet_result(2, vehicle="again", algorithm="algorithm-2"))]
    second += [row_of(fleet_result(3, vehicle="refilled")), row_of(fleet_result(1, vehicle="new"))]
    store(engine, second, AFTER)
    filled_at = moment(second[3]["end_at"]) - timedelta(microseconds=1)
    queries.note_fill(engine, "refilled", "DCTF", at=filled_at, odometer_m=None, note=None)
    found = changes_view.find(sources_of(engine), ask(changes_view.VIEW, since="2026-02-15"))
    changes = {one.vehicle: one for one in found.changes}
    assert {name: one.why for name, one in changes.items()} == {
        "aged": ("new data: 2 results",),
        "again": ("new algorithm: algorithm-1 before, algorithm-2 now", "new data: 1 result"),
        "refilled": ("new fluid: DCTF", "new data: 1 result"),
        "new": ("first results of this clutch",),
    }
    assert (changes["aged"].condition_before, changes["aged"].condition) == ("good", "watch")
    assert changes["new"].condition_before is None
    one = changes_view.find(sources_of(engine), ask(changes_view.VIEW, since="2026-02-15", q="GAIN"))
    assert one.changes == (changes["again"],)
    assert found.changes[0].vehicle == "aged"  # the worst first
    parts: list[Any] = []
    after: dict[str, str] = {}
    while not parts or after:
        question = ask(changes_view.VIEW, since="2026-02-15", limit="3", **after)
        parts.append(changes_view.find(sources_of(engine), question))
        after = {"after": parts[-1].next} if parts[-1].next else {}
    assert [one for part in parts for one in part.changes] == list(found.changes)


def scored(seq: int, score: float, touch_error_pa: float = 0.0) -> ShiftResult:
    """Return a result of a change that went so well."""
    given = fleet_result(seq, vehicle="rough")
    quality = ShiftQuality(
        score=score, reasons=("jerk_m_s3",), touch_error_pa=touch_error_pa, std_touch_error_pa=1e3,
        slip_energy2_j=5e3, peak2_k=390.0, life2_ratio=6e-7,
    )  # fmt: skip
    return replace(given, estimate=replace(given.estimate, kind=EventKind.POWER_ON_UPSHIFT, shift_quality=quality))


def test_how_well_a_vehicle_shifts_is_on_its_page_and_a_fall_raises_an_alarm(engine: Engine) -> None:
    good = [scored(seq, 90.0) for seq in range(1, 31)]
    Writer(engine).store(Batch(shifts=[*map(row_of, good), row_of(fleet_result(1, vehicle="old"))]))
    watch = WatchOfOffice(engine, Orders(), lambda: NOW)
    assert Rule.SCORE not in {step.subject.rule for step in watch.round()}
    Writer(engine).store(Batch(shifts=[row_of(scored(seq, 60.0, 9e3)) for seq in range(31, 51)]))
    raised = {step.subject.rule: step for step in watch.round()}
    assert "clutch 2 score 30 points less than the first" in raised[Rule.SCORE].reason
    sources = sources_of(engine)
    answer = vehicle_view.find(sources, ask(vehicle_view.VIEW, "rough"))
    (change,), (load,) = answer.changes, answer.loads
    assert (change.count, change.first, change.last) == (50, 90.0, 60.0)
    assert (load.clutch, load.counts, load.energy_j, load.peak_k) == (2, (0, 0, 0, 50, 0, 0), 250e3, 390.0)
    assert [point.score for point in answer.clutches[0].trend] == [90.0] * 30 + [60.0] * 20
    shown = vehicle_view.show(answer, ask(vehicle_view.VIEW, "rough"), sources)
    (section,) = (one for one in shown.sections if one.title == "How well it shifts")
    untold = "jerk, torque hole, flare, tie up, fill error, lock rate, overtime, temperature rise"
    assert section.texts == (
        "Power on upshift 1-2 scores 60: jerk.",
        f"Scores are without what the signals do not tell: {untold}.",
    )
    assert [table.rows[0][0] for table in section.tables] == ["power on upshift 1-2", "2"]
    captions = [figure.caption for one in shown.sections for figure in one.figures]
    assert captions.count("Clutch 2: trend of score") == 1
    old = vehicle_view.find(sources, ask(vehicle_view.VIEW, "old"))  # of an older program
    assert (old.changes, old.loads) == ((), ())
    assert {one.vehicle: one.score for one in DatabaseSource(engine).all_clutches()} == {"rough": 60.0, "old": None}
    one = shift_of(engine, "rough", "stream-1", 50)
    assert one is not None
    assert one.shift_quality is not None
    assert one.shift_quality.touch_error_pa == 9e3
    page = shift_view.show(one, ask(shift_view.VIEW, "rough", stream="stream-1", seq="50"), sources)
    assert "How well it went" in [section.title for section in page.sections]


def test_a_cause_that_new_fluid_does_not_mend_is_on_the_page_in_the_list_and_an_alarm(engine: Engine) -> None:
    """Until the fluid is changed: what was told then is of the fluid before."""
    worn, fluids = fleet_result(1, vehicle="worn", condition=Condition.CHANGE_FLUID), ("aged-fluid", "water", "air")
    likely = (
        LikelyCause(cause="glazed-lining", clutch=2, probability=0.93, evidence="For it: friction of clutch 2 -20 %."),
        *(LikelyCause(cause=one, clutch=None, probability=0.02, evidence=f"For {one}: nothing.") for one in fluids),
    )
    causes = Causes(event_count=60, likely=likely, advice="Glazed lining of clutch 2: renew it.", test=None)
    told = replace(worn, verdict=replace(worn.verdict, causes=causes))
    unclear = row_of(replace(fleet_result(1, vehicle="unclear"), verdict=told.verdict)) | {"causes": '{"likely": []}'}
    Writer(engine).store(Batch(shifts=[row_of(told), row_of(fleet_result(1, vehicle="plain")), unclear]))
    watch = WatchOfOffice(engine, Orders(), lambda: NOW)
    raised = {(one.subject.vehicle, one.subject.clutch): one for one in watch.round() if one.subject.rule is Rule.CAUSE}
    order = "See to another cause than the fluid first: glazed lining of clutch 2 (93 % likely)."
    assert {subject: one.reason.partition(" Clutch 1")[0] for subject, one in raised.items()} == {("worn", 0): order}
    listed = {str(one["vehicle"]): one for one in queries.worst_first(engine)}
    assert (listed["worn"]["action"], listed["unclear"]["action"]) == ("find_cause", "change_now")
    assert str(listed["worn"]["order"]).startswith(order)
    assert listed["worn"]["causes"] == json.loads(str(row_of(told)["causes"]))
    assert listed["plain"]["causes"] is None
    sources = sources_of(engine)
    answer = vehicle_view.find(sources, ask(vehicle_view.VIEW, "worn"))
    assert answer.action == "find_cause"
    (section,) = (
        one for one in vehicle_view.show(answer, ask(vehicle_view.VIEW, "worn"), sources).sections if one.title == "Why"
    )
    assert section.texts == ("Glazed lining of clutch 2: renew it.",)
    assert [row[0] for row in section.tables[0].rows] == ["glazed lining of clutch 2", "aged fluid", "water"]
    assert section.tables[0].rows[0][2] == "For it: friction of clutch 2 -20 %."
    for vehicle in ("plain", "unclear"):
        assert vehicle_view.find(sources, ask(vehicle_view.VIEW, vehicle)).causes is None
    queries.note_fill(engine, "worn", "DCTF", at=NOW, odometer_m=None, note=None)
    assert not [one for one in watch.round() if one.subject.rule is Rule.CAUSE]  # it stays until more is known
    answer = vehicle_view.find(sources_of(engine), ask(vehicle_view.VIEW, "worn"))
    assert (answer.action, answer.causes) == ("new_fluid", None)


def test_news_are_seen_and_a_reader_writes_nothing(database: str) -> None:
    writing, reading = open_database(database), open_database(database, must_exist=True, is_read_only=True)
    Writer(writing).store(Batch(shifts=[row_of(fleet_result(1))]))
    keeper = Keeper(DatabaseSource(reading))
    assert keeper.refresh()
    assert not keeper.refresh()
    Writer(writing).store(Batch(shifts=[row_of(fleet_result(2, condition=Condition.WATCH))]))
    assert keeper.refresh()
    assert [one.condition for one in keeper.snapshot.clutches] == ["watch"]
    queries.note_fill(writing, "car1", "DCTF", at=datetime(2026, 1, 1, tzinfo=UTC), odometer_m=None, note=None)
    assert keeper.refresh()
    assert keeper.snapshot.clutches[0].fluid == "DCTF"
    with pytest.raises(DatabaseError, match=r"read-?only"):
        Writer(reading).store(Batch(shifts=[row_of(fleet_result(3))]))
    for engine in (writing, reading):
        engine.dispose()


def test_the_prognosis_is_that_of_the_service(engine: Engine) -> None:
    results = history(200)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in results]))
    answer = vehicle_view.find(sources_of(engine), ask(vehicle_view.VIEW, "car1", service_km="20000"))
    founds = []
    for one in answer.clutches:
        clutch = one.now.clutch
        past = history_of(results, (), clutch)
        found = prognose(clutch, past, CALIBRATION.clutches[clutch - 1].friction, service_distance_m=2.0e7)
        assert one.outlook is not None
        founds.append(found)
        for shown, meant in ((one.outlook.watch, found.watch), (one.outlook.change_fluid, found.change_fluid)):
            assert shown is not None
            assert meant is not None
            assert (shown.p10_m, shown.p50_m, shown.p90_m) == (meant.p10_m, meant.p50_m, meant.p90_m)
            assert shown.probability_before_service == meant.probability_before_service
    assert answer.outlook == outlook_line(founds, Action.CHANGE_AT_SERVICE)
    other = [row | {"calibration_version": "another"} for row in map(row_of, history(9, vehicle="car2"))]
    Writer(engine).store(Batch(shifts=other))
    answer = vehicle_view.find(sources_of(engine), ask(vehicle_view.VIEW, "car2"))
    assert {one.outlook for one in answer.clutches} == {None}
    assert "has not told what calibration" in str(answer.clutches[0].why_no_outlook)


def test_a_shift_that_was_seen_live_and_in_a_log_counts_once(engine: Engine) -> None:
    live = history(120)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in live]))
    question = ask(vehicle_view.VIEW, "car1")
    once = vehicle_view.find(sources_of(engine), question)
    later = [replace(one, stream="from a log", produced_at="2026-03-01T00:00:00.000000Z") for one in live[:60]]
    Writer(engine).store(Batch(shifts=[row_of(one) for one in later]))
    twice = vehicle_view.find(sources_of(engine), question)
    assert [one.result_count for one in twice.clutches] == [90, 90]
    assert [one.trend for one in twice.clutches] == [one.trend for one in once.clutches]
    assert [one.outlook for one in twice.clutches] == [one.outlook for one in once.clutches]


def test_a_clock_that_was_ahead_hides_no_newer_results(engine: Engine) -> None:
    ahead = fleet_result(7, stream="a", condition=Condition.CHANGE_FLUID, produced_at="2038-01-19T03:14:07.000000Z")
    Writer(engine).store(Batch(shifts=[row_of(ahead)]))
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    newer = [fleet_result(seq, stream="b", produced_at=now) for seq in range(1, 40)]
    Writer(engine).store(Batch(shifts=[row_of(one) for one in newer]))
    assert [(one["stream"], one["seq"], one["condition"]) for one in queries.worst_first(engine)] == [("b", 39, "good")]
    assert [(one.stream, one.condition) for one in DatabaseSource(engine).all_clutches()] == [("b", "good")]
    assert [(one.stream, one.condition) for one in DatabaseSource(engine).clutches_of(["car1"])] == [("b", "good")]
    assert results_of(engine, "car1", 2)[-1]["stream"] == "b"
    assert [row["stream"] for row in queries.trend(engine, "car1", 2, Axis.SHIFT)][-1] == "b"
    (seen,) = queries.last_seen(engine)
    assert str(seen["last_result_at"]) < "2038"


def test_maintenance_is_by_day_over_all_parts_and_the_watch_keeps_it(engine: Engine) -> None:
    """What comes first by verdict and name is due last: it is driven least."""
    results = history(200)[:100]
    for number in range(5):
        ends = [NOW - timedelta(days=80.0 * (5.0 - number) * (1.0 - one.seq / len(results))) for one in results]
        seen = [{"end_at": at, "odometer_m": 1.0e6 * one.seq} for one, at in zip(results, ends, strict=True)]
        rows = [row_of(one) | {"vehicle": f"car{number}"} | told for one, told in zip(results, seen, strict=True)]
        Writer(engine).store(Batch(shifts=rows))

    def parts(sources: Sources) -> list[Due]:
        found = [maintenance_view.find(sources, ask(maintenance_view.VIEW, limit="3"))]
        while after := found[-1].next:
            found.append(maintenance_view.find(sources, ask(maintenance_view.VIEW, limit="3", after=after)))
        return [one for answer in found for one in answer.clutches]

    foretold = parts(sources_of(engine))
    days = [one.due_from or NOW.date() for one in foretold]
    assert days == sorted(days)
    assert [one.vehicle for one in foretold if one.clutch == 1] == ["car4", "car3", "car2", "car1", "car0"]
    WatchOfOffice(engine, Orders(), lambda: NOW).round(judging_s=float("inf"))
    sources, asked = sources_of(engine), Watch(engine)
    assert parts(sources) == foretold
    assert not [one for one, _ in asked.asked if "version_rank" in one]  # no result was read
    queries.note_fill(engine, "car2", "DCTF", at=NOW - timedelta(days=1), odometer_m=None, note=None)
    sources.keeper.refresh()
    again = parts(sources)
    assert {one.due_from for one in again if one.vehicle == "car2"} == {None}
    assert [one for one in again if one.vehicle != "car2"] == [one for one in foretold if one.vehicle != "car2"]


class Watch:
    """Collects the statements of a connection with their values."""

    def __init__(self, engine: Engine) -> None:
        self.asked: list[tuple[str, Any]] = []
        event.listen(engine, "before_cursor_execute", self._hear)

    def _hear(self, _connection: Connection, _cursor: object, statement: str, values: Any, *_: object) -> None:  # noqa: ANN401
        self.asked.append((statement, values))


@pytest.fixture(name="large")
def _large(postgres_url: str) -> Iterator[Engine]:
    """Return a database of 150 vehicles with 30,000 results, made of two."""
    engine = open_database(postgres_url)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in history(2)]))
    with transaction(engine) as connection:
        names = [name for (name,) in connection.execute(text(_COLUMNS_OF_RESULTS)) if name not in {"vehicle", "seq"}]
        connection.execute(text("INSERT INTO vehicle (vehicle) SELECT 'v' || n FROM generate_series(1, 150) AS n"))
        connection.execute(
            text("INSERT INTO clutch SELECT 'v' || n, c FROM generate_series(1, 150) AS n, generate_series(1, 2) AS c")
        )
        columns = ", ".join(names)
        connection.execute(text(
            f"INSERT INTO shift_result (vehicle, seq, {columns}) SELECT 'v' || n, s.seq + 2 * m, "  # noqa: S608
            + ", ".join(f"s.{name}" if name != "stored_at" else "s.stored_at - interval '1 hour' * m" for name in names)
            + " FROM shift_result AS s, generate_series(1, 150) AS n, generate_series(0, 99) AS m"
            " WHERE s.vehicle = 'car1'"
        ))  # fmt: skip
        connection.execute(text("ANALYZE"))
    yield engine
    engine.dispose()


_COLUMNS_OF_RESULTS = "SELECT column_name FROM information_schema.columns WHERE table_name = 'shift_result'"


def test_no_question_reads_all_results(large: Engine) -> None:
    keeper = Keeper(DatabaseSource(large))
    watch = Watch(large)
    keeper.refresh()
    assert len(keeper.snapshot.clutches) == 302
    sources = Sources(engine=large, keeper=keeper, news=News(keeper))
    since = (datetime.now(UTC) - timedelta(minutes=90)).isoformat()
    with transaction(large) as connection:
        connection.execute(text("UPDATE shift_result SET stored_at = now() WHERE vehicle = 'v9' AND seq = 9"))
    keeper.refresh()
    questions = (
        (clutches_view.VIEW, ask(clutches_view.VIEW)),
        (vehicle_view.VIEW, ask(vehicle_view.VIEW, "v7")),
        (shift_view.VIEW, ask(shift_view.VIEW, "v7", **SHIFT)),
        (changes_view.VIEW, ask(changes_view.VIEW, since=since)),
        (maintenance_view.VIEW, ask(maintenance_view.VIEW, limit="2")),
        (quarantine_view.VIEW, ask(quarantine_view.VIEW)),
    )
    for view, question in questions:
        view.show(view.find(sources, question), question, sources)
    plans = {}
    with large.connect() as connection:
        for statement, values in watch.asked:
            if statement.lstrip().startswith("SELECT"):
                found = connection.exec_driver_sql(f"EXPLAIN (FORMAT JSON) {statement}", values).scalar_one()
                plans[statement] = json.dumps(found)
    assert len(plans) > 10
    whole = re.compile(r'"Node Type": "Seq Scan"[^{}]*"Relation Name": "shift_result"')
    assert [statement for statement, plan in plans.items() if whole.search(plan)] == []


@pytest.mark.parametrize("is_first", [False, True])
def test_results_are_as_later_ones_have_judged_them_whichever_came_first(engine: Engine, is_first: bool) -> None:
    bad, later = fleet_result(1), fleet_result(2)
    misfit = Revision(
        clutch=bad.estimate.clutch,
        end_bus_ns=bad.estimate.end_ns,
        status=Status.REJECTED,
        reasons=(Reason.MISFIT,),
        friction=None,
        scale_free=None,
    )
    later = replace(later, estimate=replace(later.estimate, revisions=(misfit,)))
    for one in (later, bad) if is_first else (bad, later):
        Writer(engine).store(batch_of(take_all(message_of(one), NOW)))
    row, other = results_of(engine, bad.vehicle, bad.estimate.clutch)
    assert (row["status"], row["reasons"], row["mu_c"], other["status"]) == ("rejected", "misfit", None, "valid")
    shown = shift_of(engine, bad.vehicle, bad.stream, bad.seq)
    assert shown is not None
    assert (shown.status, shown.reasons, shown.friction) == ("rejected", ("misfit",), None)
