"""A connection to a broker: its address, its keys and its bounds."""

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from fleet_contract import Outgoing
from fleet_link import (
    AddressError,
    BrokerAddress,
    Connection,
    LinkDownError,
    Terms,
    TlsFiles,
    parse_broker,
    read_secret,
)
from tests.support.certificates import certify, tls_files
from tests.support.patience import HANG_S

ACCEPTED = bytes([0x20, 3, 0, 0, 0])  # CONNACK of MQTT 5 without properties
AT_MOST_TWO = bytes([0x20, 6, 0, 0, 3, 0x21, 0, 2])  # with a Receive Maximum of 2
CONNACK, UNSUBSCRIBE, DISCONNECT = 2, 10, 14  # kinds of packets
SHORT = Terms(timeout_s=0.2, stall_s=0.2)  # where silence is waited for; what a busy machine delays is given LONG
LONG = Terms(timeout_s=HANG_S)

Script = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def packet(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """Return the kind and the content of the next packet of less than 16 KiB."""
    kind, length = await reader.readexactly(2)
    if length & 0x80:
        length = (length & 0x7F) + 128 * (await reader.readexactly(1))[0]
    return kind >> 4, await reader.readexactly(length)


@asynccontextmanager
async def broker(script: Script) -> AsyncIterator[BrokerAddress]:
    """Serve a script to whoever connects."""
    ended = asyncio.Queue[None]()
    count = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal count
        count += 1
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            await script(reader, writer)
        with suppress(ConnectionError):
            writer.close()
            await writer.wait_closed()
        ended.put_nowait(None)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        yield BrokerAddress(host="127.0.0.1", port=server.sockets[0].getsockname()[1])
        for _ in range(count):
            await asyncio.wait_for(ended.get(), HANG_S)


async def opened(address: BrokerAddress) -> Connection:
    """Return a connection that soon waits no longer; a busy machine may need more than one attempt at it."""
    async with asyncio.timeout(HANG_S):
        while True:
            with suppress(LinkDownError):
                return await Connection.open(address, SHORT)


def messages(count: int, topic: str = "t") -> list[Outgoing]:
    return [Outgoing(topic=topic, payload=b"%d" % number, is_retained=False) for number in range(count)]


async def test_nothing_more_is_taken_from_a_broker_that_reads_nothing() -> None:
    """What is sent without waiting lies in memory until it is written."""
    is_over = asyncio.Event()

    async def deaf(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(ACCEPTED)
        await is_over.wait()

    async with broker(deaf) as address:
        connection = await opened(address)
        connection.send([Outgoing(topic="t", payload=bytes(1 << 20), is_retained=False)] * 20)
        with pytest.raises(LinkDownError, match="nothing was taken"):
            await asyncio.wait_for(connection.collect(1, 0.0), HANG_S)
        is_over.set()
        await connection.close()


@pytest.mark.parametrize(
    "terms",
    [
        Terms(timeout_s=HANG_S, max_unsettled=10, keepalive_s=1),
        Terms(
            timeout_s=HANG_S, max_unsettled=60, max_unsettled_bytes=110, keepalive_s=1
        ),  # ten of eleven bytes with their topic
    ],
)
async def test_a_broker_that_sends_more_than_it_may_is_read_no_further(terms: Terms) -> None:
    """It fills its own memory, not ours; nothing is lost by it, and it hears from us all the while."""
    limit, count = 10, 200
    heard: asyncio.Queue[int] = asyncio.Queue()

    async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(ACCEPTED)
        for number in range(1, count + 1):
            writer.write(bytes([0x32, 16, 0, 1]) + b"t" + number.to_bytes(2) + bytes([0]) + bytes(10))
        while True:
            kind, _ = await packet(reader)
            heard.put_nowait(kind)

    async with broker(flood) as address:
        connection = await Connection.open(address, terms)
        found = await connection.collect(count, 0.6)
        while len(found) < limit + 1:  # a batch by bytes is half of what may be unsettled
            found += await connection.collect(count, 0.6)
        assert len(found) == limit + 1
        assert await asyncio.wait_for(heard.get(), HANG_S) == UNSUBSCRIBE  # of nothing: a ping asks for an answer
        unsettled = found.copy()
        while len(found) < count:
            connection.acknowledge(unsettled)
            unsettled = await connection.collect(count, 0.0)
            assert len(unsettled) <= limit + 1
            found += unsettled
        assert [message.packet_id for message in found] == list(range(1, count + 1))
        await connection.close()


def of_length(length: int) -> bytes:
    """Return a variable byte integer."""
    digits = bytearray()
    while length >= 128:
        digits.append(128 | length % 128)
        length //= 128
    return bytes([*digits, length])


def delivery(packet_id: int, payload: bytes, properties: bytes = b"") -> bytes:
    """Return a PUBLISH of MQTT 5 with QoS 1."""
    content = b"\0\1t" + packet_id.to_bytes(2) + of_length(len(properties)) + properties + payload
    return b"\x32" + of_length(len(content)) + content


USER_PROPERTY = bytes([38, 0, 0, 0, 0])  # without a name and a value


@pytest.mark.parametrize(
    ("user_property", "count", "payload_bytes", "kept_bytes", "excess"),
    [
        (USER_PROPERTY, 0, 1, 1, None),
        (USER_PROPERTY, 10, 1, 1, None),
        (USER_PROPERTY, 50_000, 1, 1, "250000 bytes of properties, more than 1024"),
        (b"\xff", 2_000, 1, 1, "2000 bytes of properties, more than 1024"),  # which cannot be unpacked
        (b"\xff", 1, 1, 1, None),
        (USER_PROPERTY, 0, 300_000, 0, "300006 bytes, more than 262144"),
        (USER_PROPERTY, 0, 5_000_000, 0, "5000006 bytes, more than 262144"),
        (USER_PROPERTY, 50_000, 5_000_000, 0, "250000 bytes of properties, more than 1024"),
    ],
)
async def test_properties_are_counted_and_not_unpacked(
    user_property: bytes, count: int, payload_bytes: int, kept_bytes: int, excess: str | None
) -> None:
    """paho-mqtt needs 4.5 s for 50,000 of them; a broker may send what it was told not to."""
    hostile = delivery(1, bytes(payload_bytes), user_property * count)

    async def send(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(ACCEPTED + hostile + delivery(2, b"a result"))
        while True:
            await packet(reader)

    async with broker(send) as address:
        connection = await Connection.open(address, Terms(timeout_s=HANG_S, max_unsettled=10))
        async with asyncio.timeout(HANG_S):
            batch = await connection.collect(1, 0.0) + await connection.collect(1, 0.0)
        connection.acknowledge(batch)
        await connection.close()
    assert [(one.packet_id, len(one.payload), one.excess) for one in batch] == [(1, kept_bytes, excess), (2, 8, None)]
    sizes = [len(b"t") + len(user_property) * count + payload_bytes, len(b"ta result")]
    assert [abs(one.size_bytes - size) <= 4 for one, size in zip(batch, sizes, strict=True)] == [True, True]


@pytest.mark.parametrize("kind", [CONNACK, DISCONNECT])
async def test_a_broker_whose_own_answer_is_all_properties_is_left(kind: int) -> None:
    properties = of_length(250_000) + USER_PROPERTY * 50_000
    content = (b"\0\0" if kind == CONNACK else b"\0") + properties
    answer = bytes([kind << 4]) + of_length(len(content)) + content

    async def answer_at_length(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(answer if kind == CONNACK else ACCEPTED + answer)
        await reader.read()

    async def listen(address: BrokerAddress) -> None:
        connection = await Connection.open(address, LONG)
        try:
            await connection.collect(1, 0.0)
        finally:
            await connection.close()

    async with broker(answer_at_length) as address:
        with pytest.raises(LinkDownError):
            await asyncio.wait_for(listen(address), HANG_S)


async def test_no_more_is_in_flight_than_the_broker_takes() -> None:
    waiting, most = 0, 0

    async def count(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal waiting, most
        await packet(reader)
        writer.write(AT_MOST_TWO)
        while True:
            kind, content = await packet(reader)
            if kind == 3:
                waiting += 1
                most = max(most, waiting)
                asyncio.get_running_loop().call_later(0.01, answer, writer, content[3:5])

    def answer(writer: asyncio.StreamWriter, packet_id: bytes) -> None:
        nonlocal waiting
        waiting -= 1
        writer.write(bytes([0x40, 2]) + packet_id)

    async with broker(count) as address:
        connection = await Connection.open(address, Terms(max_in_flight=100))
        await asyncio.wait_for(connection.publish_all(messages(20)), HANG_S)
        await connection.close()
    assert most == 2


async def test_a_loss_ends_whoever_waits() -> None:
    async def leave(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(ACCEPTED)
        await packet(reader)

    async with broker(leave) as address:
        connection = await Connection.open(address, Terms())
        reading = asyncio.create_task(connection.collect(10, 0.0))
        with pytest.raises(LinkDownError, match="connection lost"):
            await asyncio.wait_for(connection.publish_all(messages(3)), HANG_S)
        with pytest.raises(LinkDownError, match="connection lost"):
            await asyncio.wait_for(reading, HANG_S)
        await asyncio.wait_for(connection.lost(), HANG_S)
        with pytest.raises(LinkDownError):
            await connection.publish_all(messages(1))
        await connection.close()


SYSTEMS = TlsFiles()  # without files the authorities of the system count


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("mqtt://broker", BrokerAddress(host="broker")),
        ("mqtt://broker:1884/", BrokerAddress(host="broker", port=1884)),
        ("mqtt://u:p%40ss@10.0.0.1:1", BrokerAddress(host="10.0.0.1", port=1, username="u", password="p@ss")),  # noqa: S106 - made up
        ("mqtt://u@[::1]", BrokerAddress(host="::1", username="u")),
        ("nats://broker", BrokerAddress(host="broker", port=4222, is_nats=True)),
        ("nats+tls://broker", BrokerAddress(host="broker", port=4222, tls=SYSTEMS, is_nats=True)),
    ],
)
def test_what_an_address_says(url: str, address: BrokerAddress) -> None:
    assert parse_broker(url, may_be_nats=True) == address
    assert "p@ss" not in f"{address} {address!r}"


@pytest.mark.parametrize(
    "url",
    [
        "",
        "broker",
        "http://car:hunter2@broker",
        "nats://broker",  # where it may not be
        "mqtt://",
        "mqtt://broker:0",
        "mqtt://car:hunter2@broker:x",
        "mqtt://car:hunter/2@broker",
        "mqtt://[::1",
        f"mqtt://car:hunter2@{'b' * 64}.example",
    ],
)
def test_what_is_none_is_refused_without_repeating_it(url: str) -> None:
    with pytest.raises(AddressError, match="the broker must be mqtt") as caught:
        parse_broker(url)
    assert "hunter" not in str(caught.value)


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST.", "car.localhost", "127.8.9.10", "::1", "0:0:0:0:0:0:0:1", "::ffff:127.0.0.1"]
)
def test_this_machine_is_known_by_name_and_address(host: str) -> None:
    assert BrokerAddress(host=host).exposure is None


@pytest.mark.parametrize(
    "host", ["broker", "localhost.example.org", "10.0.0.1", "192.0.2.1", "fe80::1%eth0", "127.0.0.1.nip.io"]
)
def test_another_machine_is_warned_of_unless_it_is_encrypted(host: str) -> None:
    assert BrokerAddress(host=host, tls=SYSTEMS).exposure is None
    plain = BrokerAddress(host=host, username="car", password="x").exposure  # noqa: S106 - made up
    assert plain is not None
    assert "password" in plain
    assert (BrokerAddress(host=host).exposure or "").startswith(f"results go to {host} unencrypted")


@pytest.fixture(name="files")
def _files(tmp_path: Path) -> TlsFiles:
    return tls_files(certify(tmp_path, "car1"), "car1")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "car1.key").chmod(0o640), "chmod 600"),
        (lambda folder: (folder / "car1.key").unlink(), "cannot read"),
        (lambda folder: (folder / "ca.crt").unlink(), "cannot be read"),
        (lambda folder: (folder / "ca.crt").write_bytes(b"x"), "cannot be used"),
        (lambda folder: (folder / "car1.crt").write_bytes((folder / "ca.crt").read_bytes()), "cannot be used"),
    ],
)
def test_files_that_may_be_put_right_are_a_matter_of_patience(
    files: TlsFiles, tmp_path: Path, spoil: "object", message: str
) -> None:
    assert callable(spoil)
    spoil(tmp_path)
    files.fingerprint()
    with pytest.raises(AddressError, match=message):
        files.context()


def test_a_secret_comes_from_a_plain_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.touch(0o600)
    path.write_bytes(b"open sesame\n")
    assert read_secret(path) == "open sesame"
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(AddressError, match="not a plain file"):
        read_secret(tmp_path / "pipe")


def test_a_key_that_others_may_read_is_taken_only_by_whoever_says_so(files: TlsFiles, tmp_path: Path) -> None:
    (tmp_path / "car1.key").chmod(0o644)
    assert files.context(is_key_private=False).check_hostname
    with pytest.raises(AddressError, match="chmod 600"):
        files.context()
