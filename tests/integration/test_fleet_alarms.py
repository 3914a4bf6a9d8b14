"""Alarms on their way to people: raised once, delivered by key though processes die, signed, and never lost."""

import asyncio
import base64
import hashlib
import hmac
import json
import socketserver
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from sqlalchemy import Engine, event, select

from diag_service.diagnosis.records import Condition
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Letter, Note
from fleet_backend.alarms.carriers import TOPIC_ROOT, Mail, Mqtt, Webhook
from fleet_backend.alarms.rules import Event, Rule, Subject, Transition
from fleet_backend.cli import main
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import CarrierError
from fleet_backend.office.watching import Orders, Watch, run_watch, watch_for_ever
from fleet_backend.office_tables import ALARM, ALARM_MESSAGE, AUDIT, FLUID_DUE
from fleet_backend.page import alarms_view
from fleet_backend.page.asking import read_words
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.running import DatabaseSource
from fleet_backend.writer import Batch, Writer
from fleet_link import Connection, Message, Terms, parse_broker
from tests.plugins.broker import Mosquitto
from tests.support.fleet import NOW, fleet_result, row_of
from tests.support.fleet_page import sources_of
from tests.support.patience import HANG_S

SECRET = b"0123456789abcdef0123456789abcdef"
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

    def deliver(self, letter: Letter, now: datetime) -> None:
        assert now is not None
        self.letters.append(letter)
        self.fails()


def store(engine: Engine, seq: int, condition: Condition, vehicle: str = "car1") -> None:
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(seq, vehicle=vehicle, condition=condition))]))


def test_an_alarm_is_raised_once_told_once_and_cleared(engine: Engine) -> None:
    memory, clock = Memory(), Clock()
    store(engine, 1, BAD)
    first, second = (Watch(engine, Orders(carriers=[memory]), clock) for _ in range(2))
    assert {step.subject.rule for step in first.round()} == {Rule.VERDICT, Rule.SILENCE}  # of two months ago
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


def test_a_carrier_that_hangs_keeps_no_other_waiting_and_one_that_is_gone_owes_nothing(engine: Engine) -> None:
    def hang() -> None:
        raise CarrierError("timed out")

    hanging, memory = Memory(hang), Memory()
    hanging.name = "hanging"
    store(engine, 1, BAD)
    watch = Watch(engine, Orders(carriers=[hanging, memory]), Clock())
    watch.round()
    turns = [(watch.deliver(turn_s=0.0), len(hanging.letters), len(memory.letters)) for _ in range(3)]
    assert turns == [(1, 1, 1), (1, 2, 2), (0, 2, 2)]
    for carriers, count in (([hanging], 2.0), ([memory], 0.0)):
        later = Watch(engine, Orders(carriers=carriers), Clock())
        later.round()
        (waiting,) = [one for one in later.families() if one.name.endswith("watch_undelivered_messages")]
        assert [sample.value for sample in waiting.samples] == [count]


def test_a_watch_that_is_told_to_end_begins_no_other_delivery(engine: Engine) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def hang() -> None:
        begun.set()
        may_end.wait(HANG_S)
        raise CarrierError("timed out")

    async def stopped() -> None:
        work = asyncio.ensure_future(watch_for_ever(engine, Orders(carriers=[memory])))
        await asyncio.to_thread(begun.wait, HANG_S)
        work.cancel()
        await asyncio.wait([work])
        may_end.set()

    memory = Memory(hang)
    for vehicle in ("car1", "car2"):
        store(engine, 1, BAD, vehicle)
    Watch(engine, Orders(carriers=[memory]), Clock()).round()
    asyncio.run(stopped())
    assert len(memory.letters) == 1


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


def test_a_process_that_dies_while_it_writes_leaves_no_half(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    store(engine, 1, BAD)
    watch = Watch(engine, Orders(carriers=[Memory()]), Clock())
    monkeypatch.setattr(book, "_payload", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        watch.round()
    monkeypatch.undo()
    assert book.open_alarms(engine) == {}
    assert len(watch.round()) == 2
    assert watch.deliver() == 2


def test_many_alarms_are_written_in_few_transactions_and_none_twice(engine: Engine) -> None:
    vehicles, commits = [f"v{number}" for number in range(600)], list[object]()
    shifts = [row_of(fleet_result(1, vehicle=vehicle, condition=BAD)) for vehicle in vehicles]
    Writer(engine).store(Batch(shifts=shifts))
    event.listen(engine, "commit", commits.append)
    subjects = [Subject(vehicle=vehicle, clutch=2, rule=Rule.VERDICT) for vehicle in vehicles]
    steps = [Transition(subject=one, event=Event.RAISED, reason="x", at=NOW) for one in subjects]
    assert book.write(engine, steps[:500], ["memory"]) == steps[:500]
    assert len(commits) == 1
    assert book.write(engine, [*steps, steps[-1]], ["memory"]) == steps[500:]  # as if another had raised it meanwhile
    over = [replace(step, event=Event.CLEARED) for step in steps]
    assert book.write(engine, [*over, *over[:3]], ["memory"]) == over
    with transaction(engine) as connection:
        assert len(connection.execute(select(ALARM_MESSAGE)).all()) == 1200


def test_the_worst_keeps_no_other_waiting(engine: Engine) -> None:
    for vehicle, condition in (("worst", BAD), ("b", Condition.WATCH), ("c", Condition.GOOD)):
        store(engine, 1, condition, vehicle)
    watch, waiting = Watch(engine, Orders(), Clock()), list[int]()
    for seq in range(2, 6):
        watch.round(judging_s=0.0)  # one vehicle is judged, however little time there is
        waiting.append(watch.waiting_count)
        store(engine, seq, BAD, "worst")
    assert waiting == [2, 2, 1, 0]


def test_a_watch_that_looks_once_judges_every_vehicle(engine: Engine) -> None:
    names = [f"v{number}" for number in range(7)]
    for name in names:
        store(engine, 1, BAD, name)
    memory = Memory()
    run_watch(engine, Orders(carriers=[memory]), is_once=True, judging_s=0.0)  # of each round: one vehicle, then rest
    with transaction(engine) as connection:
        assert sorted(connection.execute(select(FLUID_DUE.c.vehicle)).scalars()) == names
    assert sorted(str(letter.payload["vehicle"]) for letter in memory.letters) == names


async def test_a_watch_beside_the_pages_reads_no_fleet_of_its_own(engine: Engine) -> None:
    store(engine, 1, BAD)
    keeper = Keeper(DatabaseSource(engine))
    watch = Watch(engine, Orders(), Clock(), shared=keeper)
    assert not [step for step in watch.round() if step.subject.rule is Rule.VERDICT]
    await keeper.look()
    assert [step for step in watch.round() if step.subject.rule is Rule.VERDICT]


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
    subject = Subject(vehicle="car1", clutch=2, rule=Rule.VERDICT)
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


class Received(BaseHTTPRequestHandler):
    """A receiver of webhooks that answers as its server says."""

    def do_POST(self) -> None:
        server = self.server
        assert isinstance(server, Hooks)
        body = self.rfile.read(int(self.headers["content-length"]))
        server.received.append((dict(self.headers.items()), body))
        self.send_response(server.answer)
        self.send_header("location", "http://127.0.0.1:1/elsewhere")
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class Hooks(ThreadingHTTPServer):
    """A server for webhooks."""

    received: list[tuple[dict[str, str], bytes]]
    answer = 204


@contextmanager
def running(server: socketserver.BaseServer) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


LETTER = Letter(
    key="car1/2/verdict/1/raised",
    carrier="webhook",
    payload={
        "alarm": "car1/2/verdict/1", "event": "raised", "vehicle": "car1", "clutch": 2, "rule": "verdict",
        "at": "2026-03-01T12:00:00Z", "reason": "change the fluid: ä",
    },
    attempt_count=0,
)  # fmt: skip


def test_a_webhook_is_signed_and_goes_nowhere_else() -> None:
    hooks = Hooks(("127.0.0.1", 0), Received)
    hooks.received = []
    webhook = Webhook(url=f"http://127.0.0.1:{hooks.server_port}/fleet", secret=SECRET)
    with running(hooks):
        webhook.deliver(LETTER, NOW)
        for answer in (302, 404, 500):
            hooks.answer = answer
            with pytest.raises(CarrierError, match=str(answer)):
                webhook.deliver(LETTER, NOW)
    headers, body = hooks.received[0]
    told = {name.casefold(): value for name, value in headers.items()}
    signed = f"{told['webhook-id']}.{told['webhook-timestamp']}.".encode() + body
    wanted = base64.b64encode(hmac.new(SECRET, signed, hashlib.sha256).digest()).decode()
    assert told["webhook-signature"] == f"v1,{wanted}"
    assert (told["webhook-id"], told["webhook-timestamp"]) == (LETTER.key, str(int(NOW.timestamp())))
    assert json.loads(body) == {"type": "clutchdiag.alarm.raised", "data": LETTER.payload}
    assert SECRET.decode() not in repr(webhook)
    with pytest.raises(CarrierError):
        webhook.deliver(LETTER, NOW)  # nobody listens any more


class Post(socketserver.StreamRequestHandler):
    """As much of SMTP as takes one message."""

    def handle(self) -> None:
        server = self.server
        assert isinstance(server, PostOffice)
        self.wfile.write(b"220 here\r\n")
        while (line := self.rfile.readline()).strip():
            word = line.split()[0].upper()
            if word == b"DATA":
                self.wfile.write(b"354 go on\r\n")
                lines = iter(self.rfile.readline, b".\r\n")
                server.messages.append(b"".join(lines).decode())
            is_refused = word == b"RCPT" and b"nobody" in line
            if word == b"EHLO":
                self.wfile.write(b"250-here\r\n250 AUTH PLAIN\r\n")
                continue
            self.wfile.write(b"550 no\r\n" if is_refused else b"221 bye\r\n" if word == b"QUIT" else b"250 ok\r\n")


class PostOffice(socketserver.ThreadingTCPServer):
    """A server for outgoing mail."""

    daemon_threads = True
    messages: list[str]


def test_mail_is_the_same_at_every_attempt() -> None:
    office = PostOffice(("127.0.0.1", 0), Post)
    office.messages = []
    server = urlsplit(f"smtp://127.0.0.1:{office.server_address[1]}")
    mail = Mail(server=server, sender="fleet@example.org", recipients=("ann@example.org",))
    with running(office):
        mail.deliver(LETTER, NOW)
        mail.deliver(LETTER, NOW)
        with pytest.raises(CarrierError, match="nobody@"):
            replace(mail, recipients=("ann@example.org", "nobody@example.org")).deliver(LETTER, NOW)
    first, second, _ = office.messages
    assert first == second
    assert "Subject: Alarm: car1, clutch 2: verdict" in first
    assert "Message-ID: <" in first


def test_who_speaks_another_protocol_or_knows_no_umlaut_is_tried_again_later() -> None:
    office = PostOffice(("127.0.0.1", 0), Post)
    place = f"127.0.0.1:{office.server_address[1]}"
    with running(office):
        with pytest.raises(CarrierError, match="220 here"):
            Webhook(url=f"http://{place}", secret=SECRET).deliver(LETTER, NOW)
        mail = Mail(server=urlsplit(f"smtp://fleet:%C3%BC@{place}"), sender="a@example.org", recipients=("b@c.org",))
        with pytest.raises(CarrierError, match="must be ASCII"):
            mail.deliver(LETTER, NOW)


async def heard(connection: Connection, count: int) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return so many messages by their ids, with their topics."""
    messages = list[Message]()
    async with asyncio.timeout(HANG_S):
        while len(messages) < count:
            messages += await connection.collect(count, 0.0)
    events = [(one.topic, json.loads(one.payload)) for one in messages]
    return {str(event["id"]): (topic, event) for topic, event in events}


async def test_alarms_by_mqtt_outlast_their_broker_and_are_no_state(sqlite_url: str, broker: Mosquitto) -> None:
    engine, clock, address = open_database(sqlite_url), Clock(), parse_broker(broker.url)
    watch = Watch(engine, Orders(carriers=[Mqtt(broker=address)]), clock)
    terms, everyone = Terms(identifier="receiver", session_s=3600), [f"{TOPIC_ROOT}/+"]
    receiver = await Connection.open(address, terms)
    await receiver.subscribe(everyone)
    store(engine, 1, BAD)
    watch.round()
    assert await asyncio.to_thread(watch.deliver) == 2
    raised = await heard(receiver, 2)
    topic, event = raised["car1/2/verdict/1/raised"]
    assert topic == "clutchdiag/alarms/v1/car1"
    assert (event["type"], event["data"]["rule"], event["time"]) == (
        "clutchdiag.alarm.raised",
        "verdict",
        "2026-03-01T12:00:00Z",
    )
    await receiver.close()
    broker.kill()
    store(engine, 2, Condition.GOOD)
    watch.round()
    assert await asyncio.to_thread(watch.deliver) == 0
    broker.start()
    clock.at += timedelta(seconds=2)
    assert await asyncio.to_thread(watch.deliver) == 1
    receiver = await Connection.open(address, terms)  # the broker kept what came meanwhile
    later: set[str] = set()
    while not later:  # a broker that was killed may not know what was acknowledged, and says that once more
        later = set(await heard(receiver, 1)) - set(raised)
    assert later == {"car1/2/verdict/1/cleared"}
    late = await Connection.open(address, Terms())
    await late.subscribe(everyone)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.1):
            await late.collect(1, 0.0)
    for one in (receiver, late):
        await one.close()
    engine.dispose()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--webhook", "ftp://x"], "--webhook must be https://host/path"),
        (["--webhook", "http://example.org/x"], "--webhook: http is for this machine only"),
        (["--webhook", "https://example.org/x"], "a webhook needs --secret FILE"),
        (["--webhook", "https://example.org/x", "--secret", "short"], "a secret must have 24 bytes or more"),
        (["--mail", "smtp://x"], "e-mail needs --from and --to"),
        (["--mail", "smtp://x", "--from", "a\nb@c", "--to", "d@e"], "is not an e-mail address"),
        (["--mqtt"], "no broker: give --broker"),
        (["--mqtt", "--broker", "http://x"], "the broker must be"),
        (["--silence-days", "1"], "--silence-days must be 2 to 3650"),
        (["--service-km", "nan"], "--service-km must be 1 to 300000"),
    ],
)
def test_a_watch_that_cannot_be_is_one_clear_line(
    capsys: pytest.CaptureFixture[str],
    sqlite_url: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short").write_text("secret", encoding="utf-8")
    Path("short").chmod(0o600)
    assert main(["watch", "--database", sqlite_url, "--once", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line


def test_one_round_by_the_command(engine: Engine, tmp_path: Path) -> None:
    hooks = Hooks(("127.0.0.1", 0), Received)
    hooks.received = []
    secret = tmp_path / "secret"
    secret.write_text("whsec_" + base64.b64encode(SECRET).decode(), encoding="utf-8")
    secret.chmod(0o600)
    store(engine, 1, BAD)
    address = engine.url.render_as_string(hide_password=False)
    with running(hooks):
        url = f"http://127.0.0.1:{hooks.server_port}/fleet"
        command = ["watch", "--database", address, "--once", "--webhook", url, "--secret", str(secret)]
        assert [main(command), main(command)] == [0, 0]
    assert {json.loads(body)["data"]["rule"] for _, body in hooks.received} == {"verdict"}
    assert len(hooks.received) == 1  # a result of months ago that was stored now is no silence


def test_the_alarms_come_in_parts(engine: Engine) -> None:
    for vehicle in ("a", "b", "c"):
        store(engine, 1, BAD, vehicle)
    clock = Clock()
    watch = Watch(engine, Orders(), clock)
    watch.round()
    store(engine, 2, Condition.GOOD, "b")
    clock.at += timedelta(minutes=1)
    watch.round()
    sources = sources_of(engine)

    def parts(**query: str) -> list[tuple[str, str]]:
        found, after = list[tuple[str, str]](), dict[str, str]()
        for _ in range(9):
            question = read_words(alarms_view.VIEW.parameters, {}, {**query, **after, "limit": "2"}.items(), NOW)
            part = alarms_view.find(sources, question)
            found += [(one.vehicle, one.rule) for one in part.alarms]
            if part.next is None:
                break
            after = {"after": part.next}
        return found

    silent = [(name, "silence") for name in ("a", "b", "c")]
    assert parts(state="all") == sorted([*silent, ("a", "verdict"), ("b", "verdict"), ("c", "verdict")])
    assert parts() == sorted([*silent, ("a", "verdict"), ("c", "verdict")])
    assert parts(rule="silence", state="waiting") == silent
