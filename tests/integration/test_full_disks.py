"""Real file systems that fill up under the vehicle's store and the backend's database: nobody dies, nothing is lost.

They run with the tests on vcan, where mounting is allowed: in User-Mode Linux everyone is root.
"""

import signal
import sqlite3
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Engine

from clutch_results.records import shift_record
from diag_service.store.file import WAITING
from fleet_backend import queries
from fleet_backend.choices import TrendAxis
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_contract import Outgoing, shift_message
from tests.integration.test_service_live import counts_say
from tests.plugins.broker import Mosquitto
from tests.plugins.disk import Mount, fill_up
from tests.support.fleet import fleet_result
from tests.support.fleet_worker import worker
from tests.support.patience import HANG_S
from tests.support.resending_edge import ResendingEdge
from tests.support.service import service

pytestmark = [pytest.mark.vcan, pytest.mark.broker]

SHIFT_COUNT = 10  # of the drive
MESSAGE_COUNT = 150


def test_a_vehicle_whose_disk_fills_up_goes_on_and_delivers_everything(
    mount: Mount, cycle_log: Path, tmp_path: Path, broker: Mosquitto, sqlite_url: str
) -> None:
    disk = mount("size=2m")  # for what SQLite writes before it tidies up, too
    program = (sys.executable, "-m", "tests.support.fast_bus", str(cycle_log), "0")
    arguments = ("run", "--store", disk / "car.sqlite", "--json", "--vehicle", "car1", "--acknowledge", "backend")
    with (
        worker(tmp_path, broker.url, sqlite_url),
        service(tmp_path / "edge", *arguments, "--broker", broker.url, program=program) as running,
    ):
        running.wait_for(lambda: running.out.count("\n") >= 1, HANG_S)
        filler = fill_up(disk)
        running.wait_for(lambda: "disk is full; results wait in memory" in running.err, HANG_S)
        told = running.out.count("\n")
        running.wait_for(lambda: counts_say(running, frames_of(cycle_log)), HANG_S)  # the drive is over
        assert running.out.count("\n") == told  # nobody is told what is not stored
        filler.unlink()
        running.wait_for(lambda: running.out.count("\n") == SHIFT_COUNT, HANG_S)
        engine = open_database(sqlite_url)
        running.wait_for(lambda: queries.result_count(engine) == SHIFT_COUNT, HANG_S)
        running.wait_for(lambda: waiting_count(disk / "car.sqlite") == 0, HANG_S)  # receipts follow, some a second time
        running.send(signal.SIGTERM)
        ended = running.wait()
    assert ended.status == 0, ended.err
    assert [shift["seq"] for shift in ended.shifts] == list(range(1, SHIFT_COUNT + 1))
    assert ended.summary["shifts"]["unpublished"] == 0
    assert "the disk takes results again; 0 were given up" in ended.err


def test_a_backend_whose_disk_fills_up_waits_and_stores_everything(
    mount: Mount, tmp_path: Path, broker: Mosquitto
) -> None:
    disk = mount("size=2m")
    database = f"sqlite:///{disk / 'fleet.sqlite'}"
    engine = open_database(database)
    migrate(engine)
    sent = messages(MESSAGE_COUNT)
    with worker(tmp_path, broker.url, database) as pid, ResendingEdge(broker.port) as edge:
        edge.keep(sent[:20])
        edge.deliver(HANG_S)
        filler = fill_up(disk)
        edge.keep(sent)
        edge.send_once()
        wait_for_line(tmp_path / "worker-0.log", "trying again")
        assert edge.waiting_count > 0
        assert Path(f"/proc/{pid}").exists()
        filler.unlink()
        edge.deliver(HANG_S)
    assert stored_seqs(engine) == list(range(1, MESSAGE_COUNT + 1))
    engine.dispose()


def waiting_count(store: Path) -> int:
    """Return how many results of a store that its service has open wait for a receipt."""
    with closing(sqlite3.connect(f"{store.as_uri()}?mode=ro", uri=True)) as connection:
        return int(connection.execute("SELECT count(*) FROM result WHERE published = ?", (WAITING,)).fetchone()[0])


def frames_of(log: Path) -> str:
    """Return what a service says that has heard all of a log."""
    count = log.read_bytes().count(b"\n")
    return f"{count} frames, {count} decoded"


def messages(count: int) -> list[Outgoing]:
    return [shift_message(shift_record(fleet_result(seq))) for seq in range(1, count + 1)]


def wait_for_line(log: Path, text: str, timeout_s: float = HANG_S) -> None:
    deadline_s = time.monotonic() + timeout_s
    while text not in log.read_text(encoding="utf-8"):
        assert time.monotonic() < deadline_s, log.read_text(encoding="utf-8")
        time.sleep(0.05)


def stored_seqs(engine: Engine) -> list[int]:
    return [int(str(row["seq"])) for row in queries.trend(engine, "car1", 2, TrendAxis.SHIFT)]
