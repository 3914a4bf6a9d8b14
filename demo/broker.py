"""A broker of the demonstration's own, inside its process, on a free port of the loopback interface."""

import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from amqtt.broker import Broker
from amqtt.contexts import BrokerConfig
from amqtt.errors import AMQTTError

from demo.errors import DemoError
from fleet_link import BrokerAddress

_HOST = "127.0.0.1"


@asynccontextmanager
async def embedded_broker() -> AsyncIterator[BrokerAddress]:
    """Run a broker for as long as the block lasts.

    Raises
    ------
    DemoError
        If it cannot listen.
    """
    for name in ("amqtt", "transitions"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # it warns of every client that asks for MQTT 5 first
    address = BrokerAddress(host=_HOST, port=_free_port())
    broker = Broker(
        BrokerConfig.from_dict(
            {
                "listeners": {"default": {"type": "tcp", "bind": str(address)}},
                "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
            }
        )
    )
    try:
        await broker.start()
    except (AMQTTError, OSError) as exc:
        raise DemoError(f"the embedded broker cannot listen on {address}: {exc}") from exc
    try:
        yield address
    finally:
        await broker.shutdown()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])
