"""Workers with a part of the fleet and a database each: every result is in one of them, by whichever broker it came."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import AsyncExitStack, ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import select

from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_backend.choices import Part
from fleet_backend.config import parse_part
from fleet_backend.database import open_database, transaction
from fleet_backend.errors import ConfigError
from fleet_backend.migrate import migrate
from fleet_backend.schema import SHIFT_RESULT
from fleet_contract import Address, Channel
from fleet_link import parse_broker
from tests.plugins.broker import Mosquitto
from tests.support.fleet_worker import worker
from tests.support.nats import NatsServer
from tests.support.outboxes import NOW, put, sending, until

PARTS = 4
VEHICLES = [f"car{number}" for number in range(1, 13)]
SHIFTS = 6
QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)


def part_of(vehicle: str) -> int:
    """Return the number of the part that takes a vehicle; there is one."""
    topic = Address(vehicle=vehicle, channel=Channel.SHIFT).topic
    (number,) = (number for number in range(1, PARTS + 1) if Part(number=number, count=PARTS).takes(topic))
    return number


@contextmanager
def nats_server(folder: Path) -> Iterator[tuple[str, int]]:
    server = NatsServer(folder)
    server.start()
    try:
        yield server.url, server.port
    finally:
        server.stop()


async def deliver(port: int) -> None:
    """Deliver results of all vehicles, as any vehicle does, and wait for all receipts."""
    async with AsyncExitStack() as stack:
        stores = {name: stack.enter_context(closing(ResultStore.in_memory())) for name in VEHICLES}
        for name, store in stores.items():
            put(store, range(1, SHIFTS + 1), vehicle=name)
            address = parse_broker(f"mqtt://127.0.0.1:{port}")
            connect = partial(MqttConnector(address, f"clutchdiag-{name}", is_persistent=True).connect, NOW)
            outbox = Outbox(store, name, connect, str(address), acknowledge=Acknowledge.BACKEND, limits=QUICK)
            await stack.enter_async_context(sending(outbox))
        await until(lambda: not any(store.unpublished_count(name) for name, store in stores.items()))


def stored(url: str) -> dict[str, int]:
    """Return how many results of each vehicle a database has."""
    engine, found = open_database(url), defaultdict[str, int](int)
    with transaction(engine) as connection:
        for vehicle in connection.execute(select(SHIFT_RESULT.c.vehicle)).scalars():
            found[vehicle] += 1
    engine.dispose()
    return found


@pytest.mark.broker
@pytest.mark.parametrize("kind", ["mosquitto", "nats"])
async def test_four_workers_take_a_part_each(tmp_path: Path, kind: str, broker: Mosquitto) -> None:
    urls = {number: f"sqlite:///{tmp_path}/part-{number}.sqlite" for number in range(1, PARTS + 1)}
    with ExitStack() as stack:
        url, port = broker.url, broker.port
        if kind == "nats":
            url, port = stack.enter_context(nats_server(tmp_path))
        for number, database in urls.items():
            engine = open_database(database)
            migrate(engine)
            engine.dispose()
            stack.enter_context(worker(tmp_path, url, database, "--part", f"{number}/{PARTS}"))
        await deliver(port)
    assert {part_of(name) for name in VEHICLES} == set(urls)  # each has some
    for number, database in urls.items():
        assert stored(database) == {name: SHIFTS for name in VEHICLES if part_of(name) == number}


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "1/0", "a/b", "-1/4", ""])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="K/N"):
        parse_part(text)


def test_a_vehicle_stays_in_its_part() -> None:
    assert [part_of(name) for name in VEHICLES] == [1, 3, 1, 4, 2, 4, 2, 1, 3, 3, 1, 3]  # whatever the release
    assert Part().takes("clutchdiag/v1/anything/shift")
    assert (Part().group("ingest"), Part(number=2, count=4).group("ingest")) == ("ingest", "ingest-2-of-4")
