"""Nothing lost, nothing twice: 8,000 results of 4 vehicles while broker, workers and vehicles are killed with SIGKILL.

Three times: with a broker that saves at every change, with one that saves as Mosquitto is shipped, and with one whose
file is deleted once; or once with JetStream of a nats-server in its place. Every vehicle runs the real outbox, the
workers write into a real PostgreSQL.

    python -m studies.fleet_chaos
    python -m studies.fleet_chaos --broker nats
"""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from sqlalchemy import Engine, select

from clutch_results.records import dump, shift_record
from demo.fleet.brokers import Mosquitto, NatsServer
from demo.fleet.servers import PostgresServer
from diag_service.store import ResultStore
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_backend.queries import TableHash, table_hash
from fleet_backend.rows import shift_row
from fleet_backend.schema import SHIFT_RESULT
from fleet_backend.writer import Batch, Writer
from studies.builders import shift_result
from studies.fleet_edge import ALL_MADE, AT_WORK
from studies.run import parsed, study_parser

WORKERS: Final = 2
START_S: Final = 180.0  # until all are at work; a busy machine takes long
_LOOK_S: Final = 0.05
_LONGER: Final = 4.0
_ANY: Final = 2**62

Key = tuple[str, str, int]  # vehicle, stream, seq


class BrokerDisk(StrEnum):
    """How well the broker remembers what it acknowledged when it is killed."""

    SAVED = "saved"  # at every change
    DEFAULT = "default"  # every half hour, as Mosquitto is shipped
    DELETED = "deleted"  # as shipped, and its file is lost once


_BOUNDS: Final = (  # as docker-compose.yml has them
    *("max_qos 1", "max_packet_size 262144", "message_size_limit 262144", "memory_limit 209715200"),
)
_BROKER_LINES: Final = {
    BrokerDisk.SAVED: _BOUNDS,
    BrokerDisk.DEFAULT: (*_BOUNDS, "autosave_interval 1800", "autosave_on_changes false"),
    BrokerDisk.DELETED: (*_BOUNDS, "autosave_interval 1800", "autosave_on_changes false"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StormPlan:
    """What is produced, and how often what is killed."""

    edges: int = 4
    results_per_edge: int = 2000
    storm_s: float = 30.0  # at least
    broker_every_s: float = 3.0
    worker_every_s: float = 5.0
    edge_every_s: float = 7.0
    calm_s: float = 60.0  # in which all outboxes must be empty
    disk: BrokerDisk = BrokerDisk.SAVED
    is_nats: bool = False  # a nats-server with JetStream and its MQTT gateway in the place of Mosquitto

    @property
    def rate_per_s(self) -> float:
        """Results of one edge; they last somewhat longer than half of the storm."""
        return self.results_per_edge / (0.6 * self.storm_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class StormAccount:
    """What the storm left."""

    planned: int
    made: int
    stored: int
    waiting: int  # in outboxes, not yet in the database: late, not lost
    lost: int  # in neither
    is_equal: bool  # to a database that got every result once, in order
    kills: dict[str, int]
    drained_s: float | None  # after the last kill; None: not in time


class Storm:
    """All parts of a fleet as processes of one folder."""

    def __init__(self, folder: Path, database: str, plan: StormPlan) -> None:
        self._folder = folder
        self._database = database
        self._plan = plan
        broker_folder = folder / "broker"
        broker_folder.mkdir()
        self._broker: Mosquitto | NatsServer = (
            NatsServer(broker_folder) if plan.is_nats else Mosquitto(broker_folder, _BROKER_LINES[plan.disk])
        )
        self._broker_file = broker_folder / "mosquitto.db"
        self._like = folder / "result.json"  # what an edge sends again and again
        self._like.write_text(dump(shift_record(shift_result())), encoding="utf-8")
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._turn = {"worker": 0, "edge": 0}
        self._kills = {"broker": 0, "worker": 0, "edge": 0}

    def run(self) -> StormAccount:
        """Start everything, kill it for a while, wait for calm, and count."""
        engine = open_database(self._database)
        with ExitStack() as stack:
            stack.callback(engine.dispose)
            migrate(engine)
            stack.callback(self._end)
            self._broker.start()
            for name in (*self._names("worker"), *self._names("edge")):
                self._start(name)
            self._wait_for_all()
            self._rage()
            drained_s = self._calm()
            return self._account(engine, drained_s)

    def _wait_for_all(self) -> None:
        """Return when every part is at work; a storm over programs that still load would prove nothing."""
        deadline_s = time.monotonic() + START_S
        while not (self._all_say("worker", "listening") and self._all_say("edge", AT_WORK)):
            if time.monotonic() > deadline_s:
                raise TimeoutError("not all are at work")
            time.sleep(_LOOK_S)

    def _all_say(self, part: str, words: str) -> bool:
        return all(words in self._log(name).read_text(encoding="utf-8") for name in self._names(part))

    def _rage(self) -> None:
        plan = self._plan
        every_s = {"broker": plan.broker_every_s, "worker": plan.worker_every_s, "edge": plan.edge_every_s}
        began_s = time.monotonic()
        due_s = {part: began_s + period_s for part, period_s in every_s.items()}
        while (now_s := time.monotonic()) < began_s + self._storm_s():
            for part in [part for part, moment_s in due_s.items() if moment_s <= now_s]:
                due_s[part] += every_s[part]
                self._kill(part)
            time.sleep(_LOOK_S)

    def _storm_s(self) -> float:
        """Return how long it lasts: on a busy machine until all results are made, but not for ever."""
        return self._plan.storm_s * (1.0 if self._all_say("edge", ALL_MADE) else _LONGER)

    def _kill(self, part: str) -> None:
        """Kill a part, one of its kind in turn, and start it again at once."""
        self._kills[part] += 1
        if part == "broker":
            self._broker.kill()
            if self._plan.disk is BrokerDisk.DELETED and self._kills[part] == 2:
                self._broker_file.unlink(missing_ok=True)
            self._broker.start()
            return
        names = self._names(part)
        name = names[self._turn[part] % len(names)]
        self._turn[part] += 1
        child = self._children[name]
        child.kill()
        child.wait()
        self._start(name)

    def _calm(self) -> float | None:
        """Return how long it takes until every edge has ended with an empty outbox; None if too long."""
        began_s = time.monotonic()
        while time.monotonic() < began_s + self._plan.calm_s:
            if all(self._children[name].poll() == 0 for name in self._names("edge")):
                return time.monotonic() - began_s
            time.sleep(_LOOK_S)
        return None

    def _account(self, engine: Engine, drained_s: float | None) -> StormAccount:
        plan = self._plan
        for child in self._children.values():
            child.kill()
            child.wait()
        stored = _keys(engine)
        expected, waiting, lost = self._expected(stored)
        found = table_hash(engine)
        return StormAccount(
            planned=plan.edges * plan.results_per_edge,
            made=expected.row_count,
            stored=found.row_count,
            waiting=waiting,
            lost=lost,
            is_equal=found == expected,
            kills=dict(self._kills),
            drained_s=drained_s,
        )

    def _expected(self, stored: set[Key]) -> tuple[TableHash, int, int]:
        """Return what a database holds that got every result once and in order; how many wait, how many are lost."""
        engine = open_database(f"sqlite:///{self._folder / 'expected.sqlite'}")
        migrate(engine)
        writer = Writer(engine)
        waiting_count, absent_count = 0, 0
        for name in self._names("edge"):
            with closing(ResultStore.open(self._store(name))) as store:
                results = list(store.results(name))
                waiting = {row.key.seq for row in store.waiting(name, after=0, before=_ANY, limit=_ANY)}
            writer.store(Batch(shifts=[shift_row(shift_record(result)) for result in results]))
            absent = {result.seq for result in results if (name, result.stream, result.seq) not in stored}
            waiting_count += len(absent & waiting)
            absent_count += len(absent)
        found = table_hash(engine)
        engine.dispose()
        return found, waiting_count, absent_count - waiting_count

    def _start(self, name: str) -> None:
        with self._log(name).open("ab") as log:
            self._children[name] = subprocess.Popen([sys.executable, "-m", *self._command(name)], stderr=log)

    def _command(self, name: str) -> Iterator[str]:
        plan = self._plan
        if name in self._names("worker"):
            yield from ("fleet_backend", "ingest", "--broker", self._broker.url, "--database", self._database)
            return
        yield from ("studies.fleet_edge", "--store", str(self._store(name)), "--vehicle", name)
        yield from ("--broker", str(self._broker.port), "--results", str(plan.results_per_edge))
        yield from ("--rate", str(plan.rate_per_s), "--like", str(self._like))

    def _names(self, part: str) -> Sequence[str]:
        return [f"{part}{number}" for number in range(WORKERS if part == "worker" else self._plan.edges)]

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def _store(self, name: str) -> Path:
        return self._folder / f"{name}.sqlite"

    def _end(self) -> None:
        for child in self._children.values():
            child.kill()
            child.wait()
        self._broker.stop()


def _keys(engine: Engine) -> set[Key]:
    with transaction(engine) as connection:
        columns = (SHIFT_RESULT.c.vehicle, SHIFT_RESULT.c.stream, SHIFT_RESULT.c.seq)
        return {(row.vehicle, row.stream, row.seq) for row in connection.execute(select(*columns))}


def told(title: str, account: StormAccount) -> str:
    kills = ", ".join(f"{part} {count}" for part, count in account.kills.items())
    drained = (
        "NOT EMPTY IN TIME" if account.drained_s is None else f"empty {account.drained_s:.1f} s after the last kill"
    )
    same = "equal" if account.is_equal else "NOT EQUAL"
    return (
        f"{title}: {account.made} of {account.planned} made, {account.stored} stored,"
        f" {account.waiting} waiting, {account.lost} lost;"
        f" table {same} to a clean run; outboxes {drained}; killed: {kills}"
    )


def is_met(account: StormAccount) -> bool:
    """Return whether everything planned is in the database, once, and every outbox is empty in time."""
    return account.is_equal and account.stored == account.planned and account.drained_s is not None


def main() -> int:
    parser = study_parser(__doc__, is_parallel=False)
    parser.add_argument("--results", type=int, default=StormPlan().results_per_edge, help="per vehicle")
    parser.add_argument("--seconds", type=float, default=StormPlan().storm_s, help="of the storm")
    parser.add_argument(
        "--calm", type=float, default=StormPlan().calm_s, help="seconds in which outboxes must be empty"
    )
    parser.add_argument("--disk", type=BrokerDisk, choices=list(BrokerDisk), help="only this one")
    parser.add_argument("--broker", choices=["mosquitto", "nats"], default="mosquitto")
    options = parsed(parser, results=500, seconds=20.0, disk=BrokerDisk.DELETED)
    plan = StormPlan(results_per_edge=options.results, storm_s=options.seconds, calm_s=options.calm)
    is_nats = options.broker == "nats"
    if is_nats:
        options.disk = BrokerDisk.SAVED
    disks = list(BrokerDisk) if options.disk is None else [options.disk]
    is_good = True
    with closing(PostgresServer()) as server:
        server.start()
        for disk in disks:
            with TemporaryDirectory() as folder:
                account = Storm(
                    Path(folder), server.create(disk.value), replace(plan, disk=disk, is_nats=is_nats)
                ).run()
            print(told("JetStream" if is_nats else f"broker's disk {disk.value}", account), flush=True)
            is_good = is_good and is_met(account)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
