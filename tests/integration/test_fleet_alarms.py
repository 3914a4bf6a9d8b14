"""Alarms on their way to people: raised once, delivered by key though processes die, and never lost."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import Connection, Engine, event, select

from clutch_results.records import Condition
from fleet_backend import queries
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Letter, Note
from fleet_backend.alarms.rules import AlarmRule, Subject
from fleet_backend.cli import main
from fleet_backend.database import transaction
from fleet_backend.errors import CarrierError, DatabaseAwayError
from fleet_backend.office.watching import Orders, Watch, read_carrier
from fleet_backend.office_tables import ALARM, ALARM_MESSAGE, AUDIT, FLUID_DUE
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import NOW, fleet_result, row_of
from tests.support.histories import history
from tests.support.patience import HANG_S

BAD = Condition.CHANGE_FLUID


class Clock:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.at = NOW

    def __call__(self) -> datetime:
        return self.at


class Memory:
    """A carrier that keeps what it gets; ``fails`` says what happens to a message."""

    name = "memory"

    def __init__(self, fails: Callable[[], None] = lambda: None) -> None:
        self.letters: list[Letter] = []
        self.fails = fails

    def deliver(self, letter: Letter) -> None:
        self.letters.append(letter)
        self.fails()


def store(engine: Engine, seq: int, condition: Condition, vehicle: str = "car1") -> None:
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(seq, vehicle=vehicle, condition=condition))]))


def test_an_alarm_is_raised_once_told_once_and_cleared(engine: Engine) -> None:
    memory, clock = Memory(), Clock()
    store(engine, 1, BAD)
    first, second = (Watch(engine, Orders(carriers=[memory]), clock) for _ in range(2))
    assert {step.subject.rule for step in first.round()} == {AlarmRule.VERDICT, AlarmRule.SILENCE}  # of two months ago
    assert second.round() == first.round() == []
    assert (second.deliver(), first.deliver()) == (2, 0)
    store(engine, 2, Condition.GOOD)
    assert [step.event for step in first.round()] == ["cleared"]
    store(engine, 3, BAD)
    first.round()
    first.deliver()
    assert [letter.key for letter in memory.letters[2:]] == ["car1/2/verdict/1/cleared", "car1/2/verdict/2/raised"]
    told = memory.letters[-1].payload
    assert (told["vehicle"], told["clutch"], told["event"], told["at"]) == ("car1", 2, "raised", "2026-03-01T12:00:00Z")


def test_what_cannot_be_delivered_waits_longer_and_longer(engine: Engine) -> None:
    def refuse() -> None:
        raise CarrierError("no")

    memory, clock = Memory(refuse), Clock()
    store(engine, 1, BAD)
    watch = Watch(engine, Orders(carriers=[memory]), clock)
    watch.round()
    pauses_s = []
    for _ in range(14):
        assert watch.deliver() == 0
        assert watch.deliver() == 0  # not before its time
        with transaction(engine) as connection:
            (next_at,) = set(connection.execute(select(ALARM_MESSAGE.c.next_try_at)).scalars())
        pauses_s.append((next_at - clock.at).total_seconds())
        clock.at = next_at
    assert pauses_s == [min(2.0 * 2.0**number, 3600.0) for number in range(14)]
    assert len(memory.letters) == 2 * 14
    memory.fails = lambda: None
    assert watch.deliver() == 2
    with transaction(engine) as connection:
        waiting = connection.execute(select(ALARM_MESSAGE).where(ALARM_MESSAGE.c.delivered_at.is_(None))).all()
    assert waiting == []


def test_a_process_that_dies_after_a_delivery_delivers_again_under_the_same_key(engine: Engine) -> None:
    def die() -> None:
        raise KeyboardInterrupt

    dying, clock = Memory(die), Clock()
    store(engine, 1, BAD)
    watch = Watch(engine, Orders(carriers=[dying]), clock)
    watch.round()
    with pytest.raises(KeyboardInterrupt):
        watch.deliver()
    other = Memory()
    again = Watch(engine, Orders(carriers=[other]), clock)
    assert again.deliver() == 1  # the other alarm; the first is still claimed by who died
    clock.at += book.CLAIM + timedelta(seconds=1)
    assert again.deliver() == 1
    assert {letter.key for letter in other.letters} >= {letter.key for letter in dying.letters}
    assert len({letter.key for letter in other.letters}) == 2


def test_one_program_watches_and_shows_what_it_found(engine: Engine) -> None:
    store(engine, 1, BAD)
    address = engine.url.render_as_string(hide_password=False)
    command = [sys.executable, "-m", "fleet_backend", "watch", "--database", address, "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        page = process.stdout.readline().split()[0]
        deadline_s, rules = time.monotonic() + HANG_S, set[str]()
        while "verdict" not in rules:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
            with httpx.Client(base_url=page, trust_env=False, timeout=HANG_S) as client:
                rules = {one["rule"] for one in client.get("/api/v1/alarms?state=all").json()["alarms"]}
        process.terminate()
    assert process.returncode == 0
    assert main(["watch", "--database", address, "--listen", "127.0.0.1:0", "--once"]) == 2


def test_an_alarm_is_acknowledged_once_and_that_is_audited(engine: Engine) -> None:
    store(engine, 1, BAD)
    Watch(engine, Orders(), Clock()).round()
    subject = Subject(vehicle="car1", clutch=2, rule=AlarmRule.VERDICT)
    note = Note(by="ann", role="workshop", at=NOW, text="fluid is on order")
    assert book.acknowledge(engine, subject, 1, note)
    assert not book.acknowledge(engine, subject, 1, replace(note, by="bob"))
    assert not book.acknowledge(engine, subject, 2, note)
    with transaction(engine) as connection:
        (alarm,) = connection.execute(select(ALARM).where(ALARM.c.rule == "verdict")).all()
        (entry,) = connection.execute(select(AUDIT)).all()
    assert (alarm.acknowledged_by, alarm.note) == ("ann", "fluid is on order")
    assert (entry.who, entry.role, entry.action) == ("ann", "workshop", "acknowledge alarm")
    assert entry.subject == "car1/2/verdict/1: fluid is on order"


class Asked:
    """Counts the vehicles whose past is read over a connection; an alarm cannot be written ``while_away``."""

    def __init__(self, engine: Engine) -> None:
        self.vehicles: list[str] = []
        self.is_away = False
        event.listen(engine, "before_cursor_execute", self._hear)

    def _hear(self, _connection: Connection, _cursor: object, statement: str, values: Any, *_: object) -> None:  # noqa: ANN401
        if "sump_temperature_k" in statement and "LIMIT" in statement:
            self.vehicles += [
                one for one in (values.values() if isinstance(values, dict) else values) if str(one)[:3] == "car"
            ][:1]
        if self.is_away and statement.startswith("INSERT INTO alarm "):
            raise DatabaseAwayError("away")

    def read(self) -> set[str]:
        """Return which vehicles were read since it was asked last."""
        told, self.vehicles = set(self.vehicles), []
        return told


def test_what_one_process_has_judged_no_other_judges_again_without_news(engine: Engine) -> None:
    for number in range(3):
        store(engine, 1, BAD, f"car{number}")
    asked, clock = Asked(engine), Clock()
    everyone = {"car0", "car1", "car2"}

    def news(**orders: Any) -> set[str]:  # noqa: ANN401 - fields of the orders
        Watch(engine, Orders(**orders), clock).round(judging_s=float("inf"))
        return asked.read()

    assert news() == everyone
    assert news() == set()
    store(engine, 2, BAD, "car1")
    assert news() == {"car1"}
    late = row_of(fleet_result(1, vehicle="car2", stream="a log of the year before"))
    times = {name: datetime(2025, 1, 1, tzinfo=UTC) for name in ("produced_at", "start_at", "end_at")}
    Writer(engine).store(
        Batch(shifts=[late | times | {"start_bus_ns": 1735689600 * 10**9, "end_bus_ns": 1735689601 * 10**9}])
    )
    assert news() == {"car2"}  # whose last result is the same
    queries.note_fill(engine, "car0", "DCTF", at=NOW, odometer_m=None, note=None)
    assert news() == {"car0"}
    assert news(service_distance_m=3.0e7) == everyone
    assert news(service_distance_m=3.0e7) == set()
    assert news() == everyone  # of other orders nothing is kept


@pytest.mark.parametrize("seed", range(2))
def test_who_judges_all_anew_finds_the_alarms_of_those_who_remember(engine: Engine, seed: int) -> None:
    rng, clock = np.random.default_rng(seed), Clock()
    names = ("car0", "car1", "car2", "car3")
    rows: dict[str, list[dict[str, Any]]] = {
        name: [row_of(one) | {"vehicle": name} for one in history(40)] for name in names
    }
    for own in rows.values():
        worn, leap_m, unused = rng.uniform(0.0, 0.3), 2e8 * rng.integers(2), rng.uniform()
        for place, row in enumerate(own):
            row["odometer_m"] = 4.0e5 * place + leap_m * (place > 30)
            row["status"] = "rejected" if rng.uniform() < unused else row["status"]
            if row["mu_c"] is not None:
                row["mu_c"] -= 0.01 * worn * place * row["mu_c"] / 4.0
    for step in range(4):
        for own in rows.values():
            if step == 0 or rng.uniform() < 0.5:
                Writer(engine).store(Batch(shifts=own[10 * step : 10 * step + 10]))
        Watch(engine, Orders(), clock).round(judging_s=float("inf"))
    raised = book.open_alarms(engine)
    assert len({subject.rule for subject in raised}) >= 3
    with transaction(engine) as connection:
        connection.execute(FLUID_DUE.update().values(mark=None))
    assert Watch(engine, Orders(), clock).round(judging_s=float("inf")) == []
    assert book.open_alarms(engine) == raised


def test_a_vehicle_whose_alarm_could_not_be_written_is_judged_again(engine: Engine) -> None:
    Writer(engine).store(Batch(shifts=[row_of(one) | {"odometer_m": 1e9 * (one.seq % 4 > 1)} for one in history(30)]))
    asked, clock = Asked(engine), Clock()
    watch = Watch(engine, Orders(), clock)
    asked.is_away = True
    with pytest.raises(DatabaseAwayError):
        watch.round()
    asked.is_away = False
    assert AlarmRule.ODOMETER in {step.subject.rule for step in watch.round()}


class Received(BaseHTTPRequestHandler):
    """A receiver of alarms that answers as its server says; whoever follows it elsewhere gets a good answer there."""

    server: "Hooks"

    def do_POST(self) -> None:
        self.server.received.append(json.loads(self.rfile.read(int(self.headers["content-length"]))))
        self.send_response(self.server.answer)
        self.send_header("location", "/elsewhere")
        self.end_headers()

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class Hooks(ThreadingHTTPServer):
    """A server that alarms are sent to, and the file with its address."""

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), Received)
        self.received: list[dict[str, object]] = []
        self.answer = 204
        self.address_file = folder / "workshop.url"
        self.address_file.touch(mode=0o600)
        self.address_file.write_text(f"json://fleet:hunter2@127.0.0.1:{self.server_port}/alarms\n", encoding="utf-8")


@pytest.fixture(name="hooks")
def _hooks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hooks]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with Hooks(tmp_path) as hooks:
        thread = threading.Thread(target=hooks.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield hooks
        hooks.shutdown()
        thread.join()


def test_what_a_server_does_not_take_comes_again_until_it_does(
    engine: Engine, hooks: Hooks, caplog: pytest.LogCaptureFixture
) -> None:
    clock = Clock()
    store(engine, 1, BAD)
    watch = Watch(engine, Orders(carriers=[read_carrier(hooks.address_file)]), clock)
    watch.round()
    for answer in (500, 404, 302):  # nor where it points elsewhere
        hooks.answer = answer
        assert watch.deliver() == 0
        assert "workshop: not delivered; trying again (car1/2/verdict/1/raised)" in caplog.text
        clock.at += timedelta(minutes=1)
    hooks.answer = 204
    assert watch.deliver() == 2
    assert watch.deliver() == 0
    store(engine, 2, Condition.GOOD)
    watch.round()
    assert watch.deliver() == 1
    raised, over = (one for one in hooks.received[6:] if "verdict" in str(one["title"]))
    assert (raised["title"], raised["type"]) == ("Alarm: car1, clutch 2: verdict", "warning")
    assert (over["title"], over["type"]) == ("Alarm over: car1, clutch 2: verdict", "success")
    assert str(raised["message"]).endswith("\n\n2026-03-01T12:00:00Z\ncar1/2/verdict/1/raised")
    assert "hunter2" not in caplog.text
