"""Disks that are full or sealed, as real file systems: one clear line, and nothing that was reported is lost.

They run with the tests on vcan, where mounting is allowed: in User-Mode Linux everyone is root.
"""

import json
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from tests.plugins.disk import Mount
from tests.service import environment, run_service

pytestmark = pytest.mark.vcan

STORE_BYTES = 120_000  # a store with the results of two shifts or so, its write-ahead log included
LOG_BYTES = 300_000  # the first seconds of a drive


def stored(store: Path) -> list[object]:
    with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
        return [json.loads(text) for (text,) in connection.execute("SELECT json FROM result ORDER BY position")]


def emulate(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "ecu_emulator", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, env=environment())


def test_a_store_on_a_disk_that_fills_up(mount: Mount, drive_log: Path, tmp_path: Path) -> None:
    store = mount(f"size={STORE_BYTES}") / "car.sqlite"
    ended = run_service(tmp_path, "analyze", drive_log, "--json", "--store", store)
    ended.assert_one_line(4, f"cannot use store {store}: database or disk is full")
    assert 0 < len(ended.records) < 3
    assert ended.records == stored(store)[: len(ended.records)]


def test_a_store_on_a_sealed_disk(mount: Mount, drive_log: Path, tmp_path: Path) -> None:
    store = mount("ro") / "car.sqlite"
    ended = run_service(tmp_path, "analyze", drive_log, "--json", "--store", store)
    ended.assert_one_line(4, "Read-only file system")
    assert ended.out == ""


def test_a_recording_on_a_disk_that_fills_up(mount: Mount) -> None:
    disk = mount(f"size={LOG_BYTES}")
    done = emulate("record", disk / "drive.log", "--json")
    assert (done.returncode, done.stdout) == (4, "")
    said = done.stderr.splitlines()[-1]
    assert said.startswith(f"ecu-emulator: error: cannot write {disk / 'drive.log'}: No space left on device")
    assert "Traceback" not in done.stderr
    assert [path.name for path in disk.iterdir()] == ["drive.log.truth.jsonl"]  # no half a log


def test_a_live_truth_on_a_full_disk_and_a_recording_on_a_sealed_one(mount: Mount) -> None:
    full, sealed = mount("size=4096"), mount("ro")
    (full / "filler").write_bytes(bytes(4096))
    for arguments, text in (
        (("run", "-i", "virtual", "-c", "disk", "--truth", full / "truth.jsonl"), "No space left on device"),
        (("record", sealed / "drive.log"), "Read-only file system"),
    ):
        done = emulate(*arguments)
        assert done.returncode == 4
        assert done.stderr.splitlines()[-1].startswith("ecu-emulator: error: cannot write ")
        assert text in done.stderr
        assert "Traceback" not in done.stderr
