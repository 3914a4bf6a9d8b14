"""Bundles from a vehicle to the database and back as receipts, by both brokers."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine, func, select

from clutch_results.records import shift_record
from demo.fleet.brokers import NatsServer
from diag_service.delivery import Acknowledge, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend.choices import Pace
from fleet_backend.database import transaction
from fleet_backend.ingest import FILTERS, Worker, connected
from fleet_backend.schema import QUARANTINE, SHIFT_RESULT
from fleet_backend.writer import Writer
from fleet_contract import Outcome, bundle_messages, read_message, receipts_of, shift_message, takes_bundles
from fleet_link import BrokerAddress, Connection, Terms, parse_broker
from tests.plugins.broker import Mosquitto
from tests.support.fleet import fleet_result
from tests.support.outboxes import NOW, put, sending, until
from tests.support.patience import HANG_S

pytestmark = pytest.mark.broker


@pytest.fixture(name="server", params=[Mosquitto, NatsServer])
def _server(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Mosquitto | NatsServer]:
    server: Mosquitto | NatsServer = request.param(tmp_path)
    server.start()
    yield server
    server.stop()


@asynccontextmanager
async def working(server: Mosquitto | NatsServer, engine: Engine) -> AsyncIterator[None]:
    """Run an ingest worker until the block ends."""
    address, pace = parse_broker(server.url, may_be_nats=True), Pace()
    worker = Worker(
        lambda: connected(address, FILTERS, max_unsettled=pace.max_unsettled),
        Writer(engine),
        name="w",
        now=lambda: datetime.now(UTC),
        pace=pace,
    )
    task = asyncio.create_task(worker.run())
    try:
        await until(lambda: worker.is_listening)
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_one_bad_result_of_a_bundle_is_put_aside_and_the_others_are_stored(
    server: Mosquitto | NatsServer, sqlite_engine: Engine
) -> None:
    messages = [shift_message(shift_record(fleet_result(seq))) for seq in (1, 2, 3)]
    messages[1] = replace(messages[1], payload=messages[1].payload.replace(b'"quality":0.9', b'"quality":9.0'))
    (bundle,) = bundle_messages(messages)
    address = parse_broker(f"mqtt://127.0.0.1:{server.port}")
    async with working(server, sqlite_engine), asyncio.timeout(HANG_S):
        vehicle = await Connection.open(address, Terms(is_version_5=False, identifier="car1"))
        await vehicle.subscribe(["clutchdiag/v1/car1/ack"])
        await vehicle.publish_all([bundle])
        (told,) = await vehicle.collect(1, 0.0)
        await vehicle.close()
    ack = read_message(told.topic, told.payload).data
    outcomes = [(receipt.key.seq, receipt.outcome) for receipt in receipts_of(ack)]
    assert outcomes == [(1, Outcome.ACCEPTED), (2, Outcome.QUARANTINED), (3, Outcome.ACCEPTED)]
    assert takes_bundles(ack)
    with transaction(sqlite_engine) as connection:
        assert connection.execute(select(SHIFT_RESULT.c.seq)).scalars().all() == [1, 3]
        (kept,) = connection.execute(select(QUARANTINE.c.topic, QUARANTINE.c.head)).all()
    assert kept.topic == "clutchdiag/v1/car1/shift"
    assert kept.head.startswith('{"specversion":"1.0","id":"car1/stream-1/2/')


async def test_a_vehicle_learns_that_it_may_and_after_its_restart_sends_bundles(
    server: Mosquitto | NatsServer, sqlite_engine: Engine, tmp_path: Path
) -> None:
    address = BrokerAddress(host="127.0.0.1", port=server.port)
    connector = MqttConnector(address, "clutchdiag-car1", is_persistent=True)

    async def deliver(seqs: range) -> None:
        with closing(ResultStore.open(tmp_path / "car1.sqlite")) as store:
            put(store, seqs)
            outbox = Outbox(
                store, "car1", lambda: connector.connect(NOW), str(address), acknowledge=Acknowledge.BACKEND
            )
            async with sending(outbox):
                await until(lambda: not store.unpublished_count("car1"))
            assert store.takes_bundles()

    async with working(server, sqlite_engine), asyncio.timeout(HANG_S):
        await deliver(range(1, 2))
        watcher = await Connection.open(
            parse_broker(f"mqtt://{address}"), Terms(is_version_5=False, identifier="other")
        )
        await watcher.subscribe(["clutchdiag/v1/car1/bundle", "clutchdiag/v1/car1/shift"])
        await deliver(range(2, 122))
        seen = [message.topic.rpartition("/")[2] for message in await watcher.collect(10, 0.1)]
        await watcher.close()
    assert seen == ["bundle"] * 3
    with transaction(sqlite_engine) as connection:
        assert connection.execute(select(func.count()).select_from(SHIFT_RESULT)).scalar_one() == 121
