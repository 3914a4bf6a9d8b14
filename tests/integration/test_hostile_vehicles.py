"""A legitimate vehicle that means ill, under the brokers' configurations of docs/deploy: it hurts no other."""

import asyncio
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, closing, contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_backend.certificates.access import mosquitto_access, nats_users, write_access
from fleet_backend.certificates.authority import Authority, Lifetime
from fleet_backend.database import open_database
from fleet_link import BrokerAddress, TlsFiles
from tests.support.fleet_broker import DEPLOY, fleet_broker
from tests.support.fleet_worker import worker
from tests.support.nats import NatsServer
from tests.support.outboxes import NOW, put, sending, until
from tests.support.patience import HANG_S

pytestmark = pytest.mark.broker

QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)
GOOD = [f"car{number}" for number in range(1, 6)]
BAD = "carX"
SHIFTS = 40
GROUP = "unguessed-7f3a"
OTHERS = (
    f"$share/{GROUP}/clutchdiag/v1/+/shift",  # even where the name leaks
    "$share/ingest/clutchdiag/v1/+/shift",
    "$share/ingest/clutchdiag/v1/car1/bundle",
    "clutchdiag/v1/+/shift",
    "clutchdiag/v1/car1/ack",
    "clutchdiag/v1/#",
    "+/+/+/+",
    "#",
    "$SYS/#",
    "$CONTROL/#",
)


@pytest.fixture(name="authority")
def _authority(tmp_path: Path) -> Authority:
    day = Lifetime.of_days(1, datetime.now(UTC))
    authority = Authority.make(tmp_path / "certificates", day)
    authority.issue_server("broker", ["127.0.0.1"], day)
    for name in (*GOOD, BAD, "fleet-backend"):
        authority.issue_client(name, day)
    return authority


class Hostile:
    """What a vehicle with its own certificate tries, from connections of its own."""

    def __init__(self, authority: Authority, port: int, *, is_version_5: bool, flood_count: int = 20) -> None:
        self.codes: list[int] = []  # what the broker said to its subscriptions
        self.heard: list[str] = []  # topics on which it was told something
        self._folder = authority.folder
        self._port = port
        self._flood_count = flood_count  # messages of each connection to each topic
        self._version = MQTTProtocolVersion.MQTTv5 if is_version_5 else MQTTProtocolVersion.MQTTv311
        self._is_over = threading.Event()

    def client(self, identifier: str, *, is_huge: bool = False) -> mqtt.Client:
        """Return a connection under a name, with a will that speaks for another."""
        is_clean = not is_huge if self._version is MQTTProtocolVersion.MQTTv311 else None
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2, identifier, is_clean, protocol=self._version, reconnect_on_failure=False
        )
        folder = self._folder
        client.tls_set(
            f"{folder}/ca.crt", f"{folder}/{BAD}.crt", f"{folder}/{BAD}.key", tls_version=ssl.PROTOCOL_TLS_CLIENT
        )
        client.on_subscribe = lambda _c, _u, _m, codes, _p: self.codes.extend(code.value for code in codes)
        client.on_message = lambda _c, _u, message: self.heard.append(message.topic)
        client.will_set("clutchdiag/v1/car1/status", b"{}", qos=1, retain=True)
        client.connect("127.0.0.1", self._port)
        client.loop_start()
        return client

    def subscribe(self, topic: str) -> bool:
        """Try one subscription, and return whether it was granted."""
        client = self.client(f"{BAD}-{len(self.codes)}")
        before = len(self.codes)
        client.subscribe(topic, 1)
        deadline_s = time.monotonic() + 1.0
        while len(self.codes) == before and time.monotonic() < deadline_s:
            time.sleep(0.01)
        client.disconnect()
        client.loop_stop()
        return len(self.codes) > before and self.codes[-1] < 0x80

    def storm(self) -> None:
        """Take over, flood and retain until it is over."""
        number = 0
        while not self._is_over.is_set():
            victim = GOOD[number % len(GOOD)]
            for identifier in (f"clutchdiag-{victim}", victim, "fleet-backend", f"huge-{number}"):
                try:
                    client = self.client(identifier, is_huge=True)
                except OSError:
                    continue
                for topic in (
                    f"clutchdiag/v1/{BAD}/shift",
                    f"clutchdiag/v1/{BAD}/status",
                    f"clutchdiag/v1/{victim}/ack",
                ):
                    for _ in range(self._flood_count):
                        client.publish(topic, b"x" * 10_000, 1, retain=topic.endswith("status"))
                self._is_over.wait(0.05)
                client.disconnect()
                client.loop_stop()
            number += 1

    @contextmanager
    def storming(self) -> Iterator[None]:
        """Storm from three threads for as long as the block lasts."""
        threads = [threading.Thread(target=self.storm) for _ in range(3)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self._is_over.set()
            for thread in threads:
                thread.join(HANG_S)


async def deliver(authority: Authority, port: int) -> float:
    """Deliver what all good vehicles have, and return how long it took [s]."""
    folder, begin_s = authority.folder, time.monotonic()
    async with AsyncExitStack() as stack:
        stores, outboxes = {}, {}
        for name in GOOD:
            store = stores[name] = stack.enter_context(closing(ResultStore.in_memory()))
            tls = TlsFiles(authority=folder / "ca.crt", certificate=folder / f"{name}.crt", key=folder / f"{name}.key")
            address = BrokerAddress(host="127.0.0.1", port=port, tls=tls)
            identifier = f"clutchdiag-{name}-{store.connection_secret()}"
            connect = partial(MqttConnector(address, identifier, is_persistent=True).connect, NOW)
            outbox = outboxes[name] = Outbox(
                store,
                name,
                connect,
                str(address),
                acknowledge=Acknowledge.BACKEND,
                limits=QUICK,
            )
            await stack.enter_async_context(sending(outbox))
        for number in range(1, SHIFTS + 1):
            for name in GOOD:
                put(stores[name], [number], vehicle=name)
                outboxes[name].wake()
            await asyncio.sleep(0.05)
        await until(lambda: not any(stores[name].unpublished_count(name) for name in GOOD), 90.0)
    return time.monotonic() - begin_s


def backend(authority: Authority) -> tuple[str, ...]:
    folder = authority.folder
    names = (("--ca", "ca.crt"), ("--cert", "fleet-backend.crt"), ("--key", "fleet-backend.key"))
    return tuple(word for option, name in names for word in (option, str(folder / name)))


def stored(url: str) -> int:
    """Return how many results the fleet's database has."""
    engine = open_database(url)
    try:
        return queries.result_count(engine)
    finally:
        engine.dispose()


async def test_it_hurts_nobody_behind_mosquitto(tmp_path: Path, authority: Authority, sqlite_url: str) -> None:
    broker = fleet_broker(tmp_path / "mosquitto", authority)
    broker.start()
    open_database(sqlite_url).dispose()
    try:
        with worker(tmp_path, f"mqtts://127.0.0.1:{broker.port}", sqlite_url, *backend(authority), "--group", GROUP):
            hostile = Hostile(authority, broker.port, is_version_5=True)
            granted = [topic for topic in OTHERS if hostile.subscribe(topic)]
            with hostile.storming():
                took_s = await deliver(authority, broker.port)
    finally:
        broker.stop()
    assert granted == []
    assert hostile.heard == []
    assert stored(sqlite_url) == len(GOOD) * SHIFTS
    assert took_s < 60.0
    log = (tmp_path / "mosquitto" / "mosquitto.log").read_text(encoding="utf-8", errors="replace")
    assert f"Client {BAD} already connected" in log
    assert not any(f"Client {name} already connected" in log for name in (*GOOD, "fleet-backend"))


async def test_it_hurts_nobody_behind_nats(tmp_path: Path, authority: Authority, sqlite_url: str) -> None:
    text = (DEPLOY / "nats.conf").read_text(encoding="utf-8").partition("authorization {")[0]
    text += f"authorization {{\n{nats_users([*GOOD, BAD, 'fleet-backend'])}}}\n"
    folder = tmp_path / "nats"
    folder.mkdir()
    server = NatsServer(folder, text.replace("/etc/clutchdiag", str(authority.folder)))
    server.start()
    open_database(sqlite_url).dispose()
    url = server.url.replace("nats://", "nats+tls://")
    try:
        with worker(tmp_path, url, sqlite_url, *backend(authority)):
            hostile = Hostile(authority, server.port, is_version_5=False, flood_count=1)
            granted = [topic for topic in OTHERS if hostile.subscribe(topic)]
            with hostile.storming():
                took_s = await deliver(authority, server.port)
    finally:
        server.stop()
    assert granted == []
    assert hostile.heard == []
    assert stored(sqlite_url) == len(GOOD) * SHIFTS
    assert took_s < 60.0


def test_the_shipped_access_is_what_the_program_writes(authority: Authority) -> None:
    write_access(authority.folder)
    written = (authority.folder / "dynamic-security.json").read_text(encoding="utf-8")
    assert f'"vehicle {BAD}"' in written
    assert '"vehicle fleet-backend"' not in written
    shipped = (DEPLOY / "dynamic-security.json").read_text(encoding="utf-8")
    assert shipped == mosquitto_access(["CAR1", "fleet-backend"])
