"""MQTT: version 5 where the broker speaks it: only version 5 reports a refused message."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace

from clutch_results.records import ServiceStatus, fills_from, status_record
from diag_service.delivery.reporters import OnFills, OnReceipts
from diag_service.errors import PublishError, PublishRefusedError
from fleet_contract import (
    Channel,
    ContractError,
    Incoming,
    Outgoing,
    parse_topic,
    read_message,
    receipts_of,
    status_message,
    takes_bundles,
    topic_of,
)
from fleet_link import (
    BrokerAddress,
    Connection,
    LinkDownError,
    LinkError,
    Message,
    MessageRefusedError,
    Terms,
    TlsFiles,
    VersionRefusedError,
)

RENEWAL_PERIOD_S = 5.0  # how often a look is taken whether a certificate was renewed
_MAX_IN_FLIGHT = 100
_BATCH = 100  # messages to us that are read in one go
_FAREWELL_S = 1.0
_SESSION_S = 7 * 24 * 3600  # how long a broker keeps acknowledgements for a vehicle that is away
_LOG = logging.getLogger(__name__)


class MqttLink:
    """One connection, while it lasts."""

    def __init__(self, connection: Connection, tls: TlsFiles | None = None, *, renewal_period_s: float) -> None:
        self._connection = connection
        self._tls = tls
        self._tls_fingerprint = None if tls is None else tls.fingerprint()
        self._renewal_period_s = renewal_period_s
        self._hearers: dict[Channel, Callable[[Incoming, Message], None]] = {}
        self._early: list[Message] = []  # before anyone listened: a persistent session brings them at once
        self._reader = asyncio.create_task(self._read(), name="mqtt-reader")

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Deliver messages at least once.

        Raises PublishRefusedError if the broker says no, PublishError if the connection breaks or no answer comes.
        """
        with _translated():
            await self._connection.publish_all(messages)

    async def listen(self, vehicle: str, on_receipts: OnReceipts) -> None:
        """Subscribe to the acknowledgements for a vehicle; raises PublishError if the broker refuses."""
        with _translated():
            await self._subscribe(
                topic_of(vehicle, Channel.ACK),
                lambda incoming, _: on_receipts(receipts_of(incoming.data), takes_bundles=takes_bundles(incoming.data)),
            )

    async def hear_fills(self, vehicle: str, on_fills: OnFills) -> None:
        """Subscribe to the fluid fills that the fleet knows; a broker that refuses costs these and nothing else."""
        try:
            await self._subscribe(
                topic_of(vehicle, Channel.FILLS),
                lambda incoming, message: on_fills(fills_from(incoming.data), is_answer=not message.is_retained),
            )
        except LinkDownError as exc:  # of a connection that is lost the next message tells
            _LOG.warning("fluid fills noted in the fleet are not received: %s", exc)

    async def _subscribe(self, topic: str, hear: Callable[[Incoming, Message], None]) -> None:
        self._hearers[parse_topic(topic).channel] = hear
        early, self._early = self._early, []
        for message in early:
            self._handle(message)
        await self._connection.subscribe([topic])

    async def lost(self) -> None:
        """Return when the connection is lost, or when a certificate was renewed."""
        while not self._reader.done() and (self._tls is None or self._tls.fingerprint() == self._tls_fingerprint):
            await asyncio.wait((self._reader,), timeout=self._renewal_period_s)

    async def end(self) -> None:
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)

    async def _read(self) -> None:
        """Hand on acknowledgements until the connection is lost."""
        with contextlib.suppress(LinkDownError):
            while True:
                for message in await self._connection.collect(_BATCH, 0.0):
                    self._handle(message)

    def _handle(self, message: Message) -> None:
        if message.excess is not None:
            _LOG.warning("a message to this service is ignored: %s: %s", message.topic, message.excess)
            return
        try:
            incoming = read_message(message.topic, message.payload)
            if hear := self._hearers.get(incoming.address.channel):
                hear(incoming, message)
            elif incoming.address.channel.is_to_vehicle:
                self._early.append(message)
        except ContractError as exc:
            _LOG.warning("a message to this service is ignored: %s", exc)


class MqttConnector:
    """Opens connections to one broker for one vehicle.

    A live service announces its status when it connects (retained), and takes it back when it leaves or dies. A fixed
    identifier lets the broker end the session of a service that vanished before the new one announces itself.
    """

    def __init__(
        self,
        address: BrokerAddress,
        identifier: str,
        status: ServiceStatus | None = None,  # None: the run only delivers results
        *,
        is_persistent: bool = False,  # whether the broker keeps acknowledgements for us while we are away
        renewal_period_s: float = RENEWAL_PERIOD_S,
    ) -> None:
        self._address = address
        self._identifier = identifier
        self._status = status
        self._is_persistent = is_persistent
        self._renewal_period_s = renewal_period_s
        self._is_version_5: bool | None = None  # not known yet

    @asynccontextmanager
    async def connect(self, connected_at: str) -> AsyncIterator[MqttLink]:
        """Open a connection, announced from ``connected_at`` on if there is something to announce.

        Raises PublishError if the broker is absent, silent or refuses us.
        """
        online = None if self._status is None else replace(self._status, is_online=True, connected_at=connected_at)
        offline = None if online is None else replace(online, is_online=False)
        with _translated():
            connection = await self._open(offline)
        link = MqttLink(connection, self._address.tls, renewal_period_s=self._renewal_period_s)
        try:
            if online is not None:
                await _announce(link, online)
            try:
                yield link
            finally:
                if offline is not None:
                    with contextlib.suppress(PublishError, TimeoutError):
                        async with asyncio.timeout(_FAREWELL_S):
                            await _announce(link, offline)
        finally:
            await link.end()
            await connection.close()

    async def _open(self, will: ServiceStatus | None) -> Connection:
        """Connect in the version that the broker speaks.

        A will makes a CONNECT that some 3.1.1 brokers misread and never answer, so the version is found without one;
        and without our name, for what the broker kept for us must not go to a connection that ends at once.
        """
        if self._is_version_5 is None:
            self._is_version_5 = await self._speaks_version_5()
        terms = Terms(
            is_version_5=self._is_version_5,
            identifier=self._identifier,
            will=None if will is None else status_message(status_record(will)),
            session_s=_SESSION_S if self._is_persistent else 0,
            max_in_flight=_MAX_IN_FLIGHT,
        )
        try:
            return await Connection.open(self._address, terms)
        except LinkDownError:
            self._is_version_5 = None  # who answers next time may be another broker
            raise

    async def _speaks_version_5(self) -> bool:
        try:
            probe = await Connection.open(self._address, Terms())
        except VersionRefusedError:
            return False
        await probe.close()
        return True


async def _announce(link: MqttLink, status: ServiceStatus) -> None:
    await link.send([status_message(status_record(status))])


@contextmanager
def _translated() -> Iterator[None]:
    """Raise PublishError for errors of the link, an unusable certificate included: it may be replaced."""
    try:
        yield
    except LinkError as exc:
        kind = PublishRefusedError if isinstance(exc, MessageRefusedError) else PublishError
        raise kind(str(exc)) from exc
