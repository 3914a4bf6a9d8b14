"""Every query of the dashboards on real databases, and the alert rule on a recording of the metrics of ageing fluid."""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
from sqlalchemy import Connection, Engine, create_engine
from sqlalchemy.exc import DBAPIError

from demo.fleet.servers import PostgresServer
from fleet_backend import queries
from fleet_backend.database import open_database
from fleet_backend.office.watching import Orders, Watch
from fleet_backend.rows import shift_row, status_row
from fleet_backend.writer import Batch, Writer
from tests.golden.compare import stored_faces
from tests.support import grafana
from tests.support.fleet_page import asked, sources_of, told
from tests.support.grafana import FOLDER, PROMETHEUS
from tests.support.histories import history
from tests.support.patience import HANG_S
from tests.support.prometheus import (
    MISSING,
    STALE,
    Samples,
    Series,
    answers,
    check_rules,
    group_of,
    promtool,
    recorded,
    series,
)
from tests.unit.diag_service.service.test_metrics import FILL, exposition, snapshot

FLEET = {"car1": "ideal", "car2": "case1", "car3": "case2"}  # good, watch, change fluid
START = datetime(2026, 1, 1, tzinfo=UTC)
SINCE, UNTIL = START - timedelta(days=1), START + timedelta(days=1)
FOR_MIN = 10  # how long a verdict must stand until the alert fires
PARKED_MIN = 120
TARGET = {"instance": "127.0.0.1:9464", "job": "clutchdiag"}
WORN = {"verdict": "change_fluid"}
SILENT = "Clutch {}: change the fluid now. The vehicle is silent at present, this was its last word."


@pytest.fixture(name="fleet", scope="module")
def _fleet(postgres_server: PostgresServer, postgres_template: str) -> Iterator[Connection]:
    """Yield the database of three vehicles, as Grafana's role sees it."""
    # A name of its own: a worker that takes tests of this file twice makes it twice.
    url = postgres_server.create(f"dashboards_{uuid4().hex}", postgres_template)
    owner = open_database(url)
    fill(owner)
    Watch(owner, Orders(), lambda: UNTIL - timedelta(hours=1)).round(judging_s=HANG_S)
    with owner.begin() as connection:
        ask(connection, (FOLDER / "reader.sql").read_text(encoding="utf-8"))
    reader = create_engine(url.replace("clutchdiag@", "grafana@"), isolation_level="AUTOCOMMIT")
    with reader.connect() as connection:
        yield connection
    reader.dispose()
    with owner.begin() as connection:
        ask(connection, "DROP ROLE grafana")
    owner.dispose()


def fill(engine: Engine) -> None:
    """Store what vehicles sent: results of stored analyses, their status, and the fills of two of them.

    Car 3 gets new fluid half-way. Its last running estimate rests on the earlier fluid: the fill was noted late.
    """
    records = [
        json.loads(line) | {"vehicle": vehicle}
        for vehicle, name in FLEET.items()
        for line in stored_faces(name)["results"].splitlines()
    ]
    shifts = [shift_row(record) for record in records if record["schema"] == "clutchdiag/shift/v1"]
    told = {"status": "online", "connected_at": "2026-01-01T00:00:00.000000Z", "service_version": "1"}
    versions = {"algorithm_version": "a", "calibration_version": "c"}
    statuses = [status_row({**told, **versions, "vehicle": vehicle}) for vehicle in FLEET]
    own = [row for row in shifts if row["vehicle"] == "car3"]
    own[-1]["running_since_bus_ns"] = own[0]["start_bus_ns"]
    Writer(engine).store(Batch(shifts=shifts, statuses=statuses))
    half_way = own[len(own) // 2]["start_at"]
    assert isinstance(half_way, datetime)
    for vehicle, at in {"car1": START, "car3": half_way}.items():
        queries.note_fill(engine, vehicle, "DCTF 75W", at=at, odometer_m=None, note=None)


def ask(connection: Connection, statement: str) -> list[Mapping[str, Any]]:
    """Return the rows of a statement that is sent as it stands."""
    result = connection.execution_options(no_parameters=True).exec_driver_sql(statement)
    return [dict(row) for row in result.mappings()] if result.returns_rows else []


def of_fleet(asker: str) -> str:
    """Return a query of the fleet's dashboard, as sent for all vehicles."""
    (query,) = (one for one in grafana.of_source("fleet") if one.asker == asker)
    return grafana.sql(query.text, list(FLEET), SINCE, UNTIL)


@pytest.mark.parametrize("query", grafana.of_source("fleet"), ids=str)
def test_a_query_of_the_fleet_has_rows(fleet: Connection, query: grafana.Query) -> None:
    rows = ask(fleet, grafana.sql(query.text, list(FLEET), SINCE, UNTIL))
    assert rows
    assert any(value is not None for row in rows for value in row.values())
    if query.panel is not None and query.panel["type"] == "timeseries":
        assert {tuple(row) for row in rows} == {("time", "metric", "value")}
        assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)
        assert all(row["time"].tzinfo is not None and row["value"] is not None for row in rows)


def test_the_fleet_is_told_as_it_is(fleet: Connection) -> None:
    (verdicts,) = ask(fleet, of_fleet("Vehicles by verdict A"))
    worst, alarms = ask(fleet, of_fleet("Worst first A")), ask(fleet, of_fleet("Open alarms A"))
    assert list(verdicts.values())[:4] == [1, 1, 1, 0]
    # What was last said of clutch 1 of car 3 rests on the earlier fluid.
    assert [row["vehicle"] for row in worst] == ["car3", "car2", "car2", "car1", "car1", "car3"]
    assert "it can shudder" in worst[0]["advice"]
    assert [(row["vehicle"], row["clutch"]) for row in alarms if row["rule"] == "verdict"] == [("car3", "2")]


def test_a_dashboard_shows_the_quantities_of_the_page(fleet: Connection) -> None:
    answer = told(fleet.engine, "/vehicles")
    (tiles,) = ask(fleet, of_fleet("Vehicles by verdict A"))
    groups = ("due_count", "silent_count", "alarm_count")
    assert list(tiles.values()) == [*answer["counts"].values(), *(answer[name] for name in groups)]
    clutches = {(row["vehicle"], row["clutch"]): row for row in ask(fleet, of_fleet("Worst first A"))}
    for now in answer["vehicles"]:
        row = clutches[now["vehicle"], now["clutch"]]
        assert row["verdict"] == now["condition"].replace("_", " ")
        assert (row["of new"], row["running mu_C"], row["running mu_S"]) == (
            now["level_ratio"],
            now["mu_c"],
            now["mu_s"],
        )
        assert (row["advice"], row["fluid"]) == (now["advice"], now["fluid"])
    for due in told(fleet.engine, "/maintenance")["clutches"]:
        left_km = clutches[due["vehicle"], due["clutch"]]["km left"]
        assert left_km == (None if due["left_m"] is None else pytest.approx(due["left_m"] / 1000.0))


ONLY_HERE = {  # numbers of a clutch that the page leaves to its JSON
    *("clutch", "advice", "shifts", "P(slope < 0)", "running mu_C ±", "running mu_S", "running mu_S ±")
}


@pytest.mark.parametrize(
    ("asker", "path"),
    [("Vehicles by verdict A", "/"), ("Worst first A", "/"), ("Open alarms A", "/alarms"), ("Fluid fills A", "/")],
)
def test_a_dashboard_has_the_words_of_the_page(fleet: Connection, asker: str, path: str) -> None:
    texts = [page.text for page in asked(sources_of(fleet.engine), path, "/vehicles/car3")]
    names = ask(fleet, of_fleet(asker))[0].keys() - ONLY_HERE
    assert [name for name in names if not any(name in text for text in texts)] == []


@pytest.mark.parametrize(
    "asker", ["running mu_C, at high slip B", "P(slope < 0) A", "of new: running mu_C over that of new fluid A"]
)
def test_a_curve_ends_at_a_fill_and_another_begins(fleet: Connection, asker: str) -> None:
    (annotation,) = (one for one in grafana.of_source("fleet") if one.asker == "New fluid")
    (filled,) = ask(fleet, grafana.sql(annotation.text, ["car3"], SINCE, UNTIL))
    (query,) = (one for one in grafana.of_source("fleet") if one.asker == asker)
    rows = ask(fleet, grafana.sql(query.text, ["car3"], SINCE, UNTIL))
    of_new = [row["time"] for row in rows if "DCTF 75W since 2026-01-01" in row["metric"]]
    of_old = [row["time"] for row in rows if row["time"] not in of_new]
    assert max(of_old) <= filled["time"] < min(of_new)
    (last,) = ask(fleet, "SELECT max(end_at) AS at FROM clutch_trend WHERE vehicle = 'car3'")
    assert max(of_new) < last["at"]  # whose running estimate is of the earlier fluid


@pytest.mark.parametrize("words", ["DELETE FROM quarantine", "CREATE TABLE mine (x int)", "DROP VIEW last_seen"])
def test_who_reads_the_fleet_cannot_write_it(fleet: Connection, words: str) -> None:
    with pytest.raises(DBAPIError, match="read-only transaction"):
        ask(fleet, words)
    with pytest.raises(DBAPIError, match=r"permission denied|must be owner"):
        ask(fleet, f"BEGIN READ WRITE; {words}")
    ask(fleet, "ROLLBACK")


@pytest.fixture(name="scrapes", scope="module")
def _scrapes() -> list[Samples]:
    return recorded()


def worn(scrapes: Sequence[Samples], clutch: str) -> list[bool]:
    """Return after which scrapes the verdict on a clutch was to change the fluid."""
    key = ("clutchdiag_clutch_verdict", frozenset({"vehicle": "car1", "clutch": clutch, **WORN}.items()))
    return [samples[key] == 1.0 for samples in scrapes]


def sentence(samples: Samples, clutch: str) -> str:
    """Return the sentence on a clutch in a scrape."""
    said = [dict(labels) for name, labels in samples if name == "clutchdiag_clutch_advice_info"]
    (found,) = (labels["advice"] for labels in said if labels["clutch"] == clutch)
    return found


def alert(clutch: str, description: str) -> dict[str, Any]:
    """Return an alert as promtool expects it."""
    labels = {"severity": "warning", "vehicle": "car1", "clutch": clutch, **WORN, **TARGET}
    notes = {"summary": "Change the transmission fluid of car1", "description": description}
    return {"exp_labels": labels, "exp_annotations": notes}


def case(minute: int, *alerts: Mapping[str, Any]) -> dict[str, Any]:
    """Return which alerts must fire at a minute, and no others."""
    return {"eval_time": f"{minute}m", "alertname": "ChangeFluid", "exp_alerts": list(alerts)}


def firing(scrapes: Sequence[Samples], minute: int) -> list[dict[str, Any]]:
    """Return the alerts at a minute, one scrape a minute: of verdicts that have stood for long enough."""
    return [
        alert(clutch, sentence(scrapes[minute], clutch))
        for clutch in ("1", "2")
        if minute >= FOR_MIN and all(worn(scrapes, clutch)[minute - FOR_MIN : minute + 1])
    ]


def parked(of: Series) -> Series:
    """Return series that end: the car is parked, and its target gone."""
    return {key: [*values, STALE, *[MISSING] * PARKED_MIN] for key, values in of.items()}


def with_new_fluid(of: Series) -> Series:
    """Return series after which the car is driven again, with new fluid: the verdict stands no more."""
    return {
        (name, labels): [*values, *(["0.0"] * FOR_MIN if labels >= frozenset(WORN.items()) else [])]
        for (name, labels), values in of.items()
    }


def test_an_alert_stands_from_bad_fluid_to_new_fluid_also_while_the_car_is_parked(
    tmp_path: Path, scrapes: list[Samples]
) -> None:
    last, gone = len(scrapes) - 1, len(scrapes) + PARKED_MIN
    assert firing(scrapes, FOR_MIN) == []
    said = [one["exp_annotations"]["description"] for one in firing(scrapes, last)]
    assert [text.split(":")[:2] for text in said] == 2 * [
        ["Change the fluid now. Clutch 1", " it can shudder (over 99 % sure). Clutch 2"]
    ]
    cases = [
        *(case(minute, *firing(scrapes, minute)) for minute in range(0, last, 4)),
        case(gone, *(alert(clutch, SILENT.format(clutch)) for clutch in ("1", "2"))),
        case(gone + 2),
    ]
    driven = with_new_fluid(parked(series(scrapes, **TARGET)))
    check_rules(tmp_path, [group_of("fluid turns bad", driven, alert_rule_test=cases)])


def test_every_query_of_the_live_dashboard_has_an_answer(tmp_path: Path, scrapes: list[Samples]) -> None:
    """Three vehicles: one has driven to the end of the recording, one half as far, one only begins."""
    count, of = len(scrapes), Series()
    for port, (vehicle, age) in enumerate({"car1": count, "car2": count // 2, "car3": count // 4}.items(), start=9464):
        seen = [*scrapes[:age], *[scrapes[age - 1]] * (count - age)]
        of |= series(seen, vehicle=vehicle, instance=f"127.0.0.1:{port}", job="clutchdiag")
    asked = [query.text for query in grafana.of_source("prometheus") if not query.text.startswith("label_values(")]
    assert len(asked) > 15
    sent = [grafana.promql(text, list(FLEET), "1h") for text in asked]
    late = [text for text in sent if "ALERTS" in text or "_mu_change_" in text]  # not every vehicle is so far
    cases = [answers(text, count - 1, vehicles=1 if text in late else len(FLEET)) for text in sent]
    check_rules(tmp_path, [group_of("three vehicles", of, promql_expr_test=cases)])


def test_prometheus_takes_configuration_rules_and_metrics(tmp_path: Path) -> None:
    assert "SUCCESS" in promtool("check", "config", PROMETHEUS / "prometheus.yml")
    promtool("check", "metrics", given=exposition(snapshot(*history(60), fluid=FILL)))
