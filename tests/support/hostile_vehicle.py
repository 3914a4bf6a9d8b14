"""A legitimate vehicle that means ill, under the brokers' configurations of docs/deploy, and good ones beside it."""

import asyncio
import ssl
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AsyncExitStack, ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_backend.certificates.access import nats_users
from fleet_backend.certificates.authority import Authority, Lifetime
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_link import BrokerAddress, TlsFiles
from tests.support.fleet_broker import DEPLOY, fleet_broker
from tests.support.fleet_worker import worker
from tests.support.nats import NatsServer
from tests.support.outboxes import NOW, put, sending, until
from tests.support.patience import HANG_S

QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)
BAD = "carX"
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


class Hostile:
    """What a vehicle with its own certificate tries, from connections of its own."""

    def __init__(
        self, authority: Authority, port: int, victims: Sequence[str], *, is_version_5: bool, flood_count: int = 20
    ) -> None:
        self.codes: list[int] = []  # what the broker said to its subscriptions
        self.heard: list[str] = []  # topics on which it was told something
        self._folder = authority.folder
        self._port = port
        self._victims = victims
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

    def tell(self, topic: str) -> None:
        """Write what a topic of another is to say, once."""
        client = self.client(f"{BAD}-{len(self.codes)}")
        client.publish(topic, b"x", 1).wait_for_publish(HANG_S)
        client.disconnect()
        client.loop_stop()

    def vanish(self) -> None:
        """Leave without a farewell: the broker is to speak the will, which is one for another."""
        client = self.client(f"{BAD}-will")
        deadline_s = time.monotonic() + HANG_S
        while not client.is_connected() and time.monotonic() < deadline_s:
            time.sleep(0.01)
        client.loop_stop()
        connection = client.socket()
        if connection is not None:
            connection.close()

    def storm(self) -> None:
        """Take over, flood and retain until it is over."""
        number = 0
        while not self._is_over.is_set():
            victim = self._victims[number % len(self._victims)]
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


async def deliver(authority: Authority, port: int, names: Sequence[str], seqs: Iterable[int]) -> float:
    """Deliver what vehicles have, results of these positions each, and return how long it took [s]."""
    folder, begin_s = authority.folder, time.monotonic()
    async with AsyncExitStack() as stack:
        stores, outboxes = {}, {}
        for name in names:
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
        for number in seqs:
            for name in names:
                put(stores[name], [number], vehicle=name)
                outboxes[name].wake()
            await asyncio.sleep(0.05)
        await until(lambda: not any(stores[name].unpublished_count(name) for name in names), 90.0)
    return time.monotonic() - begin_s


def backend_words(authority: Authority) -> tuple[str, ...]:
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


def authority_of(folder: Path, names: Sequence[str]) -> Authority:
    """Return an authority that has given certificates to a broker, the backend, some vehicles and the bad one."""
    day = Lifetime.of_days(1, datetime.now(UTC))
    authority = Authority.make(folder, day)
    authority.issue_server("broker", ["127.0.0.1"], day)
    for name in (*names, BAD, "fleet-backend"):
        authority.issue_client(name, day)
    return authority


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of an attack."""

    usual_s: float  # that the same results take without it
    took_s: float
    stored_count: int
    granted: list[str]  # subscriptions of the bad one
    heard: list[str]
    log: str  # of the broker

    def unseen(self, kind: str) -> list[str]:
        """Return the attempts of which the broker's log says nothing."""
        return [name for name, word in TRACES[kind].items() if word not in self.log]


# What the log of a broker says of each attempt.
TRACES = {
    "mosquitto": {
        "take over a session": f"Client {BAD} already connected, closing old connection",
        "write to another": f"Denied PUBLISH from {BAD} ",
        "a huge session": f"as {BAD} (p5, c",
        **{f"subscribe {topic}": f"\t{topic} (QoS 1)" for topic in OTHERS},
    },
    "nats": {
        "take over a session": '"clutchdiag-car1" - ',
        "write to another": f'Publish Violation - User "CN={BAD}"',
        "a huge session": '"huge-',
        "a will for another": f'Publish Violation - User "CN={BAD}", Subject "clutchdiag.v1.car1.status"',
        **{
            f"subscribe {topic}": 'Subscription Violation - User "CN=carX", Subject "{}"'.format(
                topic.replace("/", ".").replace("+", "*").replace("#", ">")
            )
            for topic in OTHERS
        },
    },
}


async def attack(folder: Path, kind: str, names: Sequence[str], shifts: int) -> Outcome:
    """Let vehicles deliver, then once more under attack of one of their own kind."""
    authority, url = authority_of(folder / "certificates", names), f"sqlite:///{folder}/fleet.sqlite"
    engine = open_database(url)
    migrate(engine)
    engine.dispose()
    words, place = backend_words(authority), folder / kind
    with ExitStack() as stack:
        flood_count = 20 if kind == "mosquitto" else 1
        if kind == "mosquitto":
            mosquitto = fleet_broker(place, authority)
            mosquitto.start()
            stack.callback(mosquitto.stop)
            port, words = mosquitto.port, (*words, "--group", GROUP)
            address = f"mqtts://127.0.0.1:{port}"
        else:
            text = (DEPLOY / "nats.conf").read_text(encoding="utf-8").partition("authorization {")[0]
            text += f"authorization {{\n{nats_users([*names, BAD, 'fleet-backend'])}}}\n"
            place.mkdir()
            server = NatsServer(place, text.replace("/etc/clutchdiag", str(authority.folder)))
            server.start()
            stack.callback(server.stop)
            port, address = server.port, server.url.replace("nats://", "nats+tls://")
        stack.enter_context(worker(folder, address, url, *words))
        is_version_5 = kind == "mosquitto"
        hostile = Hostile(authority, port, names, is_version_5=is_version_5, flood_count=flood_count)
        usual_s = await deliver(authority, port, names, range(1, shifts + 1))
        granted = [topic for topic in OTHERS if hostile.subscribe(topic)]
        hostile.tell(f"clutchdiag/v1/{names[0]}/ack")
        hostile.vanish()
        with hostile.storming():
            took_s = await deliver(authority, port, names, range(shifts + 1, 2 * shifts + 1))
    (log,) = place.glob("*.log")
    return Outcome(
        usual_s=usual_s,
        took_s=took_s,
        stored_count=stored(url),
        granted=granted,
        heard=hostile.heard,
        log=log.read_text(encoding="utf-8", errors="replace"),
    )
