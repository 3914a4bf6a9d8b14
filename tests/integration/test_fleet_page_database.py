"""What the page reads from each database: lists in parts, plans that read no whole table."""

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from rich.console import Console
from sqlalchemy import Connection, Engine, event, text

from clutch_results.clocks import nanoseconds
from clutch_results.event_kinds import EventKind, PackHeat, ShiftParts, ShiftQuality
from clutch_results.pictures import MOST_POINTS
from clutch_results.prognosis import history_of, prognose
from clutch_results.prognosis.sentence import outlook_line
from clutch_results.records import Causes, Condition, LikelyCause, Reason, Revision, ShiftResult, Status
from fleet_backend import queries
from fleet_backend.ageing.prognosis import foretold_now
from fleet_backend.ageing.results import results_of, shift_of
from fleet_backend.alarms.rules import AlarmRule
from fleet_backend.choices import TrendAxis
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.intake import batch_of, receive_all
from fleet_backend.office.watching import Orders
from fleet_backend.office.watching import Watch as WatchOfOffice
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.queries import DatabaseSource, keep_dues
from fleet_backend.page.routes import NEWEST
from fleet_backend.page.site import Sources
from fleet_backend.report import fleet_table
from fleet_backend.writer import Batch, Writer
from fleet_contract.orders import Action
from tests.support.builders import friction_estimate
from tests.support.fleet import NOW, fleet_result, message_of, row_of
from tests.support.fleet_page import asked, sources_of, told
from tests.support.histories import CALIBRATION, history


def parts_of(sources: Sources, path: str, name: str) -> list[Any]:
    """Return the rows of all parts of a list of programs, three at a time."""
    found: list[Any] = []
    offset: int | None = 0
    while offset is not None:
        part = told(sources, f"{path}?limit=3&offset={offset}")
        found += part[name]
        offset = part["next"]
    return found


def scored(seq: int, score: float, touch_error_pa: float = 0.0) -> ShiftResult:
    """Return a result of a change that went so well."""
    given = fleet_result(seq, vehicle="rough")
    quality = ShiftQuality(
        score=score,
        reasons=("jerk_m_s3",),
        parts=ShiftParts(touch_error_pa=touch_error_pa, std_touch_error_pa=1e3),
        packs=(PackHeat(), PackHeat(slip_energy_j=5e3, peak_k=390.0, life_ratio=6e-7)),
    )
    return replace(given, estimate=replace(given.estimate, kind=EventKind.POWER_ON_UPSHIFT, shift_quality=quality))


def test_how_well_a_vehicle_shifts_is_on_its_page_and_a_fall_raises_an_alarm(engine: Engine) -> None:
    good = [scored(seq, 90.0) for seq in range(1, 31)]
    Writer(engine).store(Batch(shifts=[*map(row_of, good), row_of(fleet_result(1, vehicle="old"))]))
    watch = WatchOfOffice(engine, Orders(), lambda: NOW)
    assert AlarmRule.SCORE not in {step.subject.rule for step in watch.round()}
    Writer(engine).store(Batch(shifts=[row_of(scored(seq, 60.0, 9e3)) for seq in range(31, 51)]))
    raised = {step.subject.rule: step for step in watch.round()}
    assert "clutch 2 score 30 points less than the first" in raised[AlarmRule.SCORE].reason
    sources = sources_of(engine)
    answer = told(sources, "/vehicles/rough")
    (change,), (load,) = answer["changes"], answer["loads"]
    assert (change["count"], change["first"], change["last"]) == (50, 90.0, 60.0)
    assert (load["clutch"], load["counts"], load["energy_j"]) == (2, [0, 0, 0, 50, 0, 0], 250e3)
    assert load["peak_k"] == 390.0
    assert [point["score"] for point in answer["clutches"][0]["trend"]] == [90.0] * 30 + [60.0] * 20
    page, event = (
        one.text for one in asked(sources, "/vehicles/rough", "/vehicles/rough/shift?stream=stream-1&seq=50")
    )
    untold = "jerk, torque hole, flare, tie up, fill error, lock rate, overtime, temperature rise"
    assert "Power on upshift 1-2 scores 60: jerk." in page
    assert f"Scores are without what the signals do not tell: {untold}." in page
    assert "Score of the gear changes, 100 is faultless" in page
    assert "How well it went" in event
    old = told(sources, "/vehicles/old")  # of an older program
    assert (old["changes"], old["loads"]) == ([], [])
    assert {one.vehicle: one.score for one in DatabaseSource(engine).all_clutches()} == {"rough": 60.0, "old": None}
    one = shift_of(engine, "rough", "stream-1", 50)
    assert one is not None
    assert one["shift_quality"]["touch_error_pa"] == 9e3


def test_a_cause_that_new_fluid_does_not_mend_is_on_the_page_in_the_list_and_an_alarm(engine: Engine) -> None:
    """Until the fluid is changed: what was told then is of the fluid before."""
    worn, fluids = fleet_result(1, vehicle="worn", condition=Condition.CHANGE_FLUID), ("aged-fluid", "water", "air")
    likely = (
        LikelyCause(cause="glazed-lining", clutch=2, probability=0.93, evidence="For it: friction of clutch 2 -20 %."),
        *(LikelyCause(cause=one, clutch=None, probability=0.02, evidence=f"For {one}: nothing.") for one in fluids),
    )
    causes = Causes(event_count=60, likely=likely, advice="Glazed lining of clutch 2: renew it.", test=None)
    caused = replace(worn, verdict=replace(worn.verdict, causes=causes))
    unclear = row_of(replace(fleet_result(1, vehicle="unclear"), verdict=caused.verdict)) | {"causes": '{"likely": []}'}
    Writer(engine).store(Batch(shifts=[row_of(caused), row_of(fleet_result(1, vehicle="plain")), unclear]))
    watch = WatchOfOffice(engine, Orders(), lambda: NOW)
    raised = {
        (one.subject.vehicle, one.subject.clutch): one for one in watch.round() if one.subject.rule is AlarmRule.CAUSE
    }
    order = "See to another cause than the fluid first: glazed lining of clutch 2 (93 % likely)."
    assert {subject: one.reason.partition(" Clutch 1")[0] for subject, one in raised.items()} == {("worn", 0): order}
    listed = {str(one["vehicle"]): one for one in queries.worst_first(engine)}
    assert (listed["worn"]["action"], listed["unclear"]["action"]) == ("find_cause", "change_now")
    assert str(listed["worn"]["order"]).startswith(order)
    assert listed["worn"]["causes"] == json.loads(str(row_of(caused)["causes"]))
    assert listed["plain"]["causes"] is None
    sources = sources_of(engine)
    answer = told(sources, "/vehicles/worn")
    assert answer["action"] == "find_cause"
    assert [one["cause"] for one in answer["causes"]["likely"]] == ["glazed-lining", *fluids[:2]]
    (page,) = asked(sources, "/vehicles/worn")
    for words in ("Why", "Glazed lining of clutch 2: renew it.", "glazed lining of clutch 2", "water"):
        assert words in page.text
    assert "For it: friction of clutch 2 -20 %." in page.text
    for vehicle in ("plain", "unclear"):
        assert told(sources, f"/vehicles/{vehicle}")["causes"] is None
    queries.note_fill(engine, "worn", "DCTF", at=NOW, odometer_m=None, note=None)
    assert not [one for one in watch.round() if one.subject.rule is AlarmRule.CAUSE]  # it stays until more is known
    answer = told(engine, "/vehicles/worn")
    assert (answer["action"], answer["causes"]) == ("new_fluid", None)


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


def test_an_open_page_is_made_again_only_when_it_has_news(engine: Engine) -> None:
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(1, vehicle=name)) for name in ("car1", "car2")]))
    sources, paths = sources_of(engine), ("/", "/vehicles/car1", "/vehicles/car2")
    marks = [answer.headers["etag"] for answer in asked(sources, *paths)]

    def statuses() -> list[int]:
        return [asked(sources, path, mark=mark)[0].status_code for path, mark in zip(paths, marks, strict=True)]

    assert statuses() == [304, 304, 304]
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(2))]))
    sources.keeper.refresh()
    assert statuses() == [200, 200, 304]


def test_the_prognosis_is_that_of_the_service(engine: Engine) -> None:
    results = history(200)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in results]))
    answer = told(engine, "/vehicles/car1?service_km=20000")
    founds = []
    for one in answer["clutches"]:
        clutch = one["now"]["clutch"]
        past = history_of(results, (), clutch)
        found = prognose(clutch, past, CALIBRATION.clutches[clutch - 1].friction, service_distance_m=2.0e7)
        founds.append(found)
        for shown, meant in (
            (one["outlook"]["watch"], found.watch),
            (one["outlook"]["change_fluid"], found.change_fluid),
        ):
            assert meant is not None
            names = ("p10_m", "p50_m", "p90_m", "probability_before_service")
            assert shown == {name: getattr(meant, name) for name in names}
    assert answer["outlook"] == outlook_line(founds, Action.CHANGE_AT_SERVICE)
    other = [row | {"calibration_version": "another"} for row in map(row_of, history(9, vehicle="car2"))]
    Writer(engine).store(Batch(shifts=other))
    answer = told(engine, "/vehicles/car2")
    assert {one["outlook"] for one in answer["clutches"]} == {None}
    assert "has not told what calibration" in answer["clutches"][0]["why_no_outlook"]


def test_many_results_are_read_once_and_their_chart_is_thinned(engine: Engine) -> None:
    Writer(engine).store(Batch(shifts=[row_of(one) for one in history(1500)]))
    sources, watch = sources_of(engine), Watch(engine)
    watch.asked.clear()
    (page,) = asked(sources, "/vehicles/car1")
    questions = [statement for statement, _ in watch.asked if statement.lstrip().startswith("SELECT")]
    of_results = [statement for statement in questions if "shift_result.shift_quality" in statement]
    assert len(of_results) == 3  # of each clutch its results, and the last one with its causes
    assert len(questions) <= 14
    record = re.search(r'id="fan">(.*?)</script>', page.text)
    assert record is not None
    points = [len(past["x"]) for past in json.loads(record[1])["pasts"]]
    assert [MOST_POINTS // 2 < count <= MOST_POINTS + 2 for count in points] == [True, True]
    assert page.text.count("/vehicles/car1/shift?") == 2 * NEWEST


def test_a_shift_that_was_seen_live_and_in_a_log_counts_once(engine: Engine) -> None:
    live = history(120)
    Writer(engine).store(Batch(shifts=[row_of(one) for one in live]))
    once = told(engine, "/vehicles/car1")["clutches"]
    later = [replace(one, stream="from a log", produced_at="2026-03-01T00:00:00.000000Z") for one in live[:60]]
    Writer(engine).store(Batch(shifts=[row_of(one) for one in later]))
    twice = told(engine, "/vehicles/car1")["clutches"]
    assert [one["result_count"] for one in twice] == [90, 90]
    assert [one["trend"] for one in twice] == [one["trend"] for one in once]
    assert [one["outlook"] for one in twice] == [one["outlook"] for one in once]


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
    assert [row["stream"] for row in queries.trend(engine, "car1", 2, TrendAxis.SHIFT)][-1] == "b"
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

    sources = sources_of(engine)
    unknown = parts_of(sources, "/maintenance", "clutches")
    assert {one["text"].endswith("Not foretold yet: fleet-backend watch does so.") for one in unknown} == {True}
    sources.keeper.work_ahead(float("inf"))
    foretold = parts_of(sources, "/maintenance", "clutches")
    days = [one["due_from"] or str(NOW.date()) for one in foretold]
    assert days == sorted(days)
    assert [one["vehicle"] for one in foretold if one["clutch"] == 1] == ["car4", "car3", "car2", "car1", "car0"]
    WatchOfOffice(engine, Orders(), lambda: NOW).round(judging_s=float("inf"))
    sources, asked_of = sources_of(engine), Watch(engine)
    assert parts_of(sources, "/maintenance", "clutches") == foretold
    assert asked_of.asked == []  # nothing is read for a reader
    queries.note_fill(engine, "car2", "DCTF", at=NOW - timedelta(days=1), odometer_m=None, note=None)
    sources.keeper.refresh()
    again = parts_of(sources, "/maintenance", "clutches")
    assert {one["due_from"] for one in again if one["vehicle"] == "car2"} == {None}
    others = [one for one in foretold if one["vehicle"] != "car2"]
    assert [one for one in again if one["vehicle"] != "car2"] == others


def test_km_left_of_a_fluid_without_a_trend_stand_wherever_the_fleet_is_listed(engine: Engine) -> None:
    """The vehicle's page says "at least so many": the lists say the same."""
    new = [replace(one, estimate=replace(one.estimate, friction=friction_estimate())) for one in history(60)]
    Writer(engine).store(Batch(shifts=list(map(row_of, new))))
    sources = sources_of(engine)
    sources.keeper.work_ahead(float("inf"))
    answer = told(sources, "/vehicles/car1")
    assert "No trend yet" in answer["outlook"]
    least_m = min(clutch["outlook"]["change_fluid"]["p10_m"] for clutch in answer["clutches"])
    assert least_m > 0.0
    dues = told(sources, "/maintenance")["clutches"]
    assert [(due["left_m"], due["least_left_m"]) for due in dues] == [(None, least_m)] * 2
    words = f"at least {float(f'{least_m / 1000.0:.2g}'):,.0f} (90 % sure)"
    for page in asked(sources, "/", "/maintenance"):
        assert words in re.sub("<[^>]*>", "", page.text)
    (row,) = csv.DictReader(io.StringIO(asked(sources, "/vehicles.csv")[0].text))
    assert (row["left_m"], float(row["least_left_m"])) == ("", least_m)
    keep_dues(engine, {"car1": foretold_now(engine, sources.keeper.snapshot.vehicles["car1"], None)}, NOW)
    records = queries.with_distances(engine, queries.worst_first(engine))
    assert [record["least_left_m"] for record in records] == [least_m, least_m]
    console = Console(width=300, file=io.StringIO())
    with console.capture() as shown:
        console.print(fleet_table(records))
    assert words.removesuffix(" (90 % sure)") in shown.get()


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
    with transaction(large) as connection:
        connection.execute(text("UPDATE shift_result SET stored_at = now() WHERE vehicle = 'v9' AND seq = 9"))
    keeper.refresh()
    paths = [f"/{name}" for name in ("", "vehicles/v7", "maintenance", "alarms")]
    paths += ["/vehicles/v7/shift?stream=stream-1&seq=9"]
    answers = asked(Sources(engine=large, keeper=keeper), *paths)
    assert [one.status_code for one in answers] == [200] * len(paths)
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
        Writer(engine).store(batch_of(receive_all(message_of(one), NOW)))
    row, other = results_of(engine, bad.vehicle, bad.estimate.clutch)
    assert (row["status"], row["reasons"], row["mu_c"], other["status"]) == ("rejected", "misfit", None, "valid")
    shown = shift_of(engine, bad.vehicle, bad.stream, bad.seq)
    assert shown is not None
    assert (shown["status"], shown["reasons"], shown["friction"]) == ("rejected", ("misfit",), None)


def test_a_vehicle_begins_with_odometer_and_fluid_and_says_what_alarmed_once(engine: Engine) -> None:
    rows = [
        row_of(fleet_result(seq, vehicle="worn", condition=Condition.CHANGE_FLUID, clutch=1 + seq % 2))
        for seq in range(1, 7)
    ]
    Writer(engine).store(Batch(shifts=[row | {"odometer_m": 6.05e7} for row in rows]))
    WatchOfOffice(engine, Orders(), lambda: NOW).round()
    vehicle, alarms = (
        re.sub("<[^>]*>", "", page.text) for page in asked(sources_of(engine), "/vehicles/worn", "/alarms")
    )
    assert "Odometer 60,500 km, no fill of the fluid noted" in vehicle
    assert vehicle.index("Odometer") < vehicle.index("Change the fluid now.")
    (happened,) = re.findall("alarm verdict of clutch 1 and verdict of clutch 2: (.*)", vehicle)
    assert happened.startswith("Change the fluid now.")
    assert vehicle.count("Change the fluid now.") == 2  # the order, and what alarmed
    assert (alarms.count("Change the fluid now."), alarms.count("as above")) == (1, 1)
    queries.note_fill(engine, "worn", "DCTF 75W", at=NOW, odometer_m=None, note=None)
    assert "Odometer 60,500 km, DCTF 75W since 2026-03-01" in re.sub(
        "<[^>]*>", "", asked(sources_of(engine), "/vehicles/worn")[0].text
    )


def test_dates_of_more_than_a_day_after_their_receipt_are_told_with_the_order(engine: Engine) -> None:
    ahead = fleet_result(7, stream="a", condition=Condition.CHANGE_FLUID)
    ahead = replace(ahead, estimate=replace(ahead.estimate, end_ns=nanoseconds("2101-10-01T00:00:00Z")))
    Writer(engine).store(Batch(shifts=[row_of(ahead), row_of(fleet_result(1, vehicle="good"))]))
    told_of = {row["vehicle"]: row["order"] for row in queries.worst_first(engine)}
    note = (
        "The vehicle's clock was wrong: results are dated up to 2101-10-01, after their receipt; they count as of "
        "that. Set the clock."
    )
    assert told_of["car1"].endswith(note)
    assert "clock" not in told_of["good"]
    (now,) = DatabaseSource(engine).clutches_of(["car1"])
    assert now.order == told_of["car1"]
