"""The page of a vehicle and the history that it tells."""

import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from rich.text import Text

from canlog.arrays import Series
from clutch_model.calibration import TorqueSource, nominal_calibration
from clutch_results.clocks import NO_TODAY
from clutch_results.curves import WATCH_MARGIN_RATIO, margin_left
from clutch_results.event_kinds import EndReason
from clutch_results.pictures import fan_of
from clutch_results.prognosis import ChannelName, PeerGroup, Peers, Population, Usual
from clutch_results.prognosis.sentence import soonest
from clutch_results.records import (
    Causes,
    FluidFill,
    FrictionSlope,
    FrictionTrend,
    LikelyCause,
    Reason,
    ShiftResult,
    Status,
    clutch_record,
    dump,
    shift_record,
    utc_from_bus_ns,
)
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.summary import latest_of
from diag_service.report.findings import Album, Findings, findings_of_store
from diag_service.report.history import history_lines, history_records, periods_of, prognoses_of
from diag_service.report.page import fan_for, html_of, notebook_of, record_of
from diag_service.store import Row, Versions
from fleet_contract.orders import Action
from tests.support.builders import at
from tests.support.histories import VERSIONS, fill_store, findings, history, of_version

NOW = "2026-03-01T12:00:00.000000Z"
MOST_BYTES_SHORT, MOST_BYTES_LONG = 200_000, 500_000


def html(found: Findings, *, is_full: bool = False) -> str:
    return html_of(found, NOW, is_full=is_full)


_EMPTY = {"meta", "br", "path", "circle"}


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
        if tag not in _EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _EMPTY:
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
    assert text.index(found.order.sentence) < text.index("km left") < text.index(found.order.reasons[0])
    assert text.index(found.order.reasons[-1]) < text.index('<figure class="fan">')
    assert text.count('<section class="order watch"') == text.count('<section class="order') == 1


def test_the_numbers_are_those_of_the_results_to_the_last_digit() -> None:
    found = findings(30)
    text = html(found, is_full=True)
    reader = read(text)
    for result in found.latest:
        friction = result.verdict.friction
        assert friction is not None
        assert f'mu_C, at high slip</th><td><data value="{friction.mu_c!r}">{friction.mu_c:.4f}</data> ± ' in text
        assert {friction.mu_c, 2.0 * friction.std_mu_c, friction.mu_s, result.verdict.level_ratio} <= set(reader.values)
    record = json.loads(reader.record)
    assert (
        record["clutches"]
        == json.loads(dump({"all": [clutch_record(shift_record(one), found.order) for one in found.latest]}))["all"]
    )
    assert record == json.loads(dump(record_of(found)))


def test_a_page_needs_nothing_from_anywhere() -> None:
    text = html(findings(30), is_full=True)
    assert read(text).links == []
    assert "http://" not in text.replace("http-equiv", "")
    assert "https://" not in text
    assert "@import" not in text
    assert "url(" not in text


@pytest.mark.parametrize(("count", "most_bytes"), [(30, MOST_BYTES_SHORT), (10_000, MOST_BYTES_LONG)])
def test_a_page_stays_small_and_says_what_it_leaves_out(count: int, most_bytes: int) -> None:
    text = html(findings(count), is_full=True)
    assert len(text.encode()) < most_bytes
    assert ("The newest 100 of 10000 events." in text) is (count > 100)


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
    assert evil not in notebook_of(evil, evil, evil, [evil], fan_for(found)) or evil.startswith("{{")
    assert json.loads(read(text).record)["vehicle"] == evil


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
    found = replace(findings(14), examples=album.examples)
    assert "During the shift" not in html(found)  # the sheet has no room for them
    text = html(found, is_full=True)
    assert "Event 7, shift" in text
    assert "rejected (frames missing)</h3>" in text
    assert text.count("During the shift [rpm]: engine speed") == 2
    assert "During the shift [Nm]" not in text  # no signal of that kind was there
    read(text)


FILL = FluidFill(vehicle="car1", filled_at="2025-06-01T00:00:00.000000Z", odometer_m=500_000.0, product="DCTF 75W")


def words_of(text: str) -> str:
    """Return what people read of a page."""
    text = re.sub(r"<(style|script|svg)\b.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", text)).split())


def test_a_sheet_has_all_that_a_workshop_needs_and_no_table() -> None:
    found = replace(findings(30), fills=(FILL,))
    text = html(found)
    read_m = found.results[-1].estimate.conditions.odometer_m or 0.0
    for told in (
        f"Odometer {read_m / 1000.0:,.0f} km",
        "Fluid DCTF 75W",
        "Filled 2025-06-01 at 500 km",
        "What was not seen",
    ):
        assert told in words_of(text)
    assert "<table" not in text
    assert text.count('role="img"') == 3  # the fan chart, and both clutches over slip
    assert ["watch: 50 %" in text, "change: 0 %" in text] == [True, True]


CAUSES = Causes(
    event_count=30,
    likely=tuple(
        LikelyCause(cause=cause, clutch=None, probability=share, evidence=f"For {cause}.")
        for cause, share in (("aged-fluid", 0.8), ("water", 0.1), ("wrong-fluid", 0.06), ("something-else", 0.04))
    ),
    advice="Change the fluid.",
    test="Launches would tell.",
)


def test_three_causes_at_most_are_told_with_how_sure_they_are() -> None:
    found = findings(30)
    latest = tuple(replace(one, verdict=replace(one.verdict, causes=CAUSES)) for one in found.latest)
    told = words_of(html(replace(found, latest=latest)))
    assert "aged fluid 80 % For aged-fluid. water 10 % For water. wrong fluid 6 % For wrong-fluid. Change" in told
    assert "something else" not in told


def test_the_fan_ends_where_the_margin_is_gone_as_the_sentence_says() -> None:
    """What is drawn of the future crosses the limit at the kilometres that the headline tells."""
    results = ageing(120)
    found = replace(findings(4), rows=tuple(Row(position=n, result=one) for n, one in enumerate(results, 1)))
    found = replace(found, latest=latest_of(results))
    prognoses, fan = prognoses_of(found), fan_for(found)
    assert fan is not None
    reach = soonest(prognoses)
    assert reach is not None
    assert fan.pasts[0].clutch in {one.clutch for one in prognoses if one.change_fluid is reach}
    now_km = (results[-1].estimate.conditions.odometer_m or 0.0) / 1000.0
    ends_km = [float(np.interp(0.0, -one, fan.ahead)) - now_km for one in fan.quantiles]
    assert reach.p10_m is not None
    assert reach.p90_m is not None
    assert ends_km[::2] == pytest.approx([reach.p10_m / 1000.0, reach.p90_m / 1000.0], rel=0.05, abs=200.0)
    assert fan.pasts[0].left[-1] == pytest.approx(fan.quantiles[1, 0], abs=10.0)


def ageing(count: int) -> list[ShiftResult]:
    """Return results of a fluid that has lost half of its margin in 50,000 km."""
    rng = np.random.default_rng(1)
    return [aged(one, place / count, rng) for place, one in enumerate(history(count))]


def aged(result: ShiftResult, age: float, rng: np.random.Generator) -> ShiftResult:
    new = CALIBRATION.clutches[result.estimate.clutch - 1].friction
    running, own = result.verdict.friction, result.estimate.friction
    assert running is not None
    mu_s = new.mu_c - (1.0 - 0.5 * age) * (new.mu_c - new.mu_s)
    own = own and replace(own, mu_c=new.mu_c + 0.001 * rng.standard_normal(), mu_s=mu_s + 0.001 * rng.standard_normal())
    estimate = at(replace(result.estimate, friction=own), odometer_m=5.0e7 * age + 1.0e7)
    verdict = replace(result.verdict, friction=replace(running, mu_c=new.mu_c, mu_s=mu_s), level_ratio=1.0, trend=None)
    return replace(result, estimate=estimate, verdict=verdict)


def test_the_margin_is_that_against_the_nearest_limit() -> None:
    """100 % is new fluid, 50 % the limit of watch and 0 % that of a change, by margin, level and own baseline alike."""
    new = CALIBRATION.clutches[0].friction
    verdict = history(2)[0].verdict
    assert verdict.friction is not None
    fresh = replace(verdict.friction, mu_c=new.mu_c, mu_s=new.mu_s)
    lost = FrictionTrend(
        change_mu_c=0.0, change_mu_s=0.0, std_change_mu_c=0.0, std_change_mu_s=0.0, change_mu_c_ratio=-0.2,
        change_mu_s_ratio=0.0, std_change_mu_c_ratio=0.01, std_change_mu_s_ratio=0.0, baseline_end_bus_ns=0,
        baseline_shift_count=8, later_shift_count=3,
    )  # fmt: skip
    cases = {
        "new": (replace(verdict, friction=fresh, trend=None), 1.0),
        "half the margin": (
            replace(verdict, friction=replace(fresh, mu_s=0.5 * (new.mu_c + new.mu_s)), trend=None),
            WATCH_MARGIN_RATIO,
        ),
        "level of watch": (
            replace(verdict, friction=replace(fresh, mu_c=0.9 * new.mu_c, mu_s=0.9 * new.mu_c - 0.03), trend=None),
            0.5,
        ),
        "own friction lost": (replace(verdict, friction=fresh, trend=lost), 0.0),
        "up to a scale": (
            replace(
                verdict,
                friction=None,
                slope=FrictionSlope(
                    torque=TorqueSource.MODELLED, mu_s_ratio=1.0, std_mu_s_ratio=0.01, probability_negative=0.5
                ),
            ),
            0.0,
        ),
    }
    assert {name: margin_left(one, new)[0] for name, (one, _) in cases.items()} == pytest.approx(
        {name: left for name, (_, left) in cases.items()}, abs=1e-9
    )
    assert np.isnan(margin_left(replace(verdict, friction=None), new)).all()


CALIBRATION = nominal_calibration()


def fill_at(seq: int) -> FluidFill:
    start_ns = history(40)[seq - 1].estimate.start_ns
    return FluidFill(vehicle="car1", filled_at=utc_from_bus_ns(start_ns), product="DCTF-II")


def test_results_belong_to_the_fluid_of_their_moment() -> None:
    found = replace(findings(40), fills=(fill_at(21),))
    old, new = periods_of(found, 1)
    assert [row.position for row in old.rows] == list(range(1, 21, 2))
    assert [row.position for row in new.rows] == list(range(21, 41, 2))
    assert (old.name, new.name.startswith("DCTF-II since 2026-01-01")) == ("fluid of unknown age", True)


def test_every_event_is_a_record_and_the_last_one_has_the_fills() -> None:
    found = replace(findings(40), fills=(fill_at(21),))
    *events, fills = history_records(found, (1, 2))
    assert len(events) == 40
    assert {record["clutch"] for record in events} == {1, 2}
    first = events[0]
    verdict = found.rows[0].result.verdict
    assert verdict.friction is not None
    assert (first["shift"], first["running_mu_c"], first["advice"]) == (1, verdict.friction.mu_c, verdict.advice)
    assert [record["fluid_since"] for record in events[:20]] == [None] * 10 + [fill_at(21).filled_at] * 10
    assert fills["fills"] == [
        {"filled_at": fill_at(21).filled_at, "odometer_m": None, "product": "DCTF-II", "note": None}
    ]


def test_prognoses_begin_with_what_a_fleet_taught() -> None:
    found = findings(40)
    usual = Usual(start=1.0, start_std=0.02, loss_per_m=5.0e-8, loss_log_std=0.1)
    assert found.calibration is not None
    kind = PeerGroup(vehicle_type=found.calibration.name, fluid=None)
    peers = Peers(kind=kind, life_count=77, channels={ChannelName.MARGIN: usual})
    told = [
        [line.plain for line in history_lines(found, (1,), most_rows=5, population=one) if isinstance(line, Text)]
        for one in (None, Population(life_count=77, peers=(peers,)), Population(life_count=0, peers=()))
    ]
    alone, among, strangers = (lines[4] for lines in told)
    assert among.endswith(" Before its own results: as 77 lives of its peers.")
    assert among.split(" Before")[0] != alone == strangers


def test_a_store_gives_the_results_of_its_newest_versions(tmp_path: Path) -> None:
    old = Versions(algorithm="impulse-0", calibration=VERSIONS.calibration)
    fill_store(tmp_path / "car1.sqlite", [of_version(one, old) for one in history(3)] + history(8), [fill_at(5)])
    found = findings_of_store(tmp_path / "car1.sqlite", None, CALIBRATION, NO_TODAY)
    assert (len(found.rows), found.left_out_count, found.versions) == (8, 3, VERSIONS)
    assert found.calibration == CALIBRATION
    assert found.fills == (fill_at(5),)
    other = replace(CALIBRATION, version="another")
    assert findings_of_store(tmp_path / "car1.sqlite", "car1", other, NO_TODAY).calibration is None


def test_names_of_marks_neither_overprint_nor_repeat_each_other() -> None:
    """Fills, alarms and worse verdicts come together, as does what is of today."""
    results = history(60)
    alarms = [("2026-01-01T00:00:06.000000Z", f"alarm: {rule}") for rule in ("verdict", "verdict", "due", "quality")]
    fan = fan_of(results, (), [clutch.friction for clutch in CALIBRATION.clutches], alarms=alarms)
    assert fan is not None
    marks = replace(fan, moments=(*fan.moments, *((59.0, "watch", "watch"),) * 6), ahead=np.array([60.0, 61.0])).marks
    assert len({(mark.place, mark.text) for mark in marks}) == len(marks)
    named = [mark for mark in marks if mark.row is not None]
    assert {mark.text for mark in named} >= {"watch", "today", "alarm: verdict", "alarm: due"}
    for first, second in combinations(named, 2):
        if first.row == second.row:
            assert first.ends[1] <= second.ends[0] or second.ends[1] <= first.ends[0], (first, second)
