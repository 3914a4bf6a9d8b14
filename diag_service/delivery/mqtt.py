"""MQTT through aiomqtt: version 5 where the broker speaks it, since only 5 says that it refused a message."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from diag_service.delivery.base import Hear
from diag_service.delivery.mqtt_client import AT_LEAST_ONCE, PipeliningClient
from diag_service.delivery.tls import TlsFiles
from diag_service.diagnosis.results import ServiceStatus, status_record
from diag_service.errors import PublishError
from fleet_contract import (
    Channel,
    ContractError,
    Outgoing,
    Receipt,
    exposure,
    read_message,
    receipts_of,
    status_message,
    topic_of,
)

TIMEOUT_S = 5.0  # for a connection or an acknowledgement
RENEWAL_PERIOD_S = 5.0  # how often a look is taken whether a certificate was renewed
KEEPALIVE_S = 20  # a dead peer is known after 1.5 times this
_FAREWELL_S = 1.0
_SESSION_S = 7 * 24 * 3600  # how long a broker keeps acknowledgements for a vehicle that is away
_UNSUPPORTED_PROTOCOL = 132  # MQTT 5.0, table 3-1
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAddress:
    """Where a broker is and who we are to it; its text shows no password."""

    host: str
    port: int = 1883
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: TlsFiles | None = None  # None: not encrypted

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def exposure(self) -> str | None:
        """What to warn of before anything is sent there; None if nobody on the way can read it."""
        return exposure(self.host, is_encrypted=self.tls is not None, has_password=self.password is not None)


class MqttLink:
    """One connection, while it lasts."""

    def __init__(self, client: PipeliningClient, tls: TlsFiles | None = None) -> None:
        self._client = client
        self._tls = tls
        self._tls_fingerprint = None if tls is None else tls.fingerprint()
        self._hear: Hear | None = None
        self._early: list[Receipt] = []  # heard before anyone listened: a persistent session brings them at once
        self._reader = asyncio.create_task(self._read(), name="mqtt-reader")

    async def send(self, messages: Sequence[Outgoing]) -> None:
        """Deliver messages at least once.

        Raises
        ------
        PublishError
            If the connection breaks, the acknowledgement does not come, or it says no.
        """
        delivery = asyncio.ensure_future(self._client.publish_all(messages))
        try:
            await asyncio.wait((delivery, self._reader), return_when=asyncio.FIRST_COMPLETED)
            if not delivery.done():  # aiomqtt itself would wait for the time limit
                raise PublishError(self._client.refusal or "connection lost")  # some brokers say no and hang up
            delivery.result()
        except aiomqtt.MqttError as exc:
            raise PublishError(_one_line(exc)) from exc
        finally:
            delivery.cancel()
            await asyncio.gather(delivery, return_exceptions=True)

    async def listen(self, vehicle: str, hear: Hear) -> None:
        """Subscribe to the acknowledgements for a vehicle; raises PublishError if the broker refuses."""
        self._hear = hear
        if self._early:
            hear(self._early)
        topic = topic_of(vehicle, Channel.ACK)
        try:
            granted = await self._client.subscribe(topic, qos=AT_LEAST_ONCE)
        except aiomqtt.MqttError as exc:
            raise PublishError(_one_line(exc)) from exc
        if any(_number(code) > AT_LEAST_ONCE for code in granted):
            raise PublishError(f"subscription to {topic} was refused")

    async def lost(self) -> None:
        """Return when the connection is lost, or when a certificate was renewed."""
        while self._tls is not None and self._tls.fingerprint() == self._tls_fingerprint:
            done, _ = await asyncio.wait((self._reader,), timeout=RENEWAL_PERIOD_S)
            if done:
                return
        if self._tls is None:
            await asyncio.wait((self._reader,))

    async def end(self) -> None:
        """Hear no more."""
        self._reader.cancel()
        await asyncio.gather(self._reader, return_exceptions=True)

    async def _read(self) -> None:
        """Hand on acknowledgements until the connection is lost."""
        with contextlib.suppress(aiomqtt.MqttError):
            async for message in self._client.messages:
                try:
                    incoming = read_message(str(message.topic), _payload(message))
                    if incoming.address.channel is Channel.ACK:
                        (self._hear or self._early.extend)(receipts_of(incoming.data))
                except ContractError as exc:
                    _LOG.warning("a message to us is ignored: %s", exc)


class MqttConnector:
    """Opens connections to one broker for one vehicle.

    Parameters
    ----------
    status :
        What a live service announces when it connects (retained) and takes back when it leaves or dies; None for
        a run that only delivers results.
    identifier :
        Client identifier. A fixed one lets the broker end the session of a service that vanished before the new
        one announces itself.
    is_persistent :
        Whether the broker is to keep acknowledgements for us while we are away.
    """

    def __init__(
        self,
        address: BrokerAddress,
        identifier: str,
        status: ServiceStatus | None = None,
        *,
        is_persistent: bool = False,
    ) -> None:
        self._address = address
        self._identifier = identifier
        self._status = status
        self._is_persistent = is_persistent
        self._protocol: aiomqtt.ProtocolVersion | None = None  # not known yet

    @asynccontextmanager
    async def connect(self, connected_at: str) -> AsyncIterator[MqttLink]:
        """Open a connection, announced from ``connected_at`` on if there is something to announce.

        Raises
        ------
        PublishError
            If the broker is absent, silent or refuses us.
        """
        online = None if self._status is None else replace(self._status, is_online=True, connected_at=connected_at)
        offline = None if online is None else replace(online, is_online=False)
        client = await self._open(offline)
        link = MqttLink(client, self._address.tls)
        try:
            if online is not None:
                await _announce(link, online)
            try:
                yield link
            finally:
                if offline is not None:
                    with contextlib.suppress(PublishError, TimeoutError):
                        await asyncio.wait_for(_announce(link, offline), _FAREWELL_S)
        finally:
            await link.end()
            await _leave(client)

    async def _open(self, will: ServiceStatus | None) -> PipeliningClient:
        """Connect in the version that the broker speaks.

        A will makes a CONNECT that some 3.1.1 brokers misread and never answer, so the version is found without one;
        and without our name, for what the broker kept for us must not go to a connection that ends at once.
        """
        if self._protocol is None:
            probe = self._client(aiomqtt.ProtocolVersion.V5, None, identifier=None)
            try:
                await _enter(probe)
            except _VersionRefusedError:
                self._protocol = aiomqtt.ProtocolVersion.V311
            else:
                self._protocol = aiomqtt.ProtocolVersion.V5
                await _leave(probe)
        try:
            return await _enter(self._client(self._protocol, will, self._identifier))
        except PublishError:
            self._protocol = None  # who answers next time may be another broker
            raise

    def _client(
        self, protocol: aiomqtt.ProtocolVersion, will: ServiceStatus | None, identifier: str | None
    ) -> PipeliningClient:
        is_kept = self._is_persistent and identifier is not None
        session: dict[str, Any] = {"clean_session": not is_kept}
        if protocol is aiomqtt.ProtocolVersion.V5:
            session = {"clean_start": not is_kept, "properties": _session_properties() if is_kept else None}
        return PipeliningClient(
            self._address.host,
            self._address.port,
            username=self._address.username,
            password=self._address.password,
            identifier=identifier,
            protocol=protocol,
            will=None if will is None else _will(will),
            **session,
            tls_context=None if self._address.tls is None else self._address.tls.context(),
            timeout=TIMEOUT_S,
            keepalive=KEEPALIVE_S,
        )


class _VersionRefusedError(PublishError):
    """The broker does not speak this version of the protocol."""


async def _enter(client: PipeliningClient) -> PipeliningClient:
    try:
        return await client.__aenter__()
    except aiomqtt.MqttCodeError as exc:
        kind = _VersionRefusedError if _code(exc) == _UNSUPPORTED_PROTOCOL else PublishError
        raise kind(f"connection refused: {_one_line(exc)}") from exc
    except aiomqtt.MqttError as exc:
        raise PublishError(client.complaint or _one_line(exc)) from exc


async def _leave(client: PipeliningClient) -> None:
    with contextlib.suppress(aiomqtt.MqttError):
        await client.__aexit__(None, None, None)


async def _announce(link: MqttLink, status: ServiceStatus) -> None:
    await link.send([status_message(status_record(status))])


def _will(status: ServiceStatus) -> aiomqtt.Will:
    message = status_message(status_record(status))
    return aiomqtt.Will(message.topic, message.payload, qos=AT_LEAST_ONCE, retain=message.is_retained)


def _session_properties() -> Properties:
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = _SESSION_S
    return properties


def _payload(message: aiomqtt.Message) -> bytes:
    return message.payload if isinstance(message.payload, bytes) else str(message.payload).encode()


def _number(code: ReasonCode | int) -> int:
    return int(code.value) if isinstance(code, ReasonCode) else code


def _code(exc: aiomqtt.MqttCodeError) -> int | None:
    return exc.rc.value if isinstance(exc.rc, ReasonCode) else exc.rc


def _one_line(exc: Exception) -> str:
    return " ".join(str(exc).split()) or type(exc).__name__
