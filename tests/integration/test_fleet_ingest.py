"""Workers between a real Mosquitto and a real database: killed, paused, poisoned, and nothing lost or doubled."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import paho.mqtt.client as mqtt
import psutil
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from sqlalchemy import Engine, select

from clutch_model.calibration import nominal_calibration
from clutch_results.records import shift_record
from demo.fleet.servers import PostgresServer
from fleet_backend import queries
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.schema import CALIBRATION
from fleet_backend.writer import Batch, Writer
from fleet_contract import Outgoing, shift_message
from tests.plugins.broker import Mosquitto
from tests.plugins.drives import SHIFT_COUNT
from tests.support.fleet import fleet_result, row_of
from tests.support.fleet_worker import Step, worker, worker_here
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.poison import poison_messages
from tests.support.resending_edge import ResendingEdge
from tests.support.subscriber import Subscriber

pytestmark = pytest.mark.broker


def messages(count: int, *, vehicle: str = "car1", algorithm: str = "algorithm-1") -> list[Outgoing]:
    """Return the messages of a vehicle's first shifts."""
    return [
        shift_message(shift_record(fleet_result(seq, vehicle=vehicle, clutch=1 + seq % 2, algorithm=algorithm)))
        for seq in range(1, count + 1)
    ]


def clean_hash(tmp_path: Path, sent: Sequence[Outgoing]) -> queries.TableHash:
    """Return the hash of a database that got each result once, in order."""
    engine = open_database(f"sqlite:///{tmp_path / 'clean.sqlite'}")
    migrate(engine)
    keys = [json.loads(message.payload)["data"] for message in sent]
    rows = [
        row_of(fleet_result(d["seq"], vehicle=d["vehicle"], clutch=d["clutch"], algorithm=d["algorithm_version"]))
        for d in keys
    ]
    Writer(engine).store(Batch(shifts=rows))
    found = queries.table_hash(engine)
    engine.dispose()
    return found


@contextmanager
def paused(pid: int) -> Iterator[None]:
    """Stop a server and all of its processes for as long as the block lasts, as a frozen host would."""
    processes = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    for process in processes:
        process.suspend()
    try:
        yield
    finally:
        for process in processes:
            process.resume()


def test_tripled_shuffled_and_a_day_late_is_the_same_table(
    tmp_path: Path, broker: Mosquitto, postgres_url: str, postgres_engine: Engine
) -> None:
    sent = messages(50) + messages(50, algorithm="algorithm-2")
    late = sent * 3
    np.random.default_rng(7).shuffle(late)  # nothing in a row tells when it arrived, so late is like now
    with worker(tmp_path, broker.url, postgres_url), ResendingEdge(broker.port) as edge:
        for first in range(0, len(late), 60):
            edge.keep(late[first : first + 60])
            edge.deliver()
    assert queries.table_hash(postgres_engine) == clean_hash(tmp_path, sent)


def test_a_worker_killed_at_any_step_loses_and_doubles_nothing(
    tmp_path: Path, broker: Mosquitto, sqlite_url: str
) -> None:
    """One worker after the other, each dead at another step with more to store than the last."""
    sent, begun = messages(60 * len(Step)), 0
    with ResendingEdge(broker.port) as edge:
        with worker(tmp_path, broker.url, sqlite_url, module="tests.support.fleet_worker") as dying:
            deadline_s = time.monotonic() + HANG_S
            while not _is_dead(dying):
                assert time.monotonic() < deadline_s
                before, begun = begun, (tmp_path / "worker-0.log").read_text(encoding="utf-8").count("listening")
                edge.keep(sent[60 * before : 60 * begun])
                edge.send_once()
                time.sleep(0.3)
        assert begun == len(Step)
        assert edge.waiting_count > 0
        with worker(tmp_path, broker.url, sqlite_url):
            edge.deliver()
    engine = open_database(sqlite_url)
    assert queries.table_hash(engine) == clean_hash(tmp_path, sent)
    engine.dispose()


def test_a_database_that_is_paused_costs_time_and_bounded_memory(
    tmp_path: Path, broker: Mosquitto, postgres_server: PostgresServer, postgres_url: str, postgres_engine: Engine
) -> None:
    sent = messages(200)
    with worker(tmp_path, broker.url, postgres_url, "--batch", "50") as pid, ResendingEdge(broker.port) as edge:
        edge.keep(sent[:100])
        edge.deliver()
        before = psutil.Process(pid).memory_info().rss
        with paused(postgres_server.pid):
            edge.keep(sent)
            with pytest.raises(AssertionError, match="without a receipt"):
                edge.deliver(timeout_s=3.0)
            grown = psutil.Process(pid).memory_info().rss - before
        edge.deliver()
    assert edge.sent_count > len(sent)  # more was on its way than the worker takes
    assert grown < 16 * 2**20
    assert queries.table_hash(postgres_engine) == clean_hash(tmp_path, sent)


def test_poison_is_kept_aside_and_does_not_delay_the_good(
    tmp_path: Path, broker: Mosquitto, postgres_url: str, postgres_engine: Engine
) -> None:
    sent, poison = messages(50), poison_messages(240)
    with worker_here(broker.url, postgres_url), ResendingEdge(broker.port) as edge:
        client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="attacker", protocol=mqtt.MQTTv5)
        client.connect("127.0.0.1", broker.port)
        client.loop_start()
        infos = [client.publish(topic, payload, qos=1) for topic, payload in poison]
        edge.keep(sent)
        edge.deliver()
        for info in infos:
            info.wait_for_publish(HANG_S)
        client.disconnect()
        client.loop_stop()
        _wait_until(lambda: len(queries.quarantined(postgres_engine, 5000)) == len(set(poison)))
    reasons = {str(record["reason"]) for record in queries.quarantined(postgres_engine, 5000)}
    assert reasons == {"malformed", "schema", "identity", "topic"}
    assert queries.table_hash(postgres_engine) == clean_hash(tmp_path, sent)
    assert [alarm["vehicle"] for alarm in queries.identity_alarms(postgres_engine)] == ["car9"]


def _is_dead(pid: int) -> bool:
    return not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def _wait_until(is_done: Callable[[], bool], timeout_s: float = HANG_S) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not is_done():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def test_results_of_logs_tell_their_calibration_and_nothing_of_a_connection(
    drive_log: Path, broker: Mosquitto, postgres_engine: Engine
) -> None:
    at = datetime(2026, 1, 5, tzinfo=UTC)
    live = {"service_version": "1", "algorithm_version": "a", "calibration_version": "live"}
    Writer(postgres_engine).store(Batch(statuses=[{"vehicle": "car1", "is_online": True, "connected_at": at, **live}]))
    with worker_here(broker.url, postgres_engine.url.render_as_string(hide_password=False)):
        for name in ("car1", "car2"):
            assert ended("analyze", drive_log, "--json", "--vehicle", name, "--broker", broker.url).status == 0
        told = select(CALIBRATION.c.vehicle, CALIBRATION.c.content)
        deadline_s = time.monotonic() + HANG_S
        found: dict[str, str] = {}
        while len(found) < 2 or queries.result_count(postgres_engine) < 2 * SHIFT_COUNT:
            assert time.monotonic() < deadline_s
            with postgres_engine.connect() as connection:
                found = {str(vehicle): str(content) for vehicle, content in connection.execute(told)}
    assert {json.loads(content)["vehicle_type"] for content in found.values()} == {nominal_calibration().name}
    seen = {str(row["vehicle"]): row for row in queries.last_seen(postgres_engine)}
    assert (bool(seen["car1"]["is_online"]), seen["car1"]["service_version"]) == (True, "1")
    assert (seen["car2"]["is_online"], seen["car2"]["connected_at"]) == (None, None)
    with Subscriber(broker.port) as late:
        late.wait(lambda heard: bool(heard.payloads("car2/clutch/1")))
        assert not late.payloads("car2/status")
