"""kill -9 of a live service at any moment, and a restart on its store: nothing reported is lost, nothing is repeated.

The bus plays a recorded drive and, after each restart, goes on behind the last shift that was stored. So the drive that
was interrupted again and again must end with the same numbers and the same running state, to the bit, as the one that
was not.
"""

import json
import signal
import sqlite3
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.plugins.broker import Mosquitto
from tests.support.in_process import ended
from tests.support.service import Ended, Record, Service, service
from tests.support.subscriber import Subscriber

SHIFT_COUNT = 10
BEHIND_NS = 150_000_000  # after the end of a shift: its own signals are complete, those of the next have not begun
OF_THE_RUN = ("stream", "number", "produced_at", "verdict")

pytestmark = [pytest.mark.slow, pytest.mark.broker]


@dataclass(frozen=True, slots=True)
class Kill:
    """When a run is killed."""

    name: str
    moment: Callable[[Service], bool]
    delay_s: float = 0.0


def has_printed(count: int) -> Callable[[Service], bool]:
    return lambda running: running.out.count("\n") >= count


def is_online(subscriber: Subscriber) -> Callable[[Service], bool]:
    return lambda running: has_printed(1)(running) and statuses_of(subscriber)[-1:] == ["online"]


def kills(subscriber: Subscriber) -> tuple[Kill, ...]:
    return (
        Kill("while it starts", lambda running: running.process.poll() is None, 0.5),
        Kill("as soon as it listens", lambda running: "listening" in running.err),
        Kill("while the broker hears of a shift", has_printed(1), 0.01),
        Kill("some shifts later", is_online(subscriber), 0.8),
    )


def statuses_of(subscriber: Subscriber) -> list[str]:
    return [str(payload["status"]) for payload in subscriber.payloads("/status")]


def stored(store: Path) -> list[Record]:
    """Return the results in a store, in the order in which they were stored."""
    if not store.exists():
        return []
    with closing(sqlite3.connect(store)) as connection:
        if not connection.execute("SELECT count(*) FROM sqlite_master WHERE name = 'result'").fetchone()[0]:
            return []
        rows = connection.execute("SELECT json FROM result ORDER BY position").fetchall()
    return [json.loads(text) for (text,) in rows]


def running_states(store: Path) -> list[tuple[str, str]]:
    with closing(sqlite3.connect(store)) as connection:
        return connection.execute("SELECT belief, condition FROM state").fetchall()


def key(record: Record) -> tuple[str, int]:
    return str(record["stream"]), int(record["seq"])


def run(folder: Path, log: Path, store: Path, broker: Mosquitto, end: Callable[[Service], None]) -> Ended:
    """Run the service behind the last stored shift, end it somehow, and return what it said."""
    results = stored(store)
    start_ns = int(results[-1]["end_bus_ns"]) + BEHIND_NS if results else 0
    program = (sys.executable, "-m", "tests.support.fast_bus", str(log), str(start_ns))
    arguments = ("run", "--store", store, "--json", "--vehicle", "car1", "--broker", broker.url)
    with service(folder, *arguments, program=program) as running:
        end(running)
        return running.wait()


def stop_after_the_drive(store: Path) -> Callable[[Service], None]:
    def end(running: Service) -> None:
        running.wait_for(lambda: len(stored(store)) == SHIFT_COUNT)
        running.send(signal.SIGTERM)

    return end


def killed(kill: Kill, store: Path) -> Callable[[Service], None]:
    def end(running: Service) -> None:
        running.wait_for(lambda: kill.moment(running) or len(stored(store)) == SHIFT_COUNT)
        time.sleep(kill.delay_s)
        running.send(signal.SIGKILL)

    return end


def test_kill_9_at_several_moments_of_a_drive(cycle_log: Path, tmp_path: Path, broker: Mosquitto) -> None:
    whole_store, store = tmp_path / "whole.sqlite", tmp_path / "car.sqlite"
    whole = ended("analyze", cycle_log, "--json", "--vehicle", "car1", "--store", whole_store)
    assert whole.status == 0, whole.err
    with Subscriber(broker.port) as subscriber:
        runs = [run(tmp_path / kill.name, cycle_log, store, broker, killed(kill, store)) for kill in kills(subscriber)]
        runs.append(run(tmp_path / "last", cycle_log, store, broker, stop_after_the_drive(store)))
        results = stored(store)
        subscriber.wait(lambda heard: {key(one) for one in heard.payloads("/shift")} >= set(map(key, results)))
        heard = subscriber.payloads("/shift")
        subscriber.wait(lambda heard: statuses_of(heard)[-1] == "offline")
        statuses = statuses_of(subscriber)

    assert [one.status for one in runs] == [-signal.SIGKILL] * (len(runs) - 1) + [0]
    assert [one.err.count("error") + one.err.count("warning") for one in runs] == [0] * len(runs)
    # Each that came also went, which the broker says for those that are killed: at least one, and the last.
    assert statuses == ["online", "offline"] * (len(statuses) // 2)
    assert len(statuses) >= 4
    # Everything that anyone was told is in the store as it was told, and was told by one run only.
    by_key = {key(result): result for result in results}
    printed = [record for one in runs for record in one.records if record["schema"] == "clutchdiag/shift/v1"]
    assert len({key(record) for record in printed}) == len(printed)
    assert all(by_key[key(record)] == record for record in printed)
    assert all(by_key[key(record)] == record for record in heard)
    # One stream, no hole in its numbers, and all of it reached the broker.
    assert len({result["stream"] for result in results}) == 1
    assert [result["seq"] for result in results] == list(range(1, SHIFT_COUNT + 1))
    assert runs[-1].summary["shifts"]["unpublished"] == 0
    # And the numbers are those of a drive that nobody interrupted.
    assert [without_run(result) for result in results] == [without_run(record) for record in whole.shifts]
    assert [result["verdict"] for result in results] == [record["verdict"] for record in whole.shifts]
    assert running_states(store) == running_states(whole_store)


def without_run(record: Record) -> Record:
    return {name: value for name, value in record.items() if name not in OF_THE_RUN}
