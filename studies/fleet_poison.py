"""Poison: 10,000 messages that nobody can use among 1,000 good ones, through one worker into a real PostgreSQL.

python -m studies.fleet_poison
"""

import argparse
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
from sqlalchemy import Engine, func, select

from studies.fleet_ingest import BROKER_LINES, wait_until_listening
from studies.fleet_load import Load, wire
from demo.fleet.servers import PostgresServer, mosquitto
from diag_service.diagnosis.records import shift_record
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import migrate
from fleet_backend.queries import result_count
from fleet_backend.schema import QUARANTINE
from fleet_contract import Channel, Outgoing, shift_message, topic_of
from tests.support.fleet import fleet_result
from tests.support.poison import poison_messages, readable_count

LIMIT_S = 120.0
MIB = 2**20


def quarantine_count(engine: Engine) -> int:
    with transaction(engine) as connection:
        return int(connection.execute(select(func.count()).select_from(QUARANTINE)).scalar_one())


def measure(poison_count: int, good_count: int) -> bool:
    """Send good among poison and say when all of each was where it belongs; return whether it was.

    The backend settles a message with the broker when it is put away, whatever it is; what names a result gets a
    receipt besides.
    """
    poison = [wire(topic, payload) for topic, payload in poison_messages(poison_count)]
    good = [wire(m.topic, m.payload) for m in map(_message, range(1, good_count + 1))]
    share = len(poison) // len(good)
    mixed = [part for place, one in enumerate(good) for part in (*poison[place * share : (place + 1) * share], one)]
    mixed += poison[len(good) * share :]
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
        command = ["fleet_backend", "ingest", "--broker", f"mqtt://127.0.0.1:{port}", "--database", database]
        command += ["--quotas", "0,0,0"]
        child = subprocess.Popen([sys.executable, "-m", *command], stderr=subprocess.PIPE, text=True)
        stack.callback(child.communicate)
        stack.callback(child.terminate)
        wait_until_listening(child)
        before = psutil.Process(child.pid).memory_info().rss
        load = Load(port, "load", [topic_of(vehicle, Channel.ACK) for vehicle in ("car1", "car9")])
        stack.callback(load.close)
        began_s, good_s = time.perf_counter(), LIMIT_S
        load.pour(mixed)
        while (taken_s := time.perf_counter() - began_s) < LIMIT_S:
            if good_s == LIMIT_S and result_count(engine) == good_count:
                good_s = taken_s
            is_told = load.acknowledged_count >= good_count + readable_count(poison_count)
            if quarantine_count(engine) == poison_count and good_s < LIMIT_S and is_told:
                break
            time.sleep(0.05)
        grown = (psutil.Process(child.pid).memory_info().rss - before) / MIB
        print(
            f"{result_count(engine):,} of {good_count:,} good results stored after {good_s:.1f} s (limit 30),"
            f" {quarantine_count(engine):,} of {poison_count:,} poison messages kept aside after {taken_s:.1f} s,"
            f" {load.acknowledged_count:,} receipts of {good_count + readable_count(poison_count):,},"
            f" worker grown by {grown:.0f} MiB"
        )
    return good_s < 30.0 and taken_s < LIMIT_S


def _message(seq: int) -> Outgoing:
    return shift_message(shift_record(fleet_result(seq)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poison", type=int, default=10_000)
    parser.add_argument("--good", type=int, default=1000)
    options = parser.parse_args()
    return 0 if measure(options.poison, options.good) else 1


if __name__ == "__main__":
    sys.exit(main())
