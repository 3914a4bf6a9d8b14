"""What one vehicle that means ill costs the others: 1,000 results of 20 vehicles, without it and while it attacks.

It has a certificate of its own and the brokers are as docs/deploy has them. It subscribes to what is others', takes
over sessions, floods, retains, leaves wills and huge sessions, fills the broker's memory, listens on the port of NATS.
Then two attacks of their own: messages that are all properties, and readers of the page who do not read.

    python -m studies.fleet_hostile
    python -m studies.fleet_hostile --only properties
"""

import asyncio
import math
import re
import ssl
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import paho.mqtt.client as mqtt
import psutil
from nats.aio.client import Client as NatsClient
from nats.aio.msg import Msg
from nats.errors import Error as NatsError
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from sqlalchemy import Engine

from demo.fleet.brokers import Mosquitto, NatsServer
from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_backend import queries
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_link import BrokerAddress, Connection, Terms, TlsFiles, VersionRefusedError
from studies.builders import shift_result
from studies.fleet_ingest import workers
from studies.fleet_properties import (
    KEPT,
    UNPACKED,
    UNPACKED_PROPERTIES,
    RawVehicle,
    filling_messages,
    hostile_context,
    peak_bytes,
    slow_messages,
)
from studies.fleet_readers import READERS, VEHICLES, attack_by_readers
from studies.run import parsed, study_parser

HANG_S = 120.0  # longer than anything takes
TAKEN_S = 60.0  # in which the results of a vehicle are stored, at most
MOST_BROKER_BYTES = 150 * 2**20
MOST_PAGE_BYTES = 384 * 2**20  # the limit of docker-compose.yml
DELIVERED_S = 90.0  # in which a fleet's results are taken, or never
LATER_S = 60.0  # than usual, at most
MANY_TOPICS, MANY_PARTS = 1_200, 1_040  # of 100 kB: retained, and of quality 2 that are never released
KEPT_MB = 50.0  # by which a broker may grow, at most
DEPLOY = Path(__file__).parents[1] / "docs" / "deploy"
OURS = re.compile(r"(#|listener|allow_anonymous|persistence|max_(inflight|queued)_messages)")  # of its configuration
PLUGIN = "mosquitto_dynamic_security.so"
NOW = "2026-01-01T00:00:00.000000Z"
STATE = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)
BAD = "carX"
SETTLE_S = 20.0  # for what a broker neither takes nor refuses
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
    "$MQTT/#",
    "$JS/#",
    "_INBOX/#",
)
INNER = "$MQTT/sub/#"  # where a nats-server hands messages of quality 1 to its sessions
NATIVE = (">", "$MQTT.>", "$MQTT.sub.>", "$JS.>", "_INBOX.>", "clutchdiag.v1.>", f"clutchdiag.v1.{BAD}.ack")
TOPICS, PARTS, PART_BYTES = 200, 100, 100_000  # of a short attack


class _Unreleased(mqtt.Client):
    """A client that never releases what it sent with quality 2: the broker is to keep it."""

    def _handle_pubrec(self) -> MQTTErrorCode:
        return MQTTErrorCode.MQTT_ERR_SUCCESS


class Hostile:
    """What a vehicle with its own certificate tries, from connections of its own."""

    def __init__(
        self, folder: Path, port: int, victims: Sequence[str], *, is_version_5: bool, flood_count: int = 20
    ) -> None:
        self.codes: list[int] = []  # what the broker said to its subscriptions
        self.heard: list[str] = []  # topics on which it was told something
        self._native: NatsClient | None = None
        self._folder = folder
        self._port = port
        self._victims = victims
        self._flood_count = flood_count  # messages of each connection to each topic
        self._version = MQTTProtocolVersion.MQTTv5 if is_version_5 else MQTTProtocolVersion.MQTTv311
        self._is_over = threading.Event()

    def client(self, identifier: str, *, is_huge: bool = False, kind: type[mqtt.Client] = mqtt.Client) -> mqtt.Client:
        """Return a connection under a name, with a will that speaks for another."""
        is_clean = not is_huge if self._version is MQTTProtocolVersion.MQTTv311 else None
        client = kind(
            CallbackAPIVersion.VERSION2, identifier, is_clean, protocol=self._version, reconnect_on_failure=False
        )
        folder = self._folder
        client.tls_set(
            f"{folder}/ca.crt", f"{folder}/{BAD}.crt", f"{folder}/{BAD}.key", tls_version=ssl.PROTOCOL_TLS_CLIENT
        )
        client.on_subscribe = lambda _c, _u, _m, codes, _p: self.codes.extend(code.value for code in codes)
        client.on_message = lambda _c, _u, message: self.heard.append(message.topic)
        client.max_inflight_messages_set(2_000)
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

    def fill(self, topic_count: int, part_count: int) -> None:
        """Make the broker keep all it can: retained messages under made-up names, quality 2 that is never released."""
        self._send(mqtt.Client, [f"clutchdiag/v1/{BAD}/clutch/{number}" for number in range(3, topic_count + 3)], 1)
        self._send(_Unreleased, [f"clutchdiag/v1/{BAD}/shift"] * part_count, 2)

    def _send(self, kind: type[mqtt.Client], topics: Sequence[str], qos: int) -> None:
        client = self.client(f"{BAD}-fill-{qos}", kind=kind)
        deadline_s = time.monotonic() + SETTLE_S
        while not client.is_connected() and time.monotonic() < deadline_s:
            time.sleep(0.01)
        sent = [client.publish(topic, b"x" * PART_BYTES, qos, retain=qos == 1) for topic in topics]
        while client.is_connected() and not all(one.is_published() for one in sent) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        client.disconnect()
        client.loop_stop()

    async def listen(self, url: str) -> None:
        """Subscribe on the port of NATS itself, whatever is said there to sessions and workers."""
        context = ssl.create_default_context(cafile=str(self._folder / "ca.crt"))
        context.load_cert_chain(self._folder / f"{BAD}.crt", self._folder / f"{BAD}.key")

        async def hear(message: Msg) -> None:
            self.heard.append(message.subject)

        client = NatsClient()
        try:
            await client.connect(url.replace("nats://", "tls://"), tls=context, allow_reconnect=False)
            for subject in NATIVE:
                await client.subscribe(subject, cb=hear)
            await client.flush()
            self._native = client
        except (NatsError, OSError):  # refused
            await client.close()

    async def close(self) -> None:
        if self._native is not None:
            await self._native.close()

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


def certify(folder: Path, *names: str) -> Path:
    """Make an authority and certificates, by the commands of docs/operations.md; return the folder."""
    folder.mkdir(parents=True)
    signed = "-addext basicConstraints=critical,CA:FALSE -CA ca.crt -CAkey ca.key"
    for name in ("ca", *names):
        of = {"ca": "", "broker": f"-addext subjectAltName=IP:127.0.0.1 -addext extendedKeyUsage=serverAuth {signed}"}
        more = of.get(name, f"-addext extendedKeyUsage=clientAuth {signed}")
        command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 30"
        command += f" -subj /CN={name} -keyout {name}.key -out {name}.crt {more}"
        subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)
    return folder


def tls_files(folder: Path, name: str) -> TlsFiles:
    return TlsFiles(authority=folder / "ca.crt", certificate=folder / f"{name}.crt", key=folder / f"{name}.key")


def write_access(folder: Path, vehicles: Iterable[str]) -> None:
    """Write the brokers' files into a folder, with an entry for each vehicle, as docs/operations.md has it."""
    for name in ("dynamic-security.json", "nats.conf"):
        lines = []
        for line in (DEPLOY / name).read_text(encoding="utf-8").splitlines():
            lines += [line, *(line.replace("VEHICLE", one) for one in vehicles if "VEHICLE" in line)]
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
        (folder / name).chmod(0o600)


def fleet_broker(folder: Path, certificates: Path) -> Mosquitto:
    """Return a Mosquitto as docs/deploy has it, off until started."""
    plugin = min(path for place in ("/usr/lib", "/usr/local/lib") for path in Path(place).rglob(PLUGIN))
    text = (DEPLOY / "mosquitto.conf").read_text(encoding="utf-8")
    text = text.replace(f"/usr/lib/x86_64-linux-gnu/{PLUGIN}", str(plugin)).replace(
        "/etc/clutchdiag", str(certificates)
    )
    lines = tuple(line for line in text.splitlines() if line and not OURS.match(line))
    return Mosquitto(folder, lines, is_durable=False)


async def deliver(
    certificates: Path, port: int, names: Sequence[str], seqs: Iterable[int], *, pause_s: float = 0.05
) -> float:
    """Deliver what vehicles have, results of these positions each, and return how long it took [s].

    Between the results of a vehicle there is a pause; raises TimeoutError if they are not taken in time.
    """
    begin_s = time.monotonic()
    async with AsyncExitStack() as stack:
        stores, outboxes = {}, {}
        for name in names:
            store = stores[name] = stack.enter_context(closing(ResultStore.in_memory()))
            address = BrokerAddress(host="127.0.0.1", port=port, tls=tls_files(certificates, name))
            identifier = f"clutchdiag-{name}-{store.connection_secret()}"
            connect = partial(MqttConnector(address, identifier, is_persistent=True).connect, NOW)
            word = Acknowledge.BACKEND
            outbox = outboxes[name] = Outbox(store, name, connect, str(address), acknowledge=word, limits=QUICK)
            sender = asyncio.create_task(outbox.run())
            stack.push_async_callback(asyncio.wait, [sender])
            stack.callback(sender.cancel)
        for number in seqs:
            for name in names:
                stores[name].add(shift_result(number, vehicle=name), STATE)
                outboxes[name].wake()
            await asyncio.sleep(pause_s)
        async with asyncio.timeout(DELIVERED_S):
            while any(stores[name].unpublished_count(name) for name in names):  # noqa: ASYNC110 - nobody tells
                await asyncio.sleep(0.01)
    return time.monotonic() - begin_s


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackOutcome:
    """What came of an attack."""

    usual_s: float  # that the same results take without it
    took_s: float
    stored_count: int
    granted: list[str]  # subscriptions of the bad one
    heard: list[str]
    log: str  # of the broker
    kept_bytes: int  # by which the broker grew when it was filled
    sent_bytes: int  # to fill it

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
        "the port of NATS itself": "authentication error",
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


@contextmanager
def fleet_of(folder: Path, names: Sequence[str]) -> Iterator[tuple[Path, Mosquitto, Engine]]:
    """Yield certificates, a Mosquitto as docs/deploy has it and a worker's database, for as long as the block lasts."""
    certificates = certify(folder / "certificates", "broker", *names, BAD, "fleet-backend")
    write_access(certificates, (*names, BAD))
    place, url = folder / "mosquitto", f"sqlite:///{folder}/fleet.sqlite"
    place.mkdir()
    engine = open_database(url)
    migrate(engine)
    broker = fleet_broker(place, certificates)
    broker.start()
    files = tls_files(certificates, "fleet-backend")
    words = ["--ca", str(files.authority), "--cert", str(files.certificate), "--key", str(files.key), "--group", GROUP]
    with ExitStack() as stack:
        stack.callback(engine.dispose)
        stack.callback(broker.stop)
        stack.enter_context(workers(f"mqtts://127.0.0.1:{broker.port}", url, 1, words))
        yield certificates, broker, engine


@dataclass(frozen=True, slots=True, kw_only=True)
class PropertiesOutcome:
    """What came of messages that are all properties."""

    took_s: float  # for the results of another vehicle; infinite: not all came
    stored_count: int
    taken_count: int  # hostile messages that the broker took
    aside: frozenset[str]  # why the backend put messages aside
    aside_count: int
    broker_bytes: int  # at most
    kept_count: int  # messages that were to fill the broker, and were taken


async def attack_by_properties(
    folder: Path, results: int, slow_count: int = UNPACKED, filling_count: int = KEPT
) -> PropertiesOutcome:
    """Let a vehicle deliver while another sends messages that are all properties."""
    topic = f"clutchdiag/v1/{BAD}/shift"
    shift_result()  # the first takes its time, which is none of the broker's
    with fleet_of(folder, ["car1"]) as (certificates, broker, engine):
        vehicle = RawVehicle(broker.port, BAD, hostile_context(certificates, BAD))
        taken_count = await asyncio.to_thread(vehicle.send, slow_messages(topic, slow_count))
        filling = asyncio.create_task(asyncio.to_thread(vehicle.send, filling_messages(topic, filling_count)))
        try:
            took_s = await deliver(certificates, broker.port, ["car1"], range(1, results + 1), pause_s=0.0)
        except TimeoutError:
            took_s = math.inf
        vehicle.stop()
        kept_count = await filling
        aside = queries.quarantined(engine, 1_000)
        return PropertiesOutcome(
            took_s=took_s,
            stored_count=queries.result_count(engine),
            taken_count=taken_count,
            aside=frozenset(str(record["detail"]) for record in aside),
            aside_count=len(aside),
            broker_bytes=peak_bytes(broker.pid),
            kept_count=kept_count,
        )


async def refuses_version_5(folder: Path) -> bool:
    """Return whether a nats-server refuses a connection of MQTT 5, and with it the properties of messages."""
    server = NatsServer(folder)
    server.start()
    try:
        connection = await Connection.open(BrokerAddress(host="127.0.0.1", port=server.port), Terms())
    except VersionRefusedError:
        return True
    finally:
        server.stop()
    await connection.close()
    return False


async def attack(
    folder: Path, kind: str, names: Sequence[str], shifts: int, topic_count: int = TOPICS, part_count: int = PARTS
) -> AttackOutcome:
    """Let vehicles deliver, then once more under attack of one of their own kind."""
    certificates = certify(folder / "certificates", "broker", *names, BAD, "fleet-backend")
    url = f"sqlite:///{folder}/fleet.sqlite"
    engine = open_database(url)
    migrate(engine)
    write_access(certificates, (*names, BAD))
    files, place = tls_files(certificates, "fleet-backend"), folder / kind
    words = ["--ca", str(files.authority), "--cert", str(files.certificate), "--key", str(files.key)]
    place.mkdir()
    with ExitStack() as stack:
        stack.callback(engine.dispose)
        flood_count = 20 if kind == "mosquitto" else 1
        if kind == "mosquitto":
            mosquitto = fleet_broker(place, certificates)
            mosquitto.start()
            stack.callback(mosquitto.stop)
            port, pid, words = mosquitto.port, mosquitto.pid, [*words, "--group", GROUP]
            address = f"mqtts://127.0.0.1:{port}"
        else:
            text = (certificates / "nats.conf").read_text(encoding="utf-8")
            server = NatsServer(place, text.replace("/etc/clutchdiag", str(certificates)))
            server.start()
            stack.callback(server.stop)
            port, pid, address = server.port, server.pid, server.url.replace("nats://", "nats+tls://")
        stack.enter_context(workers(address, url, 1, words))
        is_version_5 = kind == "mosquitto"
        hostile = Hostile(certificates, port, names, is_version_5=is_version_5, flood_count=flood_count)
        if kind == "nats":
            await hostile.listen(server.url)
        usual_s = await deliver(certificates, port, names, range(1, shifts + 1))
        granted = [topic for topic in (*OTHERS, INNER) if hostile.subscribe(topic)]
        hostile.tell(f"clutchdiag/v1/{names[0]}/ack")
        hostile.vanish()
        before_bytes = psutil.Process(pid).memory_info().rss
        await asyncio.to_thread(hostile.fill, topic_count, part_count)
        kept_bytes = psutil.Process(pid).memory_info().rss - before_bytes
        with hostile.storming():
            took_s = await deliver(certificates, port, names, range(shifts + 1, 2 * shifts + 1))
        await hostile.close()
        stored_count = queries.result_count(engine)
    (log,) = place.glob("*.log")
    return AttackOutcome(
        usual_s=usual_s,
        took_s=took_s,
        stored_count=stored_count,
        granted=granted,
        heard=hostile.heard,
        log=log.read_text(encoding="utf-8", errors="replace"),
        kept_bytes=kept_bytes,
        sent_bytes=(topic_count + part_count) * PART_BYTES,
    )


def vehicles_kept(names: Sequence[str], results: int) -> bool:
    """Play a vehicle that means ill on both brokers, print the figures, and return whether all keep their aims."""
    is_kept = True
    for kind in TRACES:
        with TemporaryDirectory() as folder:
            found = asyncio.run(attack(Path(folder), kind, names, results, MANY_TOPICS, MANY_PARTS))
        lost_count = 2 * len(names) * results - found.stored_count
        later_s, unseen = found.took_s - found.usual_s, found.unseen(kind)
        print(
            f"{kind}: {len(names) * results} results usually in {found.usual_s:.1f} s, under attack in"
            f" {found.took_s:.1f} s (aim {LATER_S:g} s later at most), {lost_count} lost; {len(found.granted)}"
            f" subscriptions granted, {len(found.heard)} messages heard; the broker grew by"
            f" {found.kept_bytes / 1e6:.0f} MB for {found.sent_bytes / 1e6:.0f} MB (aim {KEPT_MB:g} MB at most);"
            f" attempts that its log does not tell: {unseen}",
            flush=True,
        )
        is_kept = is_kept and later_s <= LATER_S and found.kept_bytes <= KEPT_MB * 1e6
        is_kept = is_kept and not (lost_count or found.granted or found.heard or unseen)
    return is_kept


def properties_kept(results: int) -> bool:
    """Play messages that are all properties, print the figures, and return whether all keep their aims."""
    with TemporaryDirectory() as folder:
        outcome = asyncio.run(attack_by_properties(Path(folder), results))
    with TemporaryDirectory() as folder:
        is_refused = asyncio.run(refuses_version_5(Path(folder)))
    print(
        f"properties, mosquitto: {outcome.stored_count} of {results} results of another vehicle stored in"
        f" {outcome.took_s:.1f} s (aim {TAKEN_S:g} s at most); of {UNPACKED} messages of {UNPACKED_PROPERTIES}"
        f" properties {outcome.aside_count} put aside; messages to fill the broker that it took: {outcome.kept_count};"
        f" it had {outcome.broker_bytes / 2**20:.0f} MiB (aim {MOST_BROKER_BYTES / 2**20:g} MiB at most)\n"
        f"properties, nats: MQTT 5 is {'refused' if is_refused else 'TAKEN'}",
        flush=True,
    )
    is_kept = outcome.stored_count == results and outcome.took_s <= TAKEN_S and outcome.aside_count == UNPACKED
    return is_kept and outcome.broker_bytes <= MOST_BROKER_BYTES and not outcome.kept_count and is_refused


def readers_kept(vehicles: int) -> bool:
    """Play readers who do not read, print the figures, and return whether all keep their aims."""
    with TemporaryDirectory() as folder:
        outcome = attack_by_readers(Path(folder), vehicles)
    print(
        f"readers: {READERS} ask for {vehicles} vehicles and do not read: the page has"
        f" {outcome.before_bytes / 2**20:.0f} MiB before, {outcome.most_bytes / 2**20:.0f} MiB at most (aim"
        f" {MOST_PAGE_BYTES / 2**20:g} MiB), {outcome.after_bytes / 2**20:.0f} MiB after; others had"
        f" {outcome.answered_count} of {outcome.asked_count} answers; {outcome.left_count} of {READERS} were left",
        flush=True,
    )
    is_kept = outcome.most_bytes <= MOST_PAGE_BYTES and outcome.left_count == READERS
    return is_kept and outcome.answered_count == outcome.asked_count


def main() -> int:
    """Print the figures; return 0 if all keep their aims."""
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--results", type=int, default=50, help="of each")
    parser.add_argument("--others", type=int, default=1_000, help="results of a vehicle beside one of properties")
    parser.add_argument("--shown", type=int, default=VEHICLES, help="vehicles of a page whose readers do not read")
    parser.add_argument("--only", choices=list(ATTACKS), help="one of the attacks")
    options = parsed(parser, vehicles=5, results=20, others=200, shown=5_000)
    attacks = ATTACKS if options.only is None else {options.only: ATTACKS[options.only]}
    outcomes = [is_kept(options) for is_kept in attacks.values()]  # each is played, whatever became of the others
    return 0 if all(outcomes) else 1


ATTACKS: Final[Mapping[str, Callable[[Namespace], bool]]] = {
    "vehicles": lambda options: vehicles_kept(
        [f"car{number}" for number in range(1, options.vehicles + 1)], options.results
    ),
    "properties": lambda options: properties_kept(options.others),
    "readers": lambda options: readers_kept(options.shown),
}


if __name__ == "__main__":
    sys.exit(main())
