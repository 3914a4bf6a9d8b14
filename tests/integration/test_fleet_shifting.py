"""Vehicles that cannot tell friction, in the fleet: what they tell instead, on the page, to programs and in tables."""

import csv
import io
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from sqlalchemy import Engine, select

from clutch_results.records import Condition, ShiftResult, Tier, shift_record
from clutch_results.shifting import shifting_of, shifting_record, unknown_friction_words
from fleet_backend import queries
from fleet_backend.database import transaction
from fleet_backend.page.site import Sources
from fleet_backend.rows import shift_row
from fleet_backend.schema import SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_page import asked, sources_of, told
from tests.support.shiftings import drives, scattered

UNKNOWN = "Friction: cannot be known from this car; shifting: "
VERDICTS = ("change_fluid", "watch", "good")


def of_vehicle(results: Sequence[ShiftResult], vehicle: str) -> list[ShiftResult]:
    return [replace(result, vehicle=vehicle) for result in results]


@pytest.fixture(name="torques", scope="module")
def _torques() -> list[ShiftResult]:
    """Return three drives in a year of a car without pressures, whose slip grows by half."""
    return of_vehicle(scattered(np.random.default_rng(5), [0, 120, 240], 40, growth=0.5, among=0.01), "torques")


@pytest.fixture(name="sources")
def _sources(engine: Engine, torques: list[ShiftResult]) -> Sources:
    speeds = of_vehicle(drives([0], 12, lambda _day, event: 1.0 + 0.01 * event, tier=Tier.KINEMATIC), "speeds")
    young = fleet_result(1, vehicle="young", condition=Condition.NO_VERDICT)
    judged = [fleet_result(1, vehicle=condition, condition=Condition[condition.upper()]) for condition in VERDICTS]
    Writer(engine).store(Batch(shifts=list(map(row_of, [*torques, *speeds, young, *judged]))))
    sources = sources_of(engine)
    sources.keeper.work_ahead(float("inf"))
    return sources


def test_the_sentence_is_that_of_all_its_events_as_the_service_has_them(
    sources: Sources, torques: list[ShiftResult]
) -> None:
    listed = {now["vehicle"]: now for now in told(sources, "/vehicles")["vehicles"]}
    expected = unknown_friction_words(shifting_of(torques))
    assert expected.startswith(UNKNOWN + "120 events in 3 drives; ")
    assert "longer than in March" in expected
    assert (listed["torques"]["shifting"], listed["torques"]["tier"]) == (expected, 2)
    assert listed["speeds"]["shifting"].startswith(UNKNOWN + "12 events; ")
    assert listed["speeds"]["tier"] == 3
    assert {now["shifting"] for name, now in listed.items() if name not in {"torques", "speeds"}} == {None}


def test_there_is_never_a_verdict_on_its_fluid(sources: Sources) -> None:
    listed = {now["vehicle"]: now for now in told(sources, "/vehicles")["vehicles"]}
    for name in ("torques", "speeds"):
        assert (listed[name]["condition"], listed[name]["action"]) == ("no_verdict", "measure_again")
        answer = told(sources, f"/vehicles/{name}")
        assert (answer["outlook"], answer["order"].splitlines()[0]) == (
            None,
            "There is no verdict on the fluid: friction cannot be known from this car.",
        )
        due = next(due for due in told(sources, "/maintenance")["clutches"] if due["vehicle"] == name)
        assert (due["due_from"], due["left_m"], due["least_left_m"]) == (None, None, None)
        assert due["text"].endswith("friction cannot be known from this car. Nothing is foretold of it.")
        (page,) = asked(sources, f"/vehicles/{name}")
        assert "Drive 20 gear changes" not in page.text
        assert "How the fluid went" not in page.text


def test_they_stand_behind_all_that_are_judged_and_those_that_will_be(sources: Sources, engine: Engine) -> None:
    order = [*VERDICTS, "young", "torques", "speeds"]
    assert [now["vehicle"] for now in told(sources, "/vehicles")["vehicles"]] == order
    assert [row["vehicle"] for row in queries.worst_first(engine)] == order
    with transaction(engine) as connection:
        view = select(queries.FLEET_WORST_FIRST.c.vehicle).order_by(queries.FLEET_WORST_FIRST.c.place)
        assert list(connection.scalars(view)) == order


def test_they_are_found_by_filters_and_by_the_order_of_tiers(sources: Sources) -> None:
    def names(query: str) -> list[str]:
        return [now["vehicle"] for now in told(sources, f"/vehicles?{query}")["vehicles"]]

    assert names("only=untold") == ["torques", "speeds"]
    assert (names("tier=2"), names("tier=3")) == (["torques"], ["speeds"])
    assert names("sort=-tier")[:2] == ["speeds", "torques"]
    assert told(sources, "/vehicles")["untold_count"] == 2
    (page,) = asked(sources, "/")
    assert '<a href="/?only=untold"><strong>2</strong> cannot tell friction</a>' in page.text
    assert asked(sources, "/api/v1/vehicles?tier=4")[0].status_code == 400


def test_the_table_for_spreadsheets_has_tier_and_sentence(sources: Sources) -> None:
    (answer,) = asked(sources, "/vehicles.csv")
    rows = {row["vehicle"]: row for row in csv.DictReader(io.StringIO(answer.text))}
    assert [rows[name]["tier"] for name in ("good", "torques", "speeds")] == ["1", "2", "3"]
    assert rows["torques"]["shifting"].startswith(UNKNOWN)
    assert rows["good"]["shifting"] == ""


def test_a_vehicle_has_its_shifting_by_kind_and_gears_with_what_changed(
    sources: Sources, torques: list[ShiftResult]
) -> None:
    answer = told(sources, "/vehicles/torques")
    assert answer["tier"] == 2
    expected = json.loads(json.dumps(shifting_record(shifting_of(torques))))
    assert {name: answer["shifting"][name] for name in expected} == expected
    (page,) = asked(sources, "/vehicles/torques")
    text = unescape(re.sub(r"<[^>]+>", " ", page.text))
    assert "How it shifts" in text
    row = next(line for line in page.text.splitlines() if "power on upshift" in line and "<td" in line)
    slip = expected["rows"][0]["measures"]["slip_duration_s"]
    assert f'data-name="slip time [s]">{slip["mean"]:.2f} ± ' in row
    changed = page.text[page.text.index("What changed since the first drive") :]
    slip_time = re.search(r'all events.*?data-name="slip time">([^<]*)<', changed)
    assert slip_time is not None
    assert re.fullmatch(r"\+\d+ ± \d+ %", slip_time[1])
    assert told(sources, "/vehicles/good")["shifting"] is None
    assert "How it shifts" not in asked(sources, "/vehicles/good")[0].text


def test_until_it_is_worked_out_the_list_says_so_and_an_open_page_renews_itself(
    engine: Engine, torques: list[ShiftResult]
) -> None:
    Writer(engine).store(Batch(shifts=list(map(row_of, torques))))
    sources = sources_of(engine)
    (page,) = asked(sources, "/")
    assert "shifting: not worked out yet" in page.text
    sources.keeper.work_ahead(float("inf"))
    (renewed,) = asked(sources, "/", mark=page.headers["etag"])
    assert (renewed.status_code, "120 events in 3 drives" in renewed.text) == (200, True)
    assert asked(sources, "/", mark=renewed.headers["etag"])[0].status_code == 304


def test_what_a_reader_was_shown_is_worked_out_first(engine: Engine, torques: list[ShiftResult]) -> None:
    judged = [row_of(fleet_result(1, vehicle=f"car{number}")) for number in range(20)]
    Writer(engine).store(Batch(shifts=[*judged, *map(row_of, torques)]))
    sources = sources_of(engine)
    sources.keeper.work_ahead(0.0)  # one vehicle: the worst
    assert "not worked out yet" in asked(sources, "/?only=untold")[0].text
    sources.keeper.work_ahead(0.0)
    assert "120 events in 3 drives" in asked(sources, "/?only=untold")[0].text


def test_only_what_tells_no_friction_keeps_its_indices(torques: list[ShiftResult]) -> None:
    row = shift_row(shift_record(torques[0]))
    kept = json.loads(str(row["indices"]))
    assert kept["slip_duration_s"] == torques[0].estimate.indices.slip_duration_s  # type: ignore[union-attr]
    assert all(isinstance(value, float) for value in kept.values())
    first = fleet_result(1)
    told_too = replace(first, estimate=replace(first.estimate, indices=torques[0].estimate.indices))
    assert (row_of(told_too)["tier"], row_of(told_too)["indices"]) == (1, None)
    assert {"tier", "indices"} <= set(SHIFT_RESULT.columns.keys())
    older = {name: value for name, value in shift_record(torques[0]).items() if name not in {"tier", "indices"}}
    assert (shift_row(older)["tier"], shift_row(older)["indices"]) == (None, None)


def test_one_event_tells_its_indices_to_programs(sources: Sources, torques: list[ShiftResult]) -> None:
    first = torques[0]
    event = told(sources, f"/vehicles/torques/shift?stream={first.stream}&seq={first.seq}")
    assert event["tier"] == 2
    assert event["indices"]["slip_duration_s"] == first.estimate.indices.slip_duration_s  # type: ignore[union-attr]
