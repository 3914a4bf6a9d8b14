"""``run --poll``: the trouble codes of the controller beside the results, in the store, as JSON, at the broker."""

import json
import os
import signal
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from tests.integration.test_tester import SLIPS, vehicle
from tests.plugins.broker import Mosquitto
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.subscriber import Subscriber
from tests.support.uds.wire import parked_controller
from workshop.controller.memory import TestResult as Result

POLL = ("--poll", "1", "--active", "--json")


@contextmanager
def stopping_when(condition: Callable[[], bool]) -> Iterator[None]:
    """Ask this process to stop, as a person at the keyboard would, once a condition holds."""

    def watch() -> None:
        deadline_s = time.monotonic() + HANG_S
        while not condition() and time.monotonic() < deadline_s:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=watch)
    thread.start()
    yield
    thread.join()


def test_codes_are_read_stored_told_and_published(tmp_path: Path, broker: Mosquitto) -> None:
    controller = parked_controller()
    for _ in range(20):
        controller.report(SLIPS, Result.FAILED)
    store = tmp_path / "car.sqlite"
    words = ("-i", "virtual", "-c", "poll", "--vehicle", "car1", "--store", store, "--broker", broker.url)
    with (
        vehicle("poll", controller),
        Subscriber(broker.port) as subscriber,
        stopping_when(lambda: bool(subscriber.payloads("/controller"))),
    ):
        run = ended("run", *words, *POLL)
        said = subscriber.payloads("/controller")[0]
    assert run.status == 0, run.err
    (told,) = [record for record in run.records if record["schema"] == "clutchdiag/controller/v1"]
    assert [code["code"] for code in told["codes"]] == ["P0811"]
    assert told["codes"][0]["snapshots"][0]["data"]["fluid temperature"] == {"temperature [degC]": 80}
    assert said["codes"] == told["codes"]
    with closing(sqlite3.connect(store)) as connection:
        assert [json.loads(text) for (text,) in connection.execute("SELECT json FROM controller")] == [told]
