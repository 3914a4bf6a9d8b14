"""Settings of the backend and of its broker."""

import asyncio
from pathlib import Path

import pytest

from fleet_backend.config import parse_broker, parse_listen
from fleet_backend.errors import BackendConfigError, BrokerError
from fleet_backend.ingest import FILTERS, connected, is_of_bundles
from tests.unit.fleet_link.test_connection import ACCEPTED, Script, broker, packet


def test_certificates_need_tls_and_must_exist() -> None:
    missing = Path("no-such-file")
    with pytest.raises(BackendConfigError, match="mqtts"):
        parse_broker("mqtt://x", ca=missing)
    with pytest.raises(BackendConfigError, match="no-such-file"):
        parse_broker("mqtts://x", ca=missing)
    with pytest.raises(BackendConfigError, match="no-such-file"):
        parse_broker("mqtts://x", certificate=missing)
    with pytest.raises(BackendConfigError, match="needs its key"):
        parse_broker("mqtts://x", key=missing)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:8090", "127.0.0.1", 8090),
        ("localhost:0", "127.0.0.1", 0),
        ("[::1]:80", "::1", 80),
        ("127.9.9.9:1", "127.9.9.9", 1),
    ],
)
def test_a_page_listens_on_the_loopback(text: str, host: str, port: int) -> None:
    assert (parse_listen(text).host, parse_listen(text).port) == (host, port)


@pytest.mark.parametrize(
    "text",
    ["0.0.0.0:8090", "[::]:80", "192.168.1.2:80", "fleet.example:80", "127.0.0.1", ":80", "1:1:1", "127.0.0.1:65536"],
)
def test_a_page_without_login_listens_nowhere_else(text: str) -> None:
    with pytest.raises(BackendConfigError, match=r"^--listen "):
        parse_listen(text)


_SUBSCRIBE = 8
_NOT_AUTHORISED = 0x87


def granting(*, refused: str) -> Script:
    """Return the script of a broker that grants every subscription but one."""

    async def script(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await packet(reader)
        writer.write(ACCEPTED)
        while True:
            kind, content = await packet(reader)
            if kind == _SUBSCRIBE:
                names = content[3:].split(b"\x01")[:-1]  # each ends with its options
                codes = bytes(_NOT_AUTHORISED if name.endswith(refused.encode()) else 1 for name in names)
                writer.write(bytes([0x90, 3 + len(codes)]) + content[:2] + b"\x00" + codes)

    return script


async def test_a_broker_that_refuses_bundles_delivers_everything_else(caplog: pytest.LogCaptureFixture) -> None:
    async with (
        broker(granting(refused=next(filter(is_of_bundles, FILTERS)))) as address,
        connected(address, FILTERS, max_unsettled=20) as inbox,
    ):
        assert not inbox.takes_bundles
    assert "to send each result alone: subscription to $share/ingest/clutchdiag/v1/+/bundle was refused" in caplog.text


async def test_a_broker_that_refuses_results_is_an_error() -> None:
    async with broker(granting(refused="shift")) as address:
        with pytest.raises(BrokerError, match="shift was refused"):
            async with connected(address, FILTERS, max_unsettled=20):
                pass
