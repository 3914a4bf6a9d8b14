"""The backend's connection to its broker: acknowledged when we say so, after the commit.

MQTT 5 is needed: its Receive Maximum asks the broker to stop at that many unacknowledged messages, so a database that
is away fills the broker and the vehicles' outboxes. Of a broker that sends more, by count or bytes, we read no further
(decision 0013): a bundle holds many results.
"""

import logging
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from typing import Final

from fleet_backend.errors import BrokerError
from fleet_contract import Channel, Outgoing, filter_of
from fleet_link import BrokerAddress, Connection, JetStream, LinkDownError, LinkError, Message, Terms
from fleet_link.jetstream import STREAM, subject_of

GROUP: Final = "ingest"  # of workers that share what comes, unless another name is told
KEEPALIVE_S: Final = 15  # a dead broker is known after 1.5 times this
MOST_IN_FLIGHT: Final = 100  # receipts without the broker's answer; the others go without one
USUAL_BYTES: Final = 4096  # of one of the messages that may be unsettled: a result alone has less, most bundles more
MAX_PACKET_BYTES: Final = 262_144  # far above any result; the broker keeps longer packets from us
_LOG: Final = logging.getLogger(__name__)


class BrokerInbox:
    """An open, subscribed connection, whose end is an error of ours."""

    def __init__(self, connection: Connection | JetStream, *, takes_bundles: bool = True) -> None:
        self.takes_bundles = takes_bundles  # whether they reach us
        self._connection = connection

    @property
    def unsettled_count(self) -> int:
        return self._connection.unsettled_count

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages, until ``patience_s`` after the first, ``limit`` at most.

        Raises BrokerError if the connection is lost; messages that were not taken come again.
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
    whichever worker is there. Raises BrokerError if the broker is absent, silent or refuses us, or a certificate cannot
    be used: it could be when the address was read, and is perhaps just renewed.
    """
    terms = Terms(
        keepalive_s=KEEPALIVE_S,
        max_unsettled=max_unsettled,
        max_unsettled_bytes=max_unsettled * USUAL_BYTES,
        max_in_flight=MOST_IN_FLIGHT,
        max_packet_bytes=MAX_PACKET_BYTES,
        is_key_private=False,  # a container's secrets are its only user's, whatever their mode says
    )
    connection: Connection | JetStream
    try:
        if address.is_nats:
            connection = await JetStream.open(address, filters, GROUP, max_unsettled * USUAL_BYTES // 2)
        else:
            connection = await Connection.open(address, terms)
    except LinkError as exc:
        raise BrokerError(f"broker {address}: {exc}") from exc
    try:
        try:
            takes_bundles = await _subscribed(connection, filters)
        except LinkDownError as exc:
            raise BrokerError(f"broker {address}: {exc}") from exc
        yield BrokerInbox(connection, takes_bundles=takes_bundles)
    finally:
        await connection.close()


def is_of_bundles(name: str) -> bool:
    """Return whether a subscription, shared or not, is to bundles."""
    return name.endswith(filter_of(Channel.BUNDLE))


async def _subscribed(connection: Connection | JetStream, filters: Sequence[str]) -> bool:
    """Subscribe, and return whether bundles are among what comes; what an operator set up earlier may lack them.

    Raises LinkDownError if any other subscription is refused.
    """
    if isinstance(connection, JetStream):
        if connection.strangers:
            subjects = ", ".join(sorted(map(subject_of, connection.strangers)))
            _LOG.warning("the stream %s lacks %s: add it with `nats stream edit`", STREAM, subjects)
        return any(is_of_bundles(name) and name not in connection.strangers for name in filters)
    bundles = [name for name in filters if is_of_bundles(name)]
    await connection.subscribe([name for name in filters if name not in bundles])
    if not bundles:
        return False
    try:
        await connection.subscribe(bundles)
    except LinkDownError as exc:  # of a connection that is lost the next call tells
        _LOG.warning("vehicles are asked to send each result alone: %s", exc)
        return False
    return True
