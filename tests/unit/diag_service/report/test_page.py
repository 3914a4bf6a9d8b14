"""The page of a vehicle and the history that it tells."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.text import Text

from canlog.arrays import Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from clutch_results.prognosis import ChannelName, PeerGroup, Peers, Population, Usual
from clutch_results.records import FluidFill, Reason, Status, clutch_record, dump, shift_record, utc_from_bus_ns
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.report.findings import Album, Findings, findings_of_store
from diag_service.report.history import history_lines, history_records, periods_of
from diag_service.report.page import html_of, page_of, record_of
from diag_service.store import Versions
from fleet_contract.orders import Action
from tests.support.histories import VERSIONS, fill_store, findings, history, of_version

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


FILL = FluidFill(vehicle="car1", filled_at="2025-06-01T00:00:00.000000Z", odometer_m=500_000.0, product="DCTF 75W")


def first_section(html: str) -> str:
    return html[html.index("<section") : html.index("</section>")]


def test_a_workshop_reads_all_it_needs_before_any_detail() -> None:
    found = replace(findings(30), fills=(FILL,))
    html = html_of(page_of(found, NOW))
    text = " ".join(re.sub(r"<[^>]+>", " ", first_section(html)).split())
    odometer = f"odometer [km] {(found.results[-1].estimate.odometer_m or 0.0) / 1000.0:.0f} "
    for told in ("km left", odometer, "fluid DCTF 75W", "filled on 2025-06-01", "filled at [km] 500"):
        assert told in text
    assert html.index(found.order.text) < html.index("<section")
    assert first_section(html).count("<svg") == 1
    assert "watch: 90 %" in text


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
    found = findings_of_store(tmp_path / "car1.sqlite", None, CALIBRATION)
    assert (len(found.rows), found.left_out_count, found.versions) == (8, 3, VERSIONS)
    assert found.calibration == CALIBRATION
    assert found.fills == (fill_at(5),)
    other = replace(CALIBRATION, version="another")
    assert findings_of_store(tmp_path / "car1.sqlite", "car1", other).calibration is None
