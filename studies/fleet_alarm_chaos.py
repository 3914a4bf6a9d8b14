"""Alarms while everything is killed by SIGKILL, again and again: watch, page, PostgreSQL, the receiver.

Vehicles get good and bad results in turn. In the end every alarm that the database knows must have arrived, and the
receiver, which keeps what it took in a file, must know each key; what came twice has the same key and content. What the
page said it had acknowledged must be stored, and stand in the audit once.

    python -m studies.fleet_alarm_chaos --seconds 60
"""

import argparse
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from sqlalchemy import Engine, Select, select

from studies.acknowledging import Workshop, broken_promises, write_access
from demo.fleet.servers import PostgresServer
from diag_service.diagnosis.records import Condition
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import DatabaseAwayError
from fleet_backend.migrate import migrate
from fleet_backend.office_tables import ALARM, ALARM_MESSAGE
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import fleet_result, row_of
from tests.support.ports import free_port

VEHICLES = 50
CALM_S = 120.0  # the most that is waited after the last kill
PAUSES_S = {"watch": 12.0, "page": 7.0, "database": 17.0, "receiver": 5.0}

_WAITING = select(ALARM_MESSAGE.c.key).where(ALARM_MESSAGE.c.delivered_at.is_(None))
Answer = TypeVar("Answer")


class Receiver(BaseHTTPRequestHandler):
    """Writes what it takes into a file before it says so; of a key that it knows it takes no second."""

    book = Path()

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"])).decode()
        key = json.loads(body)["message"].rpartition("\n")[2]
        with self.book.open("ab") as book:
            book.write(json.dumps({"key": key, "body": body}).encode() + b"\n")
            book.flush()
            os.fsync(book.fileno())
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def receive(port: int, book: Path) -> None:
    """Receive for ever."""
    Receiver.book = book
    HTTPServer(("127.0.0.1", port), Receiver).serve_forever()


class Storm:
    """What runs and is killed."""

    def __init__(self, folder: Path, server: PostgresServer, database: str) -> None:
        self.book = folder / "book.jsonl"
        self.book.touch()
        port, page_port = free_port(), free_port()
        receiver = folder / "receiver.url"
        receiver.write_text(f"json://127.0.0.1:{port}", encoding="utf-8")
        receiver.chmod(0o600)
        access = write_access(folder)
        self.address = f"http://127.0.0.1:{page_port}"
        self._server = server
        self._commands = {
            "watch": ["fleet_backend", "watch", "--database", database, "--notify", str(receiver)],
            "receiver": ["studies.fleet_alarm_chaos", "--receive", str(port), "--book", str(self.book)],
            "page": ["fleet_backend", "serve", "--database", database, "--access", str(access)],
        }
        self._commands["page"] += ["--listen", f"127.0.0.1:{page_port}"]
        self._commands["watch"] += ["--silence-days", "3650"]
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self.kills: Counter[str] = Counter()
        for name in self._commands:
            self.start(name)

    def start(self, name: str) -> None:
        command = [sys.executable, "-m", *self._commands[name]]
        self._running[name] = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def kill(self, name: str) -> None:
        """Kill one of them and start it again."""
        self.kills[name] += 1
        if name == "database":
            self._server.kill()
            self._server.start()
            return
        self._running[name].kill()
        self._running[name].wait()
        self.start(name)

    def one_round(self) -> None:
        """Hold the fleet against the rules once and deliver; what a killed watch had taken is free after a minute."""
        self._running["watch"].kill()
        self._running["watch"].wait()
        subprocess.run(
            [sys.executable, "-m", *self._commands["watch"], "--once"], check=True, stderr=subprocess.DEVNULL
        )

    def end(self) -> None:
        for process in self._running.values():
            process.send_signal(signal.SIGKILL)
            process.wait()


def again(work: Callable[[], Answer]) -> Answer:
    """Do something until the database answers, and return what it did."""
    while True:
        try:
            return work()
        except DatabaseAwayError:
            time.sleep(0.1)


def rows_of(engine: Engine, statement: Select[Any]) -> Sequence[Any]:
    with transaction(engine) as connection:
        return connection.execute(statement).all()


def main() -> int:
    """Print what became of the alarms; return 0 if none was lost."""
    parser = argparse.ArgumentParser(description="Alarms while everything is killed.")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--receive", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--book", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.receive:
        receive(options.receive, options.book)
    server = PostgresServer()
    with closing(server), TemporaryDirectory() as folder:
        server.start()
        database = server.create("fleet")
        engine = open_database(database)
        migrate(engine)
        storm = Storm(Path(folder), server, database)
        workshop = Workshop(storm.address)
        writer, rng = Writer(engine), random.Random(1)  # noqa: S311 - no secret
        due_s = {name: time.monotonic() + pause_s for name, pause_s in PAUSES_S.items()}
        end_s = time.monotonic() + options.seconds
        for seq in itertools.count(1):
            condition = Condition.CHANGE_FLUID if seq % 2 else Condition.GOOD
            rows = [row_of(fleet_result(seq, vehicle=f"v{n}", condition=condition)) for n in range(VEHICLES)]
            again(lambda rows=rows: writer.store(Batch(shifts=rng.sample(rows, VEHICLES // 2))))  # type: ignore[misc]
            for name, at_s in due_s.items():
                if time.monotonic() >= at_s:
                    storm.kill(name)
                    due_s[name] = time.monotonic() + PAUSES_S[name] * rng.uniform(0.5, 1.5)
            if time.monotonic() >= end_s:
                break
            time.sleep(1.0)
        calm_s = time.monotonic()
        storm.one_round()  # a whole one: what was not judged is
        while again(lambda: rows_of(engine, _WAITING)) and time.monotonic() - calm_s < CALM_S:
            storm.one_round()
        took_s = time.monotonic() - calm_s
        workshop.end()
        storm.end()
        taken = [json.loads(line) for line in storm.book.read_text(encoding="utf-8").splitlines()]
        alarms = again(lambda: rows_of(engine, select(ALARM)))
        broken = again(lambda: broken_promises(engine, workshop.confirmed))
        engine.dispose()
    wanted = {f"{one.vehicle}/{one.clutch}/{one.rule}/{one.number}/raised" for one in alarms}
    wanted |= {
        f"{one.vehicle}/{one.clutch}/{one.rule}/{one.number}/cleared" for one in alarms if one.cleared_at is not None
    }
    keys = Counter(one["key"] for one in taken)
    contents = {(one["key"], one["body"]) for one in taken}
    lost, strange = wanted - set(keys), set(keys) - wanted
    print(f"killed: {', '.join(f'{name} {count} times' for name, count in sorted(storm.kills.items()))}")
    print(f"{len(alarms)} alarms, {len(wanted)} messages; calm {took_s:.0f} s after the last kill")
    repeated = len(taken) - len(keys)
    print(f"arrived: {len(keys)} keys, {repeated} once more under their key; lost {len(lost)}, strange {len(strange)}")
    print(f"page: {len(workshop.confirmed)} alarms acknowledged, {workshop.unanswered} requests without an answer")
    print("\n".join(broken) or "page: what it confirmed is stored, and stands in the audit once")
    return 0 if not broken and not lost and not strange and len(contents) == len(keys) else 1


if __name__ == "__main__":
    sys.exit(main())
