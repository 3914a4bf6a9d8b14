"""MQTT through aiomqtt: version 5 where the broker speaks it, since only 5 says that it refused a message."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Self

import aiomqtt
from paho.mqtt.client import Client as PahoClient
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from diag_service.errors import PublishError
from diag_service.records import ShiftResult
from diag_service.results import ServiceStatus, clutch_record, shift_record, status_record
from fleet_contract import Outgoing, clutch_message, shift_message, status_message

TIMEOUT_S = 5.0  # for a connection or an acknowledgement
KEEPALIVE_S = 20  # a dead peer is known after 1.5 times this
_FAREWELL_S = 1.0
_AT_LEAST_ONCE = 1
_UNSUPPORTED_PROTOCOL = 132  # MQTT 5.0, table 3-1


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAddress:
    """Where a broker is and who we are to it; its text shows no password."""

    host: str
    port: int = 1883
    username: str | None = None
    password: str | None = field(default=None, repr=False)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


class MqttLink:
    """One connection, while it lasts."""

    def __init__(self, client: "_Client") -> None:
        self._client = client

    async def publish(self, result: ShiftResult) -> None:
        """Deliver a shift result and the clutch state it leaves; return when the broker acknowledged both."""
        await self.send(shift_message(shift_record(result)))
        await self.refresh(result)

    async def refresh(self, result: ShiftResult) -> None:
        """Deliver the state of the clutch that a result left."""
        await self.send(clutch_message(clutch_record(result)))

    async def lost(self) -> None:
        """Return when the connection is lost; nothing is subscribed, so nothing else ends the iteration."""
        with contextlib.suppress(aiomqtt.MqttError):
            async for _ in self._client.messages:
                pass

    async def send(self, message: Outgoing) -> None:
        """Deliver one message at least once.

        Raises
        ------
        PublishError
            If the connection breaks, the acknowledgement does not come, or it says no.
        """
        self._client.refusal = None
        delivery = asyncio.ensure_future(
            self._client.publish(message.topic, message.payload, qos=_AT_LEAST_ONCE, retain=message.is_retained)
        )
        loss = asyncio.ensure_future(self.lost())  # aiomqtt itself would wait for the time limit
        try:
            await asyncio.wait((delivery, loss), return_when=asyncio.FIRST_COMPLETED)
            if not delivery.done():
                raise PublishError("connection lost")
            delivery.result()
        except aiomqtt.MqttError as exc:
            raise PublishError(_one_line(exc)) from exc
        finally:
            delivery.cancel()
            loss.cancel()
            await asyncio.gather(delivery, loss, return_exceptions=True)
        if self._client.refusal is not None:
            raise PublishError(f"{message.topic} was refused: {self._client.refusal}")


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
    """

    def __init__(self, address: BrokerAddress, identifier: str, status: ServiceStatus | None = None) -> None:
        self._address = address
        self._identifier = identifier
        self._status = status
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
        try:
            link = MqttLink(client)
            if online is not None:
                await _announce(link, online)
            try:
                yield link
            finally:
                if offline is not None:
                    with contextlib.suppress(PublishError, TimeoutError):
                        await asyncio.wait_for(_announce(link, offline), _FAREWELL_S)
        finally:
            await _leave(client)

    async def _open(self, will: ServiceStatus | None) -> "_Client":
        """Connect in the version that the broker speaks.

        A will makes a CONNECT that some 3.1.1 brokers misread and never answer, so the version is found without one.
        """
        if self._protocol is None:
            probe = self._client(aiomqtt.ProtocolVersion.V5, None)
            try:
                await _enter(probe)
            except _VersionRefusedError:
                self._protocol = aiomqtt.ProtocolVersion.V311
            else:
                self._protocol = aiomqtt.ProtocolVersion.V5
                await _leave(probe)
        try:
            return await _enter(self._client(self._protocol, will))
        except PublishError:
            self._protocol = None  # who answers next time may be another broker
            raise

    def _client(self, protocol: aiomqtt.ProtocolVersion, will: ServiceStatus | None) -> "_Client":
        return _Client(
            self._address.host,
            self._address.port,
            username=self._address.username,
            password=self._address.password,
            identifier=self._identifier,
            protocol=protocol,
            will=None if will is None else _will(will),
            timeout=TIMEOUT_S,
            keepalive=KEEPALIVE_S,
        )


class _Client(aiomqtt.Client):
    """aiomqtt's client, which also keeps a refusal of the last message and leaves no socket behind a failure."""

    refusal: str | None = None

    async def __aenter__(self) -> Self:
        try:
            return await super().__aenter__()
        except BaseException:
            self._client.disconnect()
            raise

    def _on_publish(
        self,
        client: PahoClient,
        userdata: Any,  # noqa: ANN401 - signature of paho-mqtt
        mid: int,
        reason_code: ReasonCode,
        properties: Properties,
    ) -> None:
        if reason_code.is_failure:
            self.refusal = str(reason_code)
        super()._on_publish(client, userdata, mid, reason_code, properties)


class _VersionRefusedError(PublishError):
    """The broker does not speak this version of the protocol."""


async def _enter(client: _Client) -> _Client:
    try:
        return await client.__aenter__()
    except aiomqtt.MqttCodeError as exc:
        kind = _VersionRefusedError if _code(exc) == _UNSUPPORTED_PROTOCOL else PublishError
        raise kind(f"connection refused: {_one_line(exc)}") from exc
    except aiomqtt.MqttError as exc:
        raise PublishError(_one_line(exc)) from exc


async def _leave(client: _Client) -> None:
    with contextlib.suppress(aiomqtt.MqttError):
        await client.__aexit__(None, None, None)


async def _announce(link: MqttLink, status: ServiceStatus) -> None:
    await link.send(status_message(status_record(status)))


def _will(status: ServiceStatus) -> aiomqtt.Will:
    message = status_message(status_record(status))
    return aiomqtt.Will(message.topic, message.payload, qos=_AT_LEAST_ONCE, retain=message.is_retained)


def _code(exc: aiomqtt.MqttCodeError) -> int | None:
    return exc.rc.value if isinstance(exc.rc, ReasonCode) else exc.rc


def _one_line(exc: Exception) -> str:
    return " ".join(str(exc).split()) or type(exc).__name__
