"""The outbox and a real Mosquitto: absent, killed, silent, refusing."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import pytest
from jsonschema import Draft202012Validator

from clutch_results.records import ServiceStatus, clutch_record, shift_record
from diag_service.delivery import DeliveryLimits, MqttConnector, Outbox
from diag_service.diagnosis.summary import order_by
from diag_service.store import ResultStore
from fleet_contract import schema
from fleet_link import BrokerAddress
from tests.plugins.broker import Mosquitto
from tests.support.outboxes import NOW, STATUS, put, sending, until
from tests.support.patience import HANG_S
from tests.support.subscriber import Subscriber

pytestmark = pytest.mark.broker

QUICK = DeliveryLimits(first_pause_s=0.05, longest_pause_s=0.2)


@pytest.fixture(name="store")
def _store() -> Iterator[ResultStore]:
    with closing(ResultStore.in_memory()) as store:
        yield store


def seqs(subscriber: Subscriber) -> list[int]:
    return [int(payload["seq"]) for payload in subscriber.payloads("/shift")]


def outbox_for(store: ResultStore, address: BrokerAddress, status: ServiceStatus | None = STATUS) -> Outbox:
    connector = MqttConnector(address, "clutchdiag-car1", status)
    return Outbox(store, "car1", lambda: connector.connect(NOW), str(address), limits=QUICK)


def local(port: int, username: str | None = None, password: str | None = None) -> BrokerAddress:
    return BrokerAddress(host="127.0.0.1", port=port, username=username, password=password)


async def test_subscribers_get_what_the_schemas_describe(store: ResultStore, broker: Mosquitto) -> None:
    put(store, range(1, 4))
    with Subscriber(broker.port) as subscriber:
        outbox = outbox_for(store, local(broker.port))
        async with sending(outbox) as sender:
            assert await outbox.close(sender) == 0
        subscriber.wait(lambda heard: len(heard.payloads("/status")) == 2)
        assert subscriber.payloads("/shift") == [shift_record(result) for result in store.results("car1")]
        for name in ("shift", "clutch", "status"):
            topic = f"/{name}" if name != "clutch" else "/clutch/1"
            for payload in subscriber.payloads(topic):
                Draft202012Validator(schema(name)).validate(payload)
        assert [payload["status"] for payload in subscriber.payloads("/status")] == ["online", "offline"]
        assert subscriber.retained() == {}  # we were there before


async def test_state_is_retained_and_events_are_not(store: ResultStore, broker: Mosquitto) -> None:
    put(store, range(1, 5))
    outbox = outbox_for(store, local(broker.port))
    async with sending(outbox) as sender:
        await until(lambda: store.unpublished_count("car1") == 0)
        with Subscriber(broker.port) as late:
            late.wait(lambda heard: len(heard.retained()) == 3)
            kept = late.retained()
        await outbox.close(sender)
    latest = {result.verdict.clutch: result for result in store.results("car1")}
    assert kept.pop("clutchdiag/v1/car1/status")["status"] == "online"
    order = order_by(latest.values(), None)
    assert kept == {
        f"clutchdiag/v1/car1/clutch/{clutch}": clutch_record(shift_record(latest[clutch]), order) for clutch in (1, 2)
    }


@pytest.mark.parametrize("end", [Mosquitto.kill, Mosquitto.stop])
async def test_a_broker_that_dies_in_between_loses_and_doubles_nothing(
    store: ResultStore, broker: Mosquitto, end: Callable[[Mosquitto], None]
) -> None:
    with Subscriber(broker.port) as subscriber:
        outbox = outbox_for(store, local(broker.port))
        async with sending(outbox) as sender:
            for first in (1, 21, 41):
                put(store, range(first, first + 20))
                outbox.wake()
                await until(lambda: store.unpublished_count("car1") < 20)
                await asyncio.to_thread(end, broker)
                await asyncio.to_thread(broker.start)
            assert await outbox.close(sender, timeout_s=HANG_S) == 0
        await asyncio.to_thread(subscriber.wait, lambda heard: set(seqs(heard)) == set(range(1, 61)))


async def test_a_silent_broker_delays_the_end_for_a_limited_time(store: ResultStore, broker: Mosquitto) -> None:
    outbox = outbox_for(store, local(broker.port))
    async with sending(outbox) as sender:
        put(store, [1])
        outbox.wake()
        await until(lambda: store.unpublished_count("car1") == 0)
        broker.freeze()
        put(store, range(2, 4))
        outbox.wake()
        async with asyncio.timeout(HANG_S):
            assert await outbox.close(sender, timeout_s=0.3) == 2
    broker.thaw()


async def test_a_successor_replaces_a_service_that_vanished(store: ResultStore, broker: Mosquitto) -> None:
    """The old session's last will must not overwrite the new one's status."""
    connector = MqttConnector(local(broker.port), "clutchdiag-car1", STATUS)
    heir = MqttConnector(local(broker.port), "clutchdiag-car1", replace(STATUS, service_version="0.2.0"))
    with Subscriber(broker.port) as subscriber:
        async with connector.connect(NOW) as vanished, heir.connect(NOW):
            await vanished.lost()
            subscriber.wait(lambda heard: len(heard.payloads("/status")) == 3)
            told = [(payload["status"], payload["service_version"]) for payload in subscriber.payloads("/status")]
    assert told == [("online", "0.1.0"), ("offline", "0.1.0"), ("online", "0.2.0")]
