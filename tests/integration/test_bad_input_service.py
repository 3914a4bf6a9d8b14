"""What users and their machines do wrong, at the service as a process: one clear line and the right exit status."""

import signal
import time
from pathlib import Path

import pytest

from tests.plugins.broker import Mosquitto
from tests.plugins.drives import SHIFT_COUNT
from tests.support.in_process import ended as run
from tests.support.service import service
from tests.support.subscriber import Subscriber


@pytest.mark.broker
def test_a_broker_that_refuses_gets_its_results_once_it_lets_us_in(drive_log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    broker = Mosquitto(folder, users={"backend": "heard", "car1": "driven"})
    broker.start()
    arguments = ("analyze", drive_log, "--json", "--vehicle", "car1", "--store", tmp_path / "car.sqlite", "--broker")
    try:
        refused = run(*arguments, broker.url.replace("//", "//car1:wrong@"))
        assert (refused.status, refused.err.count("\n")) == (0, 1)
        assert refused.err.startswith(f"diag-service: warning: broker 127.0.0.1:{broker.port}: connection refused: ")
        assert "wrong" not in refused.err
        assert len(refused.shifts) == SHIFT_COUNT
        assert refused.summary["shifts"]["unpublished"] == SHIFT_COUNT
        with Subscriber(broker.port, "backend", "heard") as backend:
            trusted = run(*arguments, broker.url.replace("//", "//car1:driven@"))
            backend.wait(lambda heard: len(heard.payloads("car1/shift")) == SHIFT_COUNT)
            assert backend.payloads("car1/shift") == refused.shifts
    finally:
        broker.stop()
    assert (trusted.status, trusted.summary["shifts"]["unpublished"]) == (0, 0)


def test_an_analysis_stopped_at_any_moment_ends_well_and_is_taken_up(cycle_log: Path, tmp_path: Path) -> None:
    arguments = ("analyze", cycle_log, "--json", "--store", tmp_path / "car.sqlite")
    stopped, statuses = [], []
    for number, delay_s in ((signal.SIGINT, 0.0), (signal.SIGTERM, 0.8)):
        with service(tmp_path / f"{delay_s}", *arguments) as running:
            running.wait_until_it_catches(signal.SIGUSR1)  # the last to get a handler
            time.sleep(delay_s)
            running.send(number)
            ended = running.wait()
            stopped.append(ended)
            statuses.append(0 if ended.summary["complete"] else 128 + number)
    whole = run(*arguments)
    assert [ended.status for ended in (*stopped, whole)] == [*statuses, 0]
    assert statuses[0] == 130
    assert all(ended.err.count("\n") == (not ended.summary["complete"]) for ended in (*stopped, whole))
    for ended in stopped:
        assert ended.shifts == whole.shifts[: len(ended.shifts)]
        assert ended.summary["schema"] == "clutchdiag/summary/v1"
    assert len(stopped[0].shifts) < len(whole.shifts) == 10
