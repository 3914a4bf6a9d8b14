"""``diag-service run`` as a process on a bus of UDP datagrams: signals, and every frame accounted for."""

import signal
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.replay import INTERFACE, Replay, UdpBus, free_bus
from tests.support.service import Record, Service, service

SECOND_SHIFT_OPEN_S = 4.2


@pytest.fixture(name="bus")
def _bus() -> UdpBus:
    return free_bus()


@pytest.fixture(name="replay")
def _replay(drive_log: Path, bus: UdpBus) -> Iterator[Replay]:
    replay = Replay(bus, drive_log.read_bytes().splitlines())
    yield replay
    replay.close()


def stored_keys(store: Path) -> list[tuple[str, int]]:
    with closing(sqlite3.connect(store)) as connection:
        return connection.execute("SELECT stream, seq FROM result ORDER BY position").fetchall()


def key(record: Record) -> tuple[str, int]:
    return str(record["stream"]), int(record["seq"])


def counts_say(running: Service, text: str) -> bool:
    """Ask the service for its counts; True once they say ``text``."""
    running.send(signal.SIGUSR1)
    time.sleep(0.05)
    return f"diag-service: {text}" in running.err


@pytest.mark.parametrize(("number", "delay_s"), [(signal.SIGINT, 0.0), (signal.SIGTERM, 0.4)])
def test_a_signal_while_starting_ends_it_cleanly(
    tmp_path: Path, bus: UdpBus, number: signal.Signals, delay_s: float
) -> None:
    with service(tmp_path, "run", "-i", INTERFACE, "-c", bus.group, "--store", tmp_path / "car.sqlite") as running:
        running.wait_until_it_catches(signal.SIGUSR1)  # the last to get a handler; Python itself has one for SIGINT
        time.sleep(delay_s)
        running.send(number)
        ended = running.wait()
    assert (ended.status, ended.err) == (0, "")


def test_stopping_reports_the_open_shift_and_every_frame(tmp_path: Path, bus: UdpBus, replay: Replay) -> None:
    store = tmp_path / "car.sqlite"
    with service(
        tmp_path, "run", "-i", INTERFACE, "-c", bus.group, "--store", store, "--json", variables=bus.variables
    ) as running:
        running.wait_for(lambda: f"listening on {INTERFACE} {bus.group}" in running.err)
        sent = replay.send_until(SECOND_SHIFT_OPEN_S)
        running.wait_for(lambda: running.out.count("\n") >= 1)
        running.wait_for(lambda: counts_say(running, f"{sent} frames, {sent} decoded"))
        running.send(signal.SIGTERM)
        ended = running.wait()
    assert ended.status == 0
    frames = ended.summary["frames"]
    assert frames["on_bus"] == sent
    assert sent == frames["decoded"] + frames["ignored"] + sum(frames["rejected"].values()) + frames["queue_dropped"]
    finished, cut = ended.shifts
    assert (finished["from_gear"], finished["to_gear"]) == (1, 2)
    assert (cut["status"], cut["reasons"]) == ("rejected", ["interrupted"])
    assert stored_keys(store) == [key(finished), key(cut)]
