"""A part of a drive is no drive: what was stopped, and what broke off, says so and carries no verdict."""

import fcntl
import gzip
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.plugins.broker import Mosquitto
from tests.support.in_process import ended as run
from tests.support.patience import HANG_S
from tests.support.service import PROGRAM, Ended, environment
from tests.support.subscriber import Subscriber

PIPE_BYTES = 4096
LEFT_BYTES = 300  # room for the head and a line or two: then whoever writes waits


@contextmanager
def narrow_pipe() -> Iterator[tuple[int, int]]:
    """Return both ends of a pipe that is all but full, so that a program that writes to it waits for us."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    os.write(writing, b"." * (PIPE_BYTES - LEFT_BYTES))
    try:
        yield reading, writing
    finally:
        os.close(reading)


def stopped(number: signal.Signals, *arguments: str | Path) -> Ended:
    """Run the service and send it a signal after its first line, before it can have written its last."""
    with narrow_pipe() as (reading, writing):
        process = subprocess.Popen(
            [*PROGRAM, *map(str, arguments)], stdout=writing, stderr=subprocess.PIPE, env=environment()
        )
        os.close(writing)
        os.read(reading, PIPE_BYTES - LEFT_BYTES)
        out = os.read(reading, 1)  # it has begun
        process.send_signal(number)
        wait_until_delivered(process.pid, number)
        while piece := os.read(reading, 1 << 16):
            out += piece
        assert process.stderr is not None
        err = process.stderr.read().decode()
        process.stderr.close()
        return Ended(status=process.wait(HANG_S), out=out.decode(), err=err)


def wait_until_delivered(pid: int, number: signal.Signals) -> None:
    """Return when a process has taken a signal."""
    while True:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
        pending = int(next(line for line in text.splitlines() if line.startswith("ShdPnd:")).split()[1], 16)
        if not pending >> (number - 1) & 1:
            return


@pytest.fixture(scope="module")
def cut_log(cycle_log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive whose last line is cut."""
    path = tmp_path_factory.mktemp("cut") / "cut.log"
    path.write_bytes(cycle_log.read_bytes()[:-10])
    return path


def test_an_analysis_that_was_stopped_carries_no_verdict(cycle_log: Path) -> None:
    ended = stopped(signal.SIGTERM, "analyze", cycle_log, "--json")
    assert ended.status == 143, ended.err
    assert "stopped early" in ended.err
    assert (ended.summary["complete"], ended.summary["incomplete"]) == (False, ["stopped_early"])
    assert 0 < len(ended.shifts) < 10
    for clutch in ended.summary["clutches"]:
        assert clutch["condition"] == "no_verdict"
        assert clutch["reason"].startswith("stopped early")
        assert clutch["friction"] is not None


@pytest.mark.parametrize("how", ["cut", "gzip"])
def test_a_log_that_broke_off_carries_no_verdict(cycle_log: Path, cut_log: Path, tmp_path: Path, how: str) -> None:
    log = cut_log
    if how == "gzip":
        log = tmp_path / "cut.log.gz"
        packed = gzip.compress(cycle_log.read_bytes(), 1)
        log.write_bytes(packed[: len(packed) * 9 // 10])
    ended = run("analyze", log, "--json")
    assert ended.status == 5
    assert f"{log}: the log is cut off" in ended.err
    assert "Traceback" not in ended.err
    assert set(ended.summary["frames"]["unreadable"]) == {"cut_off"}
    assert (ended.summary["complete"], ended.summary["incomplete"]) == (False, ["log_cut"])
    assert [clutch["condition"] for clutch in ended.summary["clutches"]] == ["no_verdict"] * 2
    assert any(shift["friction"] for shift in ended.shifts)
    text = run("analyze", log)
    assert text.status == 5
    said, table = text.out.split("condition", 1)
    assert "a log is cut off" in said
    assert "only a part of the drive was seen" in said
    assert "good" not in table


def test_a_folder_run_that_was_stopped_goes_on_later(cycle_log: Path, drive_log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    lines = drive_log.read_bytes().splitlines(keepends=True)
    for number in range(4):
        (folder / f"{number}.log").write_bytes(b"".join(lines[number:]))
    arguments = ("analyze", folder, "-o", tmp_path / "out.jsonl", "--jobs", "1", "--json")
    ended = stopped(signal.SIGINT, *arguments)
    assert ended.status == 130, ended.err
    assert "run the same command again" in ended.err
    assert not (tmp_path / "out.jsonl").exists()
    again = run(*arguments)
    assert again.status == 0, again.err
    assert "drives were done before" in again.err
    records = [json.loads(line) for line in (tmp_path / "out.jsonl").read_text(encoding="utf-8").splitlines()]
    assert sum(record["schema"] == "clutchdiag/drive/v1" for record in records) == 4


@pytest.mark.broker
def test_no_clutch_state_is_published_of_a_part(
    cut_log: Path, drive_log: Path, tmp_path: Path, broker: Mosquitto
) -> None:
    with Subscriber(broker.port) as subscriber:
        run("analyze", cut_log, "--vehicle", "cut", "--broker", broker.url)
        run("analyze", drive_log, "--vehicle", "whole", "--broker", broker.url)
        subscriber.wait(lambda heard: bool(heard.payloads("whole/clutch/1") and heard.payloads("whole/clutch/2")))
        assert len(subscriber.payloads("cut/shift")) == 10
        assert not subscriber.payloads("cut/clutch/1")
