"""The page of a live run over HTTP: what it answers, whom it answers, and what it says while the run goes on."""

import http.client
from contextlib import closing
from dataclasses import replace
from urllib.parse import urlsplit

import pytest

from clutchdiag_io.pages.content import SAFE_HEADERS
from diag_service.delivery import MemoryReporter
from diag_service.errors import ConfigError
from diag_service.report.live_page import MOST_READERS, opened_page
from diag_service.service.onlookers import MOST_SHIFTS, LastShifts, LiveRun
from diag_service.service.session import Session
from diag_service.service.snapshot import Board, SnapshotTaker
from diag_service.settings.config import DiagnosisConfig, ListenAddress
from diag_service.store import ResultStore
from tests.support.patience import HANG_S
from tests.unit.diag_service.service.test_live import CALIBRATION, gear_frames, session_for
from tests.unit.diag_service.service.test_onlookers import STATUS, StillSource

ANYWHERE = ListenAddress(host="127.0.0.1", port=0)
MARKUP = "<b>bus</b>"


def witnessed(store: ResultStore, shifts: LastShifts) -> Session:
    plain = session_for(store, MemoryReporter())
    config = DiagnosisConfig(vehicle="car1", calibration=CALIBRATION)
    return Session(config, plain.stages.decoder, store, None, MemoryReporter(), witness=shifts.add)


@pytest.fixture(name="run")
def _run() -> LiveRun:
    shifts, board = LastShifts(), Board(lambda: 102.0)
    with closing(ResultStore.in_memory()) as store:
        session = witnessed(store, shifts)
        taker = SnapshotTaker(StillSource(), session, 100.0, 500_000)
        for event in session.stages.segment(gear_frames(3)):
            session.process(event)
        board.latest = taker.take(102.0)
    return LiveRun(
        vehicle="car1", source=MARKUP, store="car1.sqlite", calibration=CALIBRATION, board=board, shifts=shifts
    )


def ask(url: str, path: str, method: str = "GET", **headers: str) -> tuple[int, http.client.HTTPMessage, str]:
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=HANG_S)
    with closing(connection):
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read().decode()


def test_the_page_shows_bus_clutches_and_shifts(run: LiveRun) -> None:
    with opened_page(ANYWHERE, run) as url:
        status, headers, text = ask(url, "/")
    assert status == 200
    assert {name: headers[name] for name, _ in SAFE_HEADERS} == dict(SAFE_HEADERS)
    assert headers["cache-control"] == "no-store"
    assert "Bus: degraded" in text
    assert "it went down" in text
    assert "3 arbitration lost" in text
    assert text.count("no event engaged it yet") == 0
    assert "Vehicle car1, live" in text
    assert MARKUP not in text
    assert "&lt;b&gt;bus" in text
    assert 'data-number="2"' in text


def test_only_this_machine_by_its_own_name_is_answered_and_nothing_is_changed(run: LiveRun) -> None:
    with opened_page(ANYWHERE, run) as url:
        for host in ("evil.example", "127.0.0.1.evil.example", ""):
            assert ask(url, "/", Host=host)[0] == 421
        assert ask(url, "/", Host="localhost:1")[0] == 200
        assert ask(url, "/", "POST")[0] == 405
        found = {
            path: ask(url, path)[0] for path in ("/static/style.css", "/static/live.js", "/static/parts.html", "/x")
        }
        assert found == {"/static/style.css": 200, "/static/live.js": 200, "/static/parts.html": 404, "/x": 404}
        taken = ListenAddress(host="127.0.0.1", port=urlsplit(url).port or 0)
        with pytest.raises(ConfigError, match="cannot serve page"), opened_page(taken, run):
            pass


def test_a_reader_hears_that_the_bus_changed_and_there_is_an_end_to_readers(run: LiveRun) -> None:
    with opened_page(ANYWHERE, run) as url:
        readers = [http.client.HTTPConnection(urlsplit(url).netloc, timeout=HANG_S) for _ in range(MOST_READERS)]
        for reader in readers:
            reader.request("GET", "/events?number=2")
        answers = [reader.getresponse() for reader in readers]
        assert [answer.readline() for answer in answers] == [b"retry: 3000\n"] * MOST_READERS
        assert ask(url, "/events")[0] == 503
        latest = run.board.latest
        assert latest is not None
        summary = replace(latest.summary, shifts=replace(latest.summary.shifts, latest={}))
        bus = replace(STATUS, interruption_count=9)
        run.board.latest = replace(latest, bus=bus, stuck=None, clutches=(), summary=summary)
        run.board.latest = replace(run.board.latest, taken_s=0.0)  # it does not live any more
        answers[0].readline()
        assert answers[0].readline() == b"event: news\n"
        assert "The service does not answer" in ask(url, "/")[2]
        assert "Clutch 1: no event engaged it yet." in ask(url, "/")[2]
        for answer, reader in zip(answers, readers, strict=True):
            answer.close()
            reader.close()


def test_before_the_first_look_it_says_so(run: LiveRun) -> None:
    run.board.latest = None
    with opened_page(ANYWHERE, run) as url:
        assert "The run begins." in ask(url, "/")[2]


def test_of_many_shifts_the_last_are_kept_with_samples_of_their_own(run: LiveRun) -> None:
    (first, second), shifts = run.shifts.examples, LastShifts()
    for _ in range(MOST_SHIFTS):
        shifts.add(first.event, first.result)
    shifts.add(second.event, second.result)
    assert [one.result.seq for one in shifts.examples] == [1] * (MOST_SHIFTS - 1) + [2]
    kept = shifts.examples[-1].event.columns
    assert all(kept[name].value is not column.value for name, column in second.event.columns.items())
