"""``fleet-backend follow``: what vehicles find is told as it arrives, also after the broker was away."""

import json
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import Queue
from threading import Thread

from paho.mqtt import publish

from clutch_results.records import shift_record
from fleet_contract import Outgoing, bundle_messages, shift_message, status_message
from tests.plugins.broker import Mosquitto
from tests.support.fleet import fleet_result
from tests.support.patience import HANG_S

Next = Callable[[], str]
TIME = "2026-01-01T00:00:00.000000Z"


@contextmanager
def follower(*words: str, **variables: str) -> Iterator[tuple[subprocess.Popen[str], Next]]:
    """Start the command; what it says comes line by line, complaints with it."""
    lines: Queue[str] = Queue()
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "fleet_backend", "follow", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | variables,
    ) as process:
        said = process.stdout
        assert said is not None
        reader = Thread(target=lambda: deque(map(lines.put, map(str.rstrip, said)), maxlen=0))
        reader.start()
        try:
            yield process, lambda: lines.get(timeout=HANG_S)
        finally:
            process.kill()
            reader.join()


def say(broker: Mosquitto, *messages: Outgoing) -> None:
    for message in messages:
        publish.single(message.topic, message.payload, 1, message.is_retained, "127.0.0.1", broker.port)


def result(seq: int, vehicle: str = "car1") -> Outgoing:
    return shift_message(shift_record(fleet_result(seq, vehicle=vehicle)))


def presence(vehicle: str) -> Outgoing:
    """Return what says that a vehicle is watched; retained, so a follower that has subscribed hears it."""
    return status_message({
        "schema": "clutchdiag/status/v1", "vehicle": vehicle, "status": "online", "connected_at": TIME,
        "service_version": "1", "algorithm_version": "1", "calibration_version": "1",
    })  # fmt: skip


def test_results_are_told_as_they_arrive_alone_and_in_bundles(broker: Mosquitto) -> None:
    say(broker, presence("car1"))
    with follower(broker.url) as (process, heard):
        assert heard() == f"{TIME} car1: online"
        say(broker, result(1), Outgoing(topic="clutchdiag/v1/car1/shift", payload=b"{}", is_retained=False))
        line = heard()
        assert " car1: clutch 2, shift 1-2: mu_C 0.1361 ± 0.00" in line
        assert "left out: " in heard()
        say(broker, *bundle_messages([result(2), result(3)]))
        assert [" car1: clutch " in heard() for _ in range(2)] == [True, True]
        process.send_signal(signal.SIGINT)
        assert heard().endswith("WARNING: 1 message(s) left out: schema")
        assert process.wait(HANG_S) == 0


def test_some_vehicles_as_json_and_a_broker_that_comes_back(broker: Mosquitto) -> None:
    say(broker, presence("car2"))
    with follower("-", "car2", "--json", CLUTCHDIAG_BROKER=broker.url) as (process, heard):
        assert json.loads(heard())["status"] == "online"
        say(broker, result(1, "car1"), result(1, "car2"))
        told = json.loads(heard())
        assert (told["vehicle"], told["seq"], told["schema"]) == ("car2", 1, "clutchdiag/shift/v1")
        broker.kill()
        assert "trying again" in heard()
        broker.start()
        while "trying again" in (line := heard()):  # until the broker keeps its word that car2 is online
            pass
        assert json.loads(line)["status"] == "online"
        process.terminate()
        assert process.wait(HANG_S) == 0
