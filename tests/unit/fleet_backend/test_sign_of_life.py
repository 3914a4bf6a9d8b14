"""A worker's sign of life: only while it listens and its database answers."""

import asyncio
from pathlib import Path

import pytest

from fleet_backend.application import give_signs, prepare
from fleet_backend.choices import Pace
from fleet_backend.database import open_database
from fleet_backend.ingest import Worker
from fleet_backend.writer import Writer
from tests.support.fleet import NOW
from tests.unit.fleet_backend.test_ingest import Records

PERIOD_S = 0.01
NOBODY = "postgresql://nobody@127.0.0.1:1/none"


@pytest.mark.parametrize(("is_listening", "has_database"), [(False, True), (True, False)])
async def test_without_its_broker_or_its_database_it_gives_none(
    tmp_path: Path, sqlite_url: str, *, is_listening: bool, has_database: bool
) -> None:
    path, engine = tmp_path / "alive", open_database(sqlite_url if has_database else NOBODY)
    worker = Worker(Records().connect, Writer(engine), name="w", now=lambda: NOW, pace=Pace())
    worker.is_listening = is_listening
    prepare(path)
    task = asyncio.create_task(give_signs(path, worker, engine, PERIOD_S))
    await asyncio.sleep(20 * PERIOD_S)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    engine.dispose()
    assert path.stat().st_mtime == 0.0
