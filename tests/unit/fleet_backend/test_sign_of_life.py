"""A worker's sign of life: only while it listens and its database answers."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from fleet_backend.application import give_signs, prepare
from fleet_backend.choices import Pace
from fleet_backend.database import open_database
from fleet_backend.errors import ConfigError
from fleet_backend.ingest import Inbox, Worker
from fleet_backend.writer import Writer
from tests.support.fleet import NOW

PERIOD_S = 0.01


@asynccontextmanager
async def nowhere() -> AsyncIterator[Inbox]:
    raise AssertionError
    yield


def is_touched(path: Path) -> bool:
    return path.stat().st_mtime > 0.0


async def signs(path: Path, url: str, *, is_listening: bool, patience_s: float) -> bool:
    """Return whether the file is touched within some time."""
    engine = open_database(url)
    worker = Worker(nowhere, Writer(engine), name="w", now=lambda: NOW, pace=Pace())
    worker.is_listening = is_listening
    prepare(path)
    task = asyncio.create_task(give_signs(path, worker, engine, PERIOD_S))
    waited_s = 0.0
    while not is_touched(path) and waited_s < patience_s:
        await asyncio.sleep(PERIOD_S)
        waited_s += PERIOD_S
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task
    engine.dispose()
    return is_touched(path)


async def test_without_its_broker_it_gives_none(tmp_path: Path, sqlite_url: str) -> None:
    assert not await signs(tmp_path / "alive", sqlite_url, is_listening=False, patience_s=0.2)


async def test_without_its_database_it_gives_none(tmp_path: Path) -> None:
    nobody = "postgresql://nobody@127.0.0.1:1/none"
    assert not await signs(tmp_path / "alive", nobody, is_listening=True, patience_s=0.2)


def test_a_file_that_cannot_be_made_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot touch"):
        prepare(tmp_path / "nowhere" / "alive")
