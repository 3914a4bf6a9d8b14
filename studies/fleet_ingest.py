"""Throughput of the fleet backend: two workers between a real Mosquitto and a real PostgreSQL that syncs every commit.

Each result travels from a publisher through broker, check, transaction and back as an acknowledgement. Beside it the
same rows written by one process without broker and check: the database's own pace, in the same run.

    python -m studies.fleet_ingest
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from studies.fleet_load import Load, Wire, wire
from demo.fleet.servers import PostgresServer, mosquitto
from diag_service.diagnosis.records import shift_record
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.queries import table_hash
from fleet_backend.rows import Row, shift_row
from fleet_backend.writer import Batch, Writer
from fleet_contract import Channel, shift_message, topic_of
from tests.support.builders import shift_result

TARGET_PER_S = 5000
VEHICLES = 40
BATCH = 500
WINDOW = 4000  # results on their way
ROUNDS = 3
BROKER_LINES = ("max_inflight_messages 0", "max_queued_messages 0")


@contextmanager
def workers(address: str, database: str, count: int) -> Iterator[None]:
    """Run ingest workers for as long as the block lasts."""
    command = [sys.executable, "-m", "fleet_backend", "ingest", "--broker", address, "--database", database]
    command += ["--batch", str(BATCH), "--quotas", "0,0,0"]
    children = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(count)]
    try:
        for child in children:
            wait_until_listening(child)
        yield
    finally:
        for child in children:
            child.terminate()
        for child in children:
            _, told = child.communicate()
            sys.stdout.writelines(line for line in told.splitlines(keepends=True) if "WARNING" in line)


def wait_until_listening(child: "subprocess.Popen[str]") -> None:
    """Return when a worker says that it listens."""
    while child.stderr is not None and (line := child.stderr.readline()):
        if "listening" in line:
            return
    raise RuntimeError("a worker did not start")


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


def vehicle_names() -> list[str]:
    return [f"car{number}" for number in range(VEHICLES)]


def messages(first: int, count: int) -> list[Wire]:
    """Return results of all vehicles in turn, from a position of their streams on."""
    made: list[Wire] = []
    for number in range(count):
        vehicle, seq = f"car{number % VEHICLES}", first + number // VEHICLES
        message = shift_message(shift_record(shift_result(seq, vehicle=vehicle, to_gear=2 + seq % 5)))
        made.append(wire(message.topic, message.payload))
    return made


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
        stack.enter_context(workers(f"mqtt://127.0.0.1:{port}", database, worker_count))
        load = Load(port, "load", [topic_of(vehicle, Channel.ACK) for vehicle in vehicle_names()])
        stack.callback(load.close)
        rates: list[float] = []
        busy_s: dict[str, float] = {}
        for number in range(rounds):
            made = messages(1 + number * count, count)
            load.acknowledged_count = 0
            before_s = processor_s()
            rates.append(count / load.send(made, WINDOW, timeout_s=120.0))
            busy_s = {name: busy_s.get(name, 0.0) + used_s for name, used_s in spent_s(before_s).items()}
        load.acknowledged_count = 0
        again = count / load.send(made, WINDOW, timeout_s=120.0)
        found = table_hash(engine)
        bare = bare_rate(database, count)
    best = max(rates)
    shown = ", ".join(f"{rate:,.0f}" for rate in rates)
    print(f"{worker_count} workers, PostgreSQL with fsync, {count:,} results a round: {shown} results/s")
    print(f"best {best:,.0f}/s (target {TARGET_PER_S:,}), {best / bare:.2f} of one process that only writes rows")
    print(told_cost(busy_s, rounds * count))
    print(f"the last round once more: {again:,.0f}/s; {found.row_count:,} rows of {rounds * count:,} different results")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=int, default=20_000, help="per round")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    measure(options.results, options.rounds, options.workers)


if __name__ == "__main__":
    main()
