"""What earlier versions left: messages on the way and stores with undelivered results reach the present backend."""

import asyncio
import sqlite3
from contextlib import AbstractAsyncContextManager, closing
from pathlib import Path

import pytest
from sqlalchemy import Engine

from diag_service.delivery import Acknowledge, Link, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend import queries
from fleet_link import BrokerAddress
from tests.golden import earlier
from tests.plugins.broker import Mosquitto
from tests.support.fleet_worker import worker
from tests.support.patience import HANG_S

GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.broker
@pytest.mark.parametrize(("name", "waiting"), [("store-v1.sql", 2), ("edge.sql", 37)])
async def test_the_store_of_an_earlier_version_drains_into_the_present_backend(
    tmp_path: Path, broker: Mosquitto, sqlite_url: str, sqlite_engine: Engine, name: str, waiting: int
) -> None:
    path = tmp_path / "edge.sqlite"
    if name == "edge.sql":
        earlier.database(name, path)
    else:
        with closing(sqlite3.connect(path)) as connection:
            connection.executescript((GOLDEN / name).read_text(encoding="utf-8"))
    connector = MqttConnector(BrokerAddress(host="127.0.0.1", port=broker.port), "clutchdiag-car1", is_persistent=True)

    def connect() -> AbstractAsyncContextManager[Link]:
        return connector.connect("2026-01-01T00:00:00.000000Z")

    with worker(tmp_path, broker.url, sqlite_url), closing(ResultStore.open(path)) as store:
        assert store.unpublished_count("car1") == waiting
        outbox = Outbox(store, "car1", connect, "the broker", acknowledge=Acknowledge.BACKEND)
        left = await outbox.close(asyncio.create_task(outbox.run()), timeout_s=HANG_S)
    assert left == 0
    assert queries.result_count(sqlite_engine) == waiting
