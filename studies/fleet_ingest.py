"""Throughput of the fleet backend: two workers between a real Mosquitto and a real PostgreSQL that syncs every commit.

Each result travels from a publisher through broker, check, transaction and back as an acknowledgement. Beside it the
same rows written by one process without broker and check: the database's own pace, in the same run.

    python -m studies.fleet_ingest
"""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory

import paho.mqtt.client as mqtt
import psutil
from paho.mqtt.enums import CallbackAPIVersion

from clutch_results.records import shift_record
from demo.fleet.servers import PostgresServer, mosquitto
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.queries import table_hash
from fleet_backend.rows import Row, shift_row
from fleet_backend.writer import Batch, Writer
from fleet_contract import Channel, shift_message, topic_of
from studies.builders import shift_result
from studies.run import parsed, study_parser

TARGET_PER_S = 5000
VEHICLES = 40
BATCH = 500
WINDOW = 4000  # results on their way
ROUNDS = 3
TIMEOUT_S = 120.0
PIECE = 200  # results per send
CONNECT, PUBLISH = 0x10, 0x32  # the latter with QoS 1
OPTIONS = ("--batch", str(BATCH), "--quotas", "0,0,0")
MOST_WARNINGS = 20
BROKER_LINES = ("max_inflight_messages 0", "max_queued_messages 0")


@contextmanager
def workers(address: str, database: str, count: int, options: Sequence[str]) -> Iterator[None]:
    """Run ingest workers for as long as the block lasts; some of what they warn of is printed in the end."""
    command = [sys.executable, "-m", "fleet_backend", "ingest", "--broker", address, "--database", database, *options]
    with ExitStack() as stack:
        logs = [stack.enter_context(NamedTemporaryFile("w+", encoding="utf-8")) for _ in range(count)]
        for log in logs:
            child = subprocess.Popen(command, stderr=log)
            stack.callback(child.kill)  # if it does not end by itself
            stack.callback(child.wait, TIMEOUT_S)
            stack.callback(child.terminate)
            while "listening" not in Path(log.name).read_text(encoding="utf-8"):
                if child.poll() is not None:
                    raise RuntimeError(Path(log.name).read_text(encoding="utf-8"))
                time.sleep(0.05)
        yield
        warnings = [line for log in logs for line in Path(log.name).read_text(encoding="utf-8").splitlines()]
        print("\n".join([line for line in warnings if "WARNING" in line][:MOST_WARNINGS]), end="")


def parts_of(own: psutil.Process) -> Iterator[tuple[str, psutil.Process]]:
    """Yield ourselves and everything we started, by what it is."""
    yield "load", own
    for process in own.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            yield "workers" if "fleet_backend" in process.cmdline() else process.name(), process


def processor_s() -> dict[str, float]:
    """Return the processor time that each part has used [s]."""
    used: dict[str, float] = {}
    for name, process in parts_of(psutil.Process()):
        with suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            used[name] = used.get(name, 0.0) + times.user + times.system
    return used


def spent_s(since: dict[str, float]) -> dict[str, float]:
    """Return the processor time that each part has used since then [s]."""
    return {name: now_s - since.get(name, 0.0) for name, now_s in processor_s().items()}


def told_cost(used: dict[str, float], count: int) -> str:
    """Return what a result costs in all and in each part, in words."""
    cost_us = {name: 1e6 * used_s / count for name, used_s in used.items()}
    shares = ", ".join(f"{name} {part_us:.0f}" for name, part_us in sorted(cost_us.items()))
    total_us = sum(cost_us.values())
    return f"{total_us:.0f} us of processor time per result ({shares}), so {2e6 / total_us:,.0f}/s on two idle cores"


def text(value: str) -> bytes:
    return len(value).to_bytes(2) + value.encode()


def packet(kind: int, body: bytes) -> bytes:
    """Return a packet of MQTT 3.1.1: kind, length in seven bits a byte, body."""
    length, digits = len(body), bytearray()
    while length > 127:
        digits.append(length & 127 | 128)
        length >>= 7
    return bytes([kind, *digits, length]) + body


def messages(first: int, count: int) -> list[bytes]:
    """Return results of all vehicles in turn as packets, from a position of their streams on."""
    made = []
    for number in range(count):
        vehicle, seq = f"car{number % VEHICLES}", first + number // VEHICLES
        message = shift_message(shift_record(shift_result(seq, vehicle=vehicle)))
        made.append(packet(PUBLISH, text(message.topic) + (number % 65_535 + 1).to_bytes(2) + message.payload))
    return made


class IngestLoad:
    """A load that costs next to nothing: packets made beforehand, a window of results without the backend's word.

    A client library would take more of the two cores to publish than the worker under test; it hears the words.
    """

    def __init__(self, port: int, vehicles: Sequence[str]) -> None:
        self.acknowledged_count = 0
        self._changed = threading.Condition()
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.sendall(packet(CONNECT, text("MQTT") + b"\x04\x02" + (600).to_bytes(2) + text("load")))
        threading.Thread(target=self._drain, daemon=True).start()
        is_ready = threading.Event()
        self._listener = mqtt.Client(CallbackAPIVersion.VERSION2, "listener")
        self._listener.on_message = self._hear
        self._listener.on_subscribe = lambda *_: is_ready.set()
        self._listener.connect("127.0.0.1", port)
        self._listener.subscribe([(topic_of(vehicle, Channel.ACK), 1) for vehicle in vehicles])
        self._listener.loop_start()
        is_ready.wait(TIMEOUT_S)

    def send(self, made: Sequence[bytes]) -> float:
        """Send all messages and wait for the backend's word on each; return how long it took [s]."""
        self.acknowledged_count, began_s = 0, time.perf_counter()
        for first in range(0, len(made), PIECE):
            piece = made[first : first + PIECE]
            self._wait(first + len(piece) - WINDOW)
            self._socket.sendall(b"".join(piece))
        self._wait(len(made))
        return time.perf_counter() - began_s

    def close(self) -> None:
        """Leave the broker."""
        self._socket.shutdown(socket.SHUT_RDWR)
        self._listener.disconnect()
        self._listener.loop_stop()

    def _wait(self, count: int) -> None:
        with self._changed:
            if not self._changed.wait_for(lambda: self.acknowledged_count >= count, TIMEOUT_S):
                raise TimeoutError(f"{self.acknowledged_count} acknowledged, {count} expected")

    def _hear(self, _client: mqtt.Client, _userdata: object, message: mqtt.MQTTMessage) -> None:
        with self._changed:
            self.acknowledged_count += len(json.loads(message.payload)["data"]["results"])
            self._changed.notify_all()

    def _drain(self) -> None:
        """Take what the broker answers, until the connection is closed."""
        with self._socket, suppress(OSError):
            while self._socket.recv(1 << 18):
                pass


def rows(count: int) -> list[Row]:
    return [
        shift_row(shift_record(shift_result(1 + number // VEHICLES, vehicle=f"bare{number % VEHICLES}")))
        for number in range(count)
    ]


def bare_rate(database: str, count: int) -> float:
    """Return how many ready rows one process writes [1/s]."""
    engine = open_database(database)
    writer, made = Writer(engine), rows(count)
    began_s = time.perf_counter()
    for first in range(0, count, BATCH):
        writer.store(Batch(shifts=made[first : first + BATCH]))
    took_s = time.perf_counter() - began_s
    engine.dispose()
    return count / took_s


def measure(count: int, rounds: int, worker_count: int) -> None:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        server = PostgresServer()
        stack.callback(server.close)
        server.start()
        database = server.create("fleet")
        engine = open_database(database)
        stack.callback(engine.dispose)
        migrate(engine)
        port = stack.enter_context(mosquitto(folder, BROKER_LINES))
        stack.enter_context(workers(f"mqtt://127.0.0.1:{port}", database, worker_count, OPTIONS))
        load = IngestLoad(port, [f"car{number}" for number in range(VEHICLES)])
        stack.callback(load.close)
        rates: list[float] = []
        busy_s: dict[str, float] = {}
        for number in range(rounds):
            made = messages(1 + number * count, count)
            before_s = processor_s()
            rates.append(count / load.send(made))
            busy_s = {name: busy_s.get(name, 0.0) + used_s for name, used_s in spent_s(before_s).items()}
        again = count / load.send(made)
        found = table_hash(engine)
        bare = bare_rate(database, count)
    best = max(rates)
    shown = ", ".join(f"{rate:,.0f}" for rate in rates)
    print(f"{worker_count} workers, PostgreSQL with fsync, {count:,} results a round: {shown} results/s")
    print(f"best {best:,.0f}/s (target {TARGET_PER_S:,}), {best / bare:.2f} of one process that only writes rows")
    print(told_cost(busy_s, rounds * count))
    print(f"the last round once more: {again:,.0f}/s; {found.row_count:,} rows of {rounds * count:,} different results")


def main() -> None:
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--results", type=int, default=20_000, help="per round")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--workers", type=int, default=2)
    options = parsed(parser, results=4_000, rounds=2)
    measure(options.results, options.rounds, options.workers)


if __name__ == "__main__":
    main()
