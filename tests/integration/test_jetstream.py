"""Results from JetStream: kept on disk until they are settled, whoever vanishes; receipts reach the vehicle by MQTT."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import nats
import pytest

from clutch_results.records import shift_record
from demo.fleet.brokers import NatsServer
from fleet_backend.ingest import FILTERS, connected
from fleet_contract import Receipt, ack_messages, key_of, shift_message
from fleet_link import Connection, LinkDownError, Terms, VersionRefusedError, parse_broker
from tests.support.certificates import certify, tls_files
from tests.support.fleet import fleet_result
from tests.support.fleet_broker import DEPLOY, write_access
from tests.support.patience import HANG_S

pytestmark = pytest.mark.broker
RECORD = shift_record(fleet_result())
KEY = key_of(RECORD)


@pytest.fixture(name="server")
def _server(tmp_path: Path) -> Iterator[NatsServer]:
    server = NatsServer(tmp_path)
    server.start()
    yield server
    server.stop()


async def publish(server: NatsServer) -> Connection:
    """Return a vehicle's connection after it has sent one result, and listens for receipts."""
    address = parse_broker(f"mqtt://127.0.0.1:{server.port}")
    vehicle = await Connection.open(address, Terms(is_version_5=False, identifier="car1"))
    await vehicle.subscribe(["clutchdiag/v1/car1/ack"])
    await vehicle.publish_all([shift_message(RECORD)])
    return vehicle


def test_a_result_waits_on_disk_until_it_is_settled_and_its_receipt_reaches_the_vehicle(server: NatsServer) -> None:
    address = parse_broker(server.url, may_be_nats=True)

    async def run() -> None:
        async with connected(address, FILTERS, max_unsettled=20):
            vehicle = await publish(server)  # the stream is there from now on
            await vehicle.close()
        server.kill()  # with a message that nobody has settled
        server.start()
        vehicle = await publish(server)
        async with connected(address, FILTERS, max_unsettled=20) as inbox, asyncio.timeout(HANG_S):
            messages = [*await inbox.collect(1, 0.0), *await inbox.collect(1, 0.0)]
            assert [message.payload for message in messages] == [shift_message(RECORD).payload] * 2
            sent_at = "2026-01-01T00:00:00.000000Z"
            inbox.send(list(ack_messages("car1", [Receipt(key=KEY)], sent_at=sent_at, worker="w")))
            inbox.acknowledge(messages)
            told = asyncio.ensure_future(vehicle.collect(1, 0.0))
            waiting = asyncio.ensure_future(inbox.collect(1, 0.0))  # says what was to be sent
            (receipt,) = await told
            assert b'"outcome":"accepted"' in receipt.payload
            await vehicle.publish_all([shift_message(RECORD)])
            assert len(await waiting) == 1  # the new one alone: what was settled does not come again
            await vehicle.close()

    asyncio.run(run())


async def test_version_5_is_refused_and_with_it_the_properties_of_messages(server: NatsServer) -> None:
    address = parse_broker(f"mqtt://127.0.0.1:{server.port}")
    with pytest.raises(VersionRefusedError, match=r"\[code:132\] Unsupported protocol version"):
        await Connection.open(address, Terms(timeout_s=HANG_S))
    vehicle = await Connection.open(address, Terms(is_version_5=False))
    await vehicle.close()


async def test_headers_are_bounded_as_properties_are(server: NatsServer) -> None:
    address = parse_broker(server.url, may_be_nats=True)
    async with connected(address, FILTERS, max_unsettled=20) as inbox, asyncio.timeout(HANG_S):
        sender = await nats.connect(server.url)
        for header_bytes in (10, 2_000):
            await sender.publish("clutchdiag.v1.car1.shift", b"payload", headers={"h": "x" * (header_bytes - 1)})
            await sender.flush()
        await sender.close()
        arrived = [*await inbox.collect(1, 0.0), *await inbox.collect(1, 0.0)]
    assert [(message.unread_bytes, message.excess) for message in arrived] == [
        (10, None),
        (2_000, "2000 bytes of properties, more than 1024"),
    ]


def test_a_cancellation_that_meets_a_message_ends_the_wait(server: NatsServer) -> None:
    """nats-py and Python 3.11 lose some; which turn of the loop it is depends on both, so each is tried."""

    async def deliver() -> None:
        await (await publish(server)).close()

    async def run() -> int:
        cancelled_count = 0
        async with connected(parse_broker(server.url, may_be_nats=True), FILTERS, max_unsettled=20) as inbox:
            for turns in range(20):
                waiting = asyncio.create_task(inbox.collect(1, 0.0))
                while (await asyncio.wait([waiting], timeout=0.1))[0]:  # what the turn before has left
                    waiting = asyncio.create_task(inbox.collect(1, 0.0))
                thread = Thread(target=asyncio.run, args=(deliver(),))
                thread.start()
                thread.join()  # the loop stands still, and the message is there as it goes on
                for _ in range(turns):
                    await asyncio.sleep(0)
                if waiting.cancel():
                    await asyncio.wait([waiting])
                    assert waiting.cancelled(), turns
                    cancelled_count += 1
        return cancelled_count

    assert asyncio.run(run()) > 3


def test_who_has_a_certificate_and_no_entry_is_refused(tmp_path: Path) -> None:
    folder = certify(tmp_path / "certificates", "broker", "CAR1")
    write_access(folder)
    certify(folder, "CAR2")
    text = (folder / "nats.conf").read_text(encoding="utf-8")
    server = NatsServer(tmp_path, text.replace("/etc/clutchdiag", str(folder)))
    server.start()

    async def vehicle(name: str) -> None:
        address = parse_broker(f"mqtts://127.0.0.1:{server.port}", tls_files(folder, name))
        await (await Connection.open(address, Terms(is_version_5=False, identifier=name))).close()

    try:
        asyncio.run(vehicle("CAR1"))
        with pytest.raises(LinkDownError, match="Not authorized"):
            asyncio.run(vehicle("CAR2"))
    finally:
        server.stop()


def test_the_configuration_of_the_containers_is_one(tmp_path: Path) -> None:
    text = (DEPLOY / "nats-local.conf").read_text(encoding="utf-8")
    for theirs, ours in (
        ("127.0.0.1:4222", "0.0.0.0:4222"),
        ("127.0.0.1:1884", "0.0.0.0:8883"),
        ("/data", "/var/lib/nats"),
    ):
        assert theirs in text
        text = text.replace(theirs, ours)
    server = NatsServer(tmp_path, text.replace("http: 127.0.0.1:8222\n", ""))
    server.start()
    server.stop()
