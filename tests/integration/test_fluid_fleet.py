"""Fluid fills between vehicle and fleet, over a real broker, also after a restart of everything."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import Engine, select

from clutch_results.records import FluidFill, iso_utc
from diag_service.delivery import DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore, withdraw_fill
from fleet_backend import queries
from fleet_backend.choices import Pace
from fleet_backend.database import transaction
from fleet_backend.ingest import FILTERS, Worker, connected
from fleet_backend.schema import FLUID_FILL
from fleet_backend.writer import Writer
from fleet_contract import metrics_message
from fleet_link import BrokerAddress
from tests.plugins.broker import Mosquitto
from tests.support.outboxes import STATUS, put, sending, until

pytestmark = pytest.mark.broker

QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.1)
OWN = FluidFill(vehicle="car1", filled_at="2026-01-01T00:00:00.000000Z", odometer_m=61_200_000.0, product="DCTF-II")
OF_THE_FLEET = datetime(2026, 2, 1, 12, tzinfo=UTC)


def utc_now() -> datetime:
    return datetime.now(UTC)


@asynccontextmanager
async def world(broker: Mosquitto, engine: Engine, path: Path) -> AsyncIterator[ResultStore]:
    """Run a backend and a vehicle until the block ends; yield the vehicle's store."""
    async with at_work(broker, engine, path) as (store, _):
        yield store


@asynccontextmanager
async def at_work(broker: Mosquitto, engine: Engine, path: Path) -> AsyncIterator[tuple[ResultStore, Outbox]]:
    """Do the same; yield the store, and what the vehicle sends by."""
    address = BrokerAddress(host="127.0.0.1", port=broker.port)
    pace = Pace()
    worker = Worker(
        lambda: connected(address, FILTERS, max_unsettled=pace.max_unsettled),
        Writer(engine),
        name="w",
        now=utc_now,
        pace=pace,
    )
    async with AsyncExitStack() as stack:
        store = stack.enter_context(closing(ResultStore.open(path)))
        connector = MqttConnector(address, "clutchdiag-car1", STATUS)
        outbox = Outbox(
            store,
            "car1",
            lambda: connector.connect(utc_now().strftime("%Y-%m-%dT%H:%M:%S.%fZ")),
            str(address),
            limits=QUICK,
        )
        ingest = asyncio.create_task(worker.run())
        await until(lambda: worker.is_listening)
        async with sending(outbox):
            yield store, outbox
        ingest.cancel()
        await asyncio.gather(ingest, return_exceptions=True)


def known_to_the_fleet(engine: Engine) -> list[tuple[datetime, str, float | None]]:
    columns = (FLUID_FILL.c.filled_at, FLUID_FILL.c.product, FLUID_FILL.c.odometer_m)
    with transaction(engine) as connection:
        return [tuple(row) for row in connection.execute(select(*columns).order_by(FLUID_FILL.c.filled_at))]


async def test_a_fill_that_is_taken_back_at_either_end_is_so_at_both(
    broker: Mosquitto, sqlite_engine: Engine, tmp_path: Path
) -> None:
    path = tmp_path / "car1.sqlite"
    async with world(broker, sqlite_engine, path) as store:
        put(store, range(1, 4))
        store.add_fills([OWN])
        await until(lambda: len(known_to_the_fleet(sqlite_engine)) == 1)
    queries.note_fill(sqlite_engine, "car1", "DCTF 75W", at=OF_THE_FLEET, odometer_m=None, note=None)
    queries.withdraw_fill(sqlite_engine, "car1", datetime(2026, 1, 1, tzinfo=UTC), by="ann")
    async with world(broker, sqlite_engine, path) as store:
        await until(lambda: [fill.product for fill in store.fills("car1")] == ["DCTF 75W"])
    withdraw_fill(path, "car1", None)
    async with world(broker, sqlite_engine, path) as store:
        await until(lambda: known_to_the_fleet(sqlite_engine) == [])
        assert store.fills("car1") == []
    async with world(broker, sqlite_engine, path) as store:  # nothing that is told brings them back
        put(store, [4])
        await until(lambda: store.unpublished_count("car1") == 0)
        assert (store.fills("car1"), known_to_the_fleet(sqlite_engine)) == ([], [])


async def test_a_vehicle_that_stays_connected_hears_what_the_fleet_notes_meanwhile(
    broker: Mosquitto, sqlite_engine: Engine, tmp_path: Path
) -> None:
    async with at_work(broker, sqlite_engine, tmp_path / "car1.sqlite") as (store, outbox):
        put(store, range(1, 4))
        outbox.wake()
        await until(lambda: store.unpublished_count("car1") == 0 and queries.result_count(sqlite_engine) == 3)
        queries.note_fill(sqlite_engine, "car1", "DCTF 75W", at=OF_THE_FLEET, odometer_m=None, note=None)
        outbox.publish_state(metrics_message("car1", iso_utc(utc_now()), {"outbox_sent_count": 3}))  # each minute
        await until(lambda: [fill.product for fill in store.fills("car1")] == ["DCTF 75W"])
