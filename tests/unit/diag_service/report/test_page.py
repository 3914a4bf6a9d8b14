"""The page: the same numbers as JSON, no more than a screen can show, and no markup from outside."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from canlog.arrays import Series
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import EndReason, Event
from diag_service.diagnosis.records import (
    FluidFill,
    Reason,
    Status,
    clutch_record,
    dump,
    shift_record,
)
from diag_service.report.findings import Album, Findings
from diag_service.report.page import html_of, page_of, record_of
from fleet_contract.orders import Action
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
