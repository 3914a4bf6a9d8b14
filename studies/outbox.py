"""How fast the outbox drains a backlog, and how long a live result takes meanwhile: ``python -m studies.outbox``.

A Mosquitto of its own, a backend in a process of its own that acknowledges by the hundred, and beside them the peer:
aiomqtt publishing one message after the other, as a service without pipelining would.
"""

import asyncio
import multiprocessing
import sqlite3
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Final

import aiomqtt
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from clutch_results.records import dump, iso_utc, shift_record
from demo.fleet.brokers import Mosquitto
from diag_service.delivery import Acknowledge, MqttConnector, Outbox
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_contract import (
    Channel,
    Receipt,
    ack_messages,
    filter_of,
    key_of,
    raw_shift_message,
    read_message,
)
from fleet_link import BrokerAddress
from studies.builders import shift_result
from studies.run import parsed, study_parser

VEHICLE: Final = "car1"
STATE: Final = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
PEER_COUNT: Final = 1000
LIVE_PERIOD_S: Final = 0.1


class TimedStore(ResultStore):
    """A store that notes when a result was acknowledged."""

    def __init__(self, *arguments: object, **options: object) -> None:
        super().__init__(*arguments, **options)  # type: ignore[arg-type]  # those of the base class
        self.settled_s: dict[int, float] = {}

    def note_receipts(self, receipts: Sequence[Receipt]) -> list[int]:
        positions = super().note_receipts(receipts)
        self.settled_s.update(dict.fromkeys(positions, time.monotonic()))
        return positions


def acknowledge(port: int, is_ready: Event) -> None:
    """Acknowledge results for ever; each batch stands for a commit."""
    heard: list[Receipt] = []
    lock = threading.Lock()

    def take(_client: mqtt.Client, _userdata: object, message: mqtt.MQTTMessage) -> None:
        key = key_of(read_message(message.topic, bytes(message.payload)).data)
        with lock:
            heard.append(Receipt(key=key))

    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="backend", clean_session=False)
    client.on_message = take
    client.on_connect = lambda client, *_: client.subscribe(filter_of(Channel.SHIFT), qos=1)
    client.on_subscribe = lambda *_: is_ready.set()
    client.connect("127.0.0.1", port)
    client.loop_start()
    while True:
        time.sleep(0.01)
        with lock:
            receipts, heard[:] = heard[:], []
        for ack in ack_messages(VEHICLE, receipts, sent_at=iso_utc(datetime.now(UTC)), worker="backend"):
            client.publish(ack.topic, ack.payload, qos=1)


@contextmanager
def backend(port: int) -> Iterator[None]:
    context = multiprocessing.get_context("spawn")
    is_ready = context.Event()
    process = context.Process(target=acknowledge, args=(port, is_ready), daemon=True)
    process.start()
    try:
        if not is_ready.wait(60.0):
            raise SystemExit("the backend did not start")
        yield
    finally:
        process.kill()
        process.join()


def filled_store(path: Path, count: int) -> TimedStore:
    """Return a store with a backlog, which is written at once: how fast it grew is another question."""
    TimedStore.open(path).close()
    records = (shift_record(shift_result(seq, vehicle=VEHICLE)) for seq in range(1, count + 1))
    keys = ("vehicle", "stream", "seq", "algorithm_version", "calibration_version", "clutch")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executemany(
            f"INSERT INTO result ({', '.join(keys)}, json) VALUES (?, ?, ?, ?, ?, ?, ?)",  # noqa: S608 - our own words
            ((*(record[key] for key in keys), dump(record)) for record in records),
        )
    return TimedStore.open(path)


async def drain(store: TimedStore, port: int, kind: Acknowledge) -> tuple[float, float, list[float]]:
    """Return the rate [results/s], our processor time per result [s] and the delays [s] of live results meanwhile."""
    address = BrokerAddress(host="127.0.0.1", port=port)
    connector = MqttConnector(address, "clutchdiag-benchmark", is_persistent=kind is Acknowledge.BACKEND)
    outbox = Outbox(
        store, VEHICLE, lambda: connector.connect(iso_utc(datetime.now(UTC))), str(address), acknowledge=kind
    )
    backlog = store.last_position(VEHICLE)
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    sender = asyncio.create_task(outbox.run())
    live_s: dict[int, float] = {}
    while store.waiting(VEHICLE, after=0, before=backlog + 1, limit=1):
        await asyncio.sleep(LIVE_PERIOD_S)
        if kind is Acknowledge.BACKEND:
            position = store.last_position(VEHICLE) + 1
            live_s[position] = time.monotonic()
            await asyncio.to_thread(store.add, shift_result(position, vehicle=VEHICLE), STATE)
            outbox.wake()
    duration_s, cpu_s = time.monotonic() - begin_s, time.process_time() - begin_cpu_s
    await outbox.close(sender, timeout_s=20.0)
    delays_s = [store.settled_s[position] - added_s for position, added_s in live_s.items()]
    return backlog / duration_s, cpu_s / backlog, delays_s


async def one_by_one(store: ResultStore, port: int) -> tuple[float, float]:
    rows = store.waiting(VEHICLE, after=0, before=2**62, limit=PEER_COUNT)
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    async with aiomqtt.Client("127.0.0.1", port, protocol=aiomqtt.ProtocolVersion.V5) as client:
        for row in rows:
            message = raw_shift_message(row.key, row.produced_at, row.text)
            await client.publish(message.topic, message.payload, qos=1)
            store.mark_published([row.position])
    return len(rows) / (time.monotonic() - begin_s), (time.process_time() - begin_cpu_s) / len(rows)


def measure(count: int) -> None:
    rates: dict[str, tuple[float, float]] = {}
    delays_s: list[float] = []
    for name in ("one by one, each marked", "outbox, broker's word", "outbox, backend's word"):
        with tempfile.TemporaryDirectory() as folder:
            broker = Mosquitto(Path(folder), is_durable=False)
            broker.start()
            is_peer = name.startswith("one")
            with closing(filled_store(Path(folder) / "car.sqlite", PEER_COUNT if is_peer else count)) as store:
                if is_peer:
                    rates[name] = asyncio.run(one_by_one(store, broker.port))
                elif "broker" in name:
                    rate, cpu_s, _ = asyncio.run(drain(store, broker.port, Acknowledge.BROKER))
                    rates[name] = rate, cpu_s
                else:
                    with backend(broker.port):
                        rate, cpu_s, delays_s = asyncio.run(drain(store, broker.port, Acknowledge.BACKEND))
                        rates[name] = rate, cpu_s
            broker.stop()
    peer, _ = rates["one by one, each marked"]
    for name, (rate, cpu_s) in rates.items():
        print(f"{name:<26} {rate:>8.0f} results/s  {rate / peer:>6.1f} x  {1e6 * cpu_s:>6.0f} us of this process each")
    print(f"live results during the drain, added to acknowledged: {len(delays_s)}, longest {max(delays_s):.2f} s")


def main() -> int:
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--results", type=int, default=10_000, help="backlog (default: %(default)s)")
    measure(parsed(parser, results=2_000).results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
