"""Disks that are full or sealed, as real file systems: one clear line, and nothing that was reported is lost.

They run with the tests on vcan, where mounting is allowed: in User-Mode Linux everyone is root.
"""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from tests.plugins.disk import Mount
from tests.support.in_process import ended

pytestmark = pytest.mark.vcan

STORE_BYTES = 172_000  # a store with the results of two shifts or so, its write-ahead log included


def stored(store: Path) -> list[object]:
    with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True)) as connection:
        return [json.loads(text) for (text,) in connection.execute("SELECT json FROM result ORDER BY position")]


def test_a_store_on_a_disk_that_fills_up(mount: Mount, drive_log: Path) -> None:
    store = mount(f"size={STORE_BYTES}") / "car.sqlite"
    run = ended("analyze", drive_log, "--json", "--store", store)
    run.assert_one_line(4, f"cannot use store {store}: database or disk is full")
    assert 0 < len(run.records) < 3
    assert run.records == stored(store)[: len(run.records)]
