"""The outbox, a real Mosquitto and a backend: kills of each, and nothing is forgotten before the backend has it."""

import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing
from pathlib import Path

import aiomqtt
import pytest

from diag_service.delivery import Acknowledge, DeliveryLimits, MqttConnector, Outbox
from diag_service.store import ResultStore
from fleet_contract import Receipt, ack_messages
from fleet_link import BrokerAddress
from studies.fleet_properties import RawVehicle, slow_messages
from tests.plugins.broker import Mosquitto
from tests.support.acknowledger import Acknowledger
from tests.support.doomed_edge import NEW_COUNT, Step
from tests.support.outboxes import NOW, STATUS, put, sending, until
from tests.support.patience import HANG_S

pytestmark = pytest.mark.broker


QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2, resend_after_s=0.5)


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


@asynccontextmanager
async def running(store: ResultStore, broker: Mosquitto) -> AsyncIterator[Outbox]:
    address = BrokerAddress(host="127.0.0.1", port=broker.port)
    connector = MqttConnector(address, "clutchdiag-car1", STATUS, is_persistent=True)
    outbox = Outbox(
        store, "car1", lambda: connector.connect(NOW), str(address), acknowledge=Acknowledge.BACKEND, limits=QUICK
    )
    async with sending(outbox):
        yield outbox


async def test_a_broker_alone_does_not_empty_the_outbox(store: ResultStore, broker: Mosquitto) -> None:
    put(store, range(1, 4))
    async with running(store, broker) as outbox:
        await until(lambda: outbox.counts.sent >= 3)
        assert store.unpublished_count("car1") == 3
        with Acknowledger(broker.port):
            await until(lambda: store.unpublished_count("car1") == 0)


async def test_a_vehicle_ignores_acknowledgements_that_are_all_properties(
    store: ResultStore, broker: Mosquitto, caplog: pytest.LogCaptureFixture
) -> None:
    put(store, range(1, 4))
    hostile = RawVehicle(broker.port, "bad")
    ignored = "a message to this service is ignored: clutchdiag/v1/car1/ack: 250000 bytes of properties, more than 1024"
    async with running(store, broker) as outbox:
        await until(lambda: outbox.counts.sent >= 3)
        assert await asyncio.to_thread(hostile.send, slow_messages("clutchdiag/v1/car1/ack", 3)) == 3
        with Acknowledger(broker.port):
            await until(lambda: store.unpublished_count("car1") == 0)
    assert [record.getMessage() for record in caplog.records].count(ignored) == 3


async def test_the_broker_forgets_everything_and_nothing_is_lost(store: ResultStore, broker: Mosquitto) -> None:
    """Kill -9 and an empty data folder, as with Mosquitto's default persistence, after it acknowledged all."""
    put(store, range(1, 101))
    with Acknowledger(broker.port, is_acknowledging=False) as backend:
        async with running(store, broker) as outbox:
            await until(lambda: outbox.counts.sent >= 100)
            await asyncio.to_thread(broker.kill)
            broker.forget()
            backend.is_acknowledging = True
            await asyncio.to_thread(broker.start)
            await until(lambda: store.unpublished_count("car1") == 0)
    assert backend.seqs() == set(range(1, 101))


async def test_acknowledgements_wait_for_a_vehicle_that_is_away(store: ResultStore, broker: Mosquitto) -> None:
    put(store, range(1, 21))
    with Acknowledger(broker.port, is_acknowledging=False) as backend:
        async with running(store, broker):
            await until(lambda: len(backend.keys) == 20)
        backend.is_acknowledging = True  # the vehicle is in a tunnel now
        async with aiomqtt.Client("127.0.0.1", broker.port) as client:
            for ack in ack_messages("car1", [Receipt(key=key) for key in backend.keys], sent_at=NOW, worker="w"):
                await client.publish(ack.topic, ack.payload, qos=1)
        async with running(store, broker) as outbox:
            await until(lambda: store.unpublished_count("car1") == 0)
            assert outbox.counts.sent == 0


def test_kill_9_around_every_step_loses_and_doubles_nothing(tmp_path: Path, broker: Mosquitto) -> None:
    """One store, one edge after the other, each dead at another step with more to send than the last."""
    command = [sys.executable, "-m", "tests.support.doomed_edge", str(tmp_path / "car1.sqlite"), str(broker.port)]
    with Acknowledger(broker.port) as backend:
        done = subprocess.run(command, check=True, timeout=HANG_S, stdout=subprocess.PIPE)
    assert json.loads(done.stdout) == dict.fromkeys(Step, -signal.SIGKILL) | {Step.NONE: 0}
    seqs = list(range(1, NEW_COUNT * len(Step) + 1))
    assert sorted(key.seq for key in backend.keys) == seqs
    with closing(ResultStore.open(tmp_path / "car1.sqlite")) as store:
        assert [result.seq for result in store.results("car1")] == seqs
