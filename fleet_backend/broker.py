"""The backend's connection to its broker: acknowledged when we say so, after the commit.

MQTT 5 is needed: its Receive Maximum asks the broker to stop at that many unacknowledged messages, so a database that
is away fills the broker and the vehicles' outboxes. Of a broker that sends more we read no further (decision 0080).
"""

from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from typing import Final

from fleet_backend.errors import BrokerError, ConfigError
from fleet_contract import Outgoing
from fleet_link import AddressError, BrokerAddress, Connection, JetStream, LinkDownError, Message, Terms

GROUP: Final = "ingest"  # of workers that share what comes
KEEPALIVE_S: Final = 15  # a dead broker is known after 1.5 times this
MOST_IN_FLIGHT: Final = 100  # receipts without the broker's answer; the others go without one
MAX_PACKET_BYTES: Final = 262_144  # far above any result; the broker keeps longer packets from us


class BrokerInbox:
    """An open, subscribed connection, whose end is an error of ours."""

    def __init__(self, connection: Connection | JetStream) -> None:
        self._connection = connection

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages: as many as came until ``patience_s`` after the first, ``limit`` at most.

        Raises
        ------
        BrokerError
            If the connection is lost; messages that were not taken come again.
        """
        try:
            return await self._connection.collect(limit, patience_s)
        except LinkDownError as exc:
            raise BrokerError(str(exc)) from exc

    def send(self, messages: Iterable[Outgoing]) -> None:
        """Send messages at least once; who does not get them asks again, so nobody waits for the broker's word."""
        self._connection.send(messages)

    def settle(self, messages: Sequence[Message]) -> None:
        """Tell the broker that messages have arrived for good; it then sends as many others."""
        self._connection.acknowledge(messages)


@asynccontextmanager
async def connected(
    address: BrokerAddress, filters: Sequence[str], *, max_unsettled: int
) -> AsyncIterator[BrokerInbox]:
    """Connect and subscribe for as long as the block lasts.

    The broker keeps no session for us: what it had sent and we had not stored is sent again by the vehicles, to
    whichever worker is there.

    Raises
    ------
    BrokerError
        If the broker is absent, silent or refuses us.
    ConfigError
        If a certificate cannot be read.
    """
    terms = Terms(
        keepalive_s=KEEPALIVE_S,
        max_unsettled=max_unsettled,
        max_in_flight=MOST_IN_FLIGHT,
        max_packet_bytes=MAX_PACKET_BYTES,
        is_key_private=False,  # a container's secrets are its only user's, whatever their mode says
    )
    connection: Connection | JetStream
    try:
        if address.is_nats:
            connection = await JetStream.open(address, filters, GROUP)
        else:
            connection = await Connection.open(address, terms)
    except LinkDownError as exc:
        raise BrokerError(f"broker {address}: {exc}") from exc
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
    try:
        try:
            if isinstance(connection, Connection):
                await connection.subscribe(filters)
        except LinkDownError as exc:
            raise BrokerError(f"broker {address}: {exc}") from exc
        yield BrokerInbox(connection)
    finally:
        await connection.close()
