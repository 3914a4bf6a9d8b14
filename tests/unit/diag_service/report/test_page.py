"""The page: the same numbers as JSON, no more than a screen can show, and no markup from outside."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from canlog.arrays import Series
from clutchdiag_io.pages.content import spread
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event, EventKind
from diag_service.diagnosis.records import (
    FluidFill,
    Reason,
    ShiftQuality,
    Status,
    clutch_record,
    dump,
    shift_record,
    utc_from_bus_ns,
)
from diag_service.errors import StoreError
from diag_service.report.findings import Album, Findings
from diag_service.report.history import history_lines
from diag_service.report.page import course_sections, html_of, page_of, record_of, write_page
from diag_service.report.pictures import Trend, trend_picture
from diag_service.store import Row
from fleet_contract.orders import Action
from tests.support.builders import shift_result
from tests.support.histories import findings, history

NOW = "2026-03-01T12:00:00.000000Z"
MOST_BYTES_SHORT, MOST_BYTES_LONG = 500_000, 2_000_000


def html(found: Findings) -> str:
    return html_of(page_of(found, NOW))


class Reader(HTMLParser):
    """Collects what a program can read of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.values: list[float] = []
        self.links: list[str] = []
        self.record = ""
        self._is_record = False
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.links += [value or "" for name, value in attrs if name in {"href", "src", "xlink:href"}]
        if tag == "data":
            self.values.append(float(known["value"] or "nan"))
        self._is_record = tag == "script"
        if tag not in {"meta", "path", "rect"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in {"path", "rect"}:
            assert self.open.pop() == tag
        self._is_record = False

    def handle_data(self, data: str) -> None:
        if self._is_record:
            self.record += data


def read(text: str) -> Reader:
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    return reader


def test_a_page_begins_with_the_order() -> None:
    found = findings(30)
    assert found.order.action is Action.CHANGE_AT_SERVICE
    text = html(found)
    assert text.index(found.order.text) < text.index("<main>")
    assert text.count('class="watch"') == text.count("<li class=") == 1


def test_a_page_closes_the_order_once_new_fluid_is_noted() -> None:
    fill = FluidFill(vehicle="car1", filled_at="2026-02-01T00:00:00.000000Z")
    text = html(replace(findings(30), fills=(fill,)))
    assert "New fluid since 2026-02-01 00:00 UTC: nothing is known of it yet." in text
    assert "at the next service" not in text


def test_the_numbers_are_those_of_the_results_to_the_last_digit() -> None:
    found = findings(30)
    text = html(found)
    reader = read(text)
    for result in found.latest:
        friction = result.verdict.friction
        assert friction is not None
        assert f'mu_C, at high slip</th><td><data value="{friction.mu_c!r}">{friction.mu_c:.4f}</data>' in text
        assert {friction.mu_c, 2.0 * friction.std_mu_c, friction.mu_s, result.verdict.level_ratio} <= set(reader.values)
    record = json.loads(reader.record)
    assert (
        record["clutches"]
        == json.loads(dump({"all": [clutch_record(shift_record(one), found.order) for one in found.latest]}))["all"]
    )
    assert record == json.loads(dump(record_of(found)))


def test_a_page_needs_nothing_from_anywhere() -> None:
    text = html(findings(30))
    assert all(link.startswith("#") for link in read(text).links)
    assert "http://" not in text.replace("http-equiv", "")
    assert "https://" not in text
    assert "@import" not in text
    assert "url(" not in text


@pytest.mark.parametrize(("count", "most_bytes"), [(30, MOST_BYTES_SHORT), (10_000, MOST_BYTES_LONG)])
def test_a_page_stays_small_and_says_what_it_leaves_out(count: int, most_bytes: int) -> None:
    text = html(findings(count))
    assert len(text.encode()) < most_bytes
    is_thinned = count > 600
    assert ("The newest 100 of 10000 events." in text) is is_thinned
    assert ("the lowest and the highest are drawn" in text) is is_thinned


@pytest.mark.parametrize(
    "evil", ["<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "</script><b>", "{{ 7 * 7 }}"]
)
def test_nothing_from_outside_becomes_markup(evil: str) -> None:
    found = findings(30)
    last = found.latest[-1]
    told = replace(last, verdict=replace(last.verdict, advice=evil, reason=evil))
    fill = FluidFill(vehicle="car1", filled_at="2026-01-01T00:01:00.000000Z", product=evil, note=evil)
    text = html(replace(found, vehicle=evil, sources=(evil,), latest=(told,), fills=(fill,)))
    assert evil not in text or evil.startswith("{{")
    assert "49" not in re.findall(r"<h1>(.*?)</h1>", text)[0]
    assert json.loads(read(text).record)["vehicle"] == evil


def test_one_shift_is_no_shifts() -> None:
    found = findings(30)
    (last, *rest) = found.latest
    text = html(replace(found, latest=(replace(last, verdict=replace(last.verdict, shift_count=1)), *rest)))
    assert f"Clutch {last.verdict.clutch}: running estimate from 1 shift<" in text
    assert "1 shifts" not in text


def test_one_event_is_no_events() -> None:
    found = findings(1)
    found = replace(found, rows=found.rows[:1])
    told = "\n".join(map(str, history_lines(found, (1, 2), most_rows=9)))
    assert "car1: 1 event\n" in told
    assert "1 event, " in html(found)
    assert not re.search(r"\b1 events", html(found) + told)


def test_logs_without_a_date_tell_their_own_seconds() -> None:
    found = findings(2)
    start_ns, end_ns, rows = 3_704_400_000_000, 3_705_000_000_000, []
    for row in found.rows:
        estimate = replace(row.result.estimate, start_ns=start_ns, end_ns=end_ns)
        rows.append(replace(row, result=replace(row.result, estimate=estimate)))
    text = html(replace(found, rows=tuple(rows)))
    assert ("2 events, without a date" in text, "start in the log" in text, "3704.4 s" in text) == (True, True, True)
    assert "start (UTC)" in html(found)
    assert ("end in the log" in text, "end (UTC)" in text) == (True, False)


def test_the_days_are_in_order_whatever_log_was_analysed_first() -> None:
    found = findings(2)
    old, late = found.results
    day_ns = 86_400 * 10**9
    late_estimate = replace(
        late.estimate, start_ns=late.estimate.start_ns + day_ns, end_ns=late.estimate.end_ns + day_ns
    )
    rows = [Row(position=1, result=replace(late, estimate=late_estimate)), Row(position=2, result=old)]
    assert "2 events, 2026-01-01 to 2026-01-02, from" in html(replace(found, rows=tuple(rows)))


def test_a_history_without_anything_says_so() -> None:
    nothing = replace(findings(1), rows=(), latest=())
    text = html(nothing)
    assert "no event in car1.sqlite" in text
    assert "Clutch 1: no event engaged it." in text
    assert "Clutch 2: no event engaged it." in text
    assert "No clutch has a running estimate" in text


def test_a_calibration_that_is_not_at_hand_is_told() -> None:
    text = html(replace(findings(30), calibration=None, left_out_count=3))
    assert "name it by --calibration" in text
    assert "3 results of other algorithms or calibrations are left out." in text
    assert "Clutch 1: friction over slip" not in text


def test_thresholds_and_moments_are_in_the_pictures() -> None:
    start = utc_from_bus_ns(history(60)[40].estimate.start_ns)
    text = html(replace(findings(60), fills=(FluidFill(vehicle="car1", filled_at=start),)))
    for word in ("watch: 90 %", "change: 80 %", "new: 100 %", "new fluid", "baseline", ">watch<"):
        assert word in text


def test_moments_stand_where_they_happened() -> None:
    results = [result for result in history(60) if result.estimate.clutch == 1]
    trend = Trend.of(1, results, [utc_from_bus_ns(results[9].estimate.start_ns)])
    kinds = {kind: place for place, kind, _ in trend.moments}
    assert kinds["fill"] == 10
    assert results[kinds["watch"] - 2].verdict.condition is not results[kinds["watch"] - 1].verdict.condition
    assert trend.new_mu_c == pytest.approx(0.14)


def test_the_trend_of_a_clutch_breaks_where_its_fluid_was_changed() -> None:
    results = [result for result in history(60) if result.estimate.clutch == 1]
    fill = utc_from_bus_ns(results[9].estimate.start_ns)
    for fills, stretches in (([], 1), ([fill], 2)):
        (line,) = re.findall(
            r'<path d="([^"]*)" class="line strong clutch1"', trend_picture(Trend.of(1, results, fills))
        )
        assert line.count("M") == stretches


def test_new_fluid_without_an_event_yet_is_marked_behind_the_last() -> None:
    trend = Trend.of(1, history(9), ["2027-01-01T00:00:00.000000Z"])
    assert (10, "fill", "new fluid") in trend.moments


def event_of(number: int) -> Event:
    t_ns = np.arange(-20, 120) * 10_000_000
    series = Series(t_ns=t_ns, sequence=np.arange(len(t_ns)), value=np.linspace(100.0, 300.0, len(t_ns)))
    return Event(
        number=number,
        from_gear=1,
        to_gear=2,
        start_ns=0,
        end_ns=1_000_000_000,
        end_reason=EndReason.COMPLETE,
        columns={Signal.ENGINE_SPEED: series, Signal.CLUTCH2_PRESSURE: series},
        bad_frame_count=0,
    )


def test_the_best_shift_and_the_worst_rejected_one_are_shown_with_their_samples() -> None:
    album, results = Album(), history(14)
    for number, result in enumerate(results, 1):
        album.offer(event_of(number), result)
    used, refused = album.examples
    assert used.result.estimate.status is Status.VALID
    assert refused.result.estimate.reasons == (Reason.FRAMES_MISSING,)
    text = html(replace(findings(14), examples=album.examples))
    assert "Event 7, shift" in text
    assert "rejected (frames missing): speeds" in text
    assert text.count("during the shift [rpm]") == 2
    assert "torques" not in text  # no signal of that kind was there
    read(text)


def test_where_no_shift_tells_friction_a_gear_change_is_shown() -> None:
    album, lacking = Album(), replace(shift_result().estimate, status=Status.UNOBSERVED, friction=None)
    launch = replace(lacking, kind=EventKind.LAUNCH, number=1)
    for estimate in (launch, replace(lacking, number=2), replace(lacking, number=3)):
        album.offer(event_of(estimate.number), replace(shift_result(), estimate=estimate))
    assert [one.result.estimate.number for one in album.examples] == [2]
    for result in history(14):
        album.offer(event_of(1), result)
    assert [one.result.estimate.status for one in album.examples] == [Status.VALID, Status.REJECTED]


def test_examples_keep_samples_of_their_own() -> None:
    album, event = Album(), event_of(1)
    album.offer(event, shift_result())
    event.columns[Signal.ENGINE_SPEED].value[:] = 0.0
    assert album.examples[0].event.columns[Signal.ENGINE_SPEED].value[0] == 100.0


def test_a_page_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(StoreError, match="cannot write"):
        write_page(tmp_path / "report.html", page_of(findings(3), NOW))
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(("count", "most"), [(0, 5), (1, 5), (5, 5), (6, 5), (1000, 12)])
def test_places_are_spread_evenly_from_first_to_last(count: int, most: int) -> None:
    places = spread(range(count), most)
    assert len(places) == min(count, most)
    assert places == sorted(set(places))
    assert not places or (places[0], places[-1]) == (0, count - 1)


def test_a_page_says_how_well_it_shifts_where_that_is_known() -> None:
    assert "How well it shifts" not in html(findings(6))
    quality = ShiftQuality(score=70.0, reasons=("jerk_m_s3",), slip_energy2_j=5e6, peak2_k=361.0, life2_ratio=5.803e-4)
    rows = tuple(
        replace(row, result=replace(row.result, estimate=replace(row.result.estimate, shift_quality=quality)))
        for row in findings(6).rows
    )
    (section,) = course_sections(replace(findings(6), rows=rows))
    scores, load = section.tables
    assert [cell if isinstance(cell, str) else str(getattr(cell, "text", "")) for cell in scores.rows[0]][-1] == "jerk"
    assert [cell if isinstance(cell, str) else str(getattr(cell, "text", "")) for cell in load.rows[0]][7:] == [
        "30.00",
        "88",
        "0",
        "0.3482 %",
    ]
    assert "How well it shifts" in html(replace(findings(6), rows=rows))
