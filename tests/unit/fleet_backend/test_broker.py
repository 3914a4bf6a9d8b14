"""Subscribing at a broker that lacks what later programs ask for."""

import asyncio
import re

import pytest

from demo.fleet.__main__ import BROKER_LINES
from fleet_backend.broker import connected, is_of_bundles
from fleet_backend.errors import BrokerError
from fleet_backend.ingest import FILTERS
from tests.support.grafana import ROOT
from tests.unit.fleet_link.test_connection import ACCEPTED, Script, broker, packet

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


def test_every_place_tells_a_broker_not_to_drop_by_count() -> None:
    places = ("docs/fleet.md", "docs/deploy/mosquitto.conf", "docker-compose.yml")
    texts = [*((ROOT / name).read_text(encoding="utf-8") for name in places), *BROKER_LINES]
    told = [re.findall(r"(max_(?:inflight|queued)_messages) (\d+)", text) for text in texts]
    both = [("max_inflight_messages", "0"), ("max_queued_messages", "0")]
    assert [sorted(one) for one in told] == [*([both] * len(places)), both[:1], both[1:]]
