"""One connection to the broker: messages in batches, acknowledged when we say so, never more than we can hold.

MQTT 5 is needed: its Receive Maximum stops the broker at that many unacknowledged messages. They are acknowledged
after the commit, so a database that is away fills the broker and the vehicles' outboxes, not our memory.
"""

import asyncio
import contextlib
import errno
import logging
import ssl
import stat
from collections import deque
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import aiomqtt
from paho.mqtt.client import Client as PahoClient
from paho.mqtt.client import MQTTMessage
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from fleet_backend.errors import BrokerError, ConfigError
from fleet_backend.intake import Message
from fleet_contract import Outgoing, exposure

TIMEOUT_S: Final = 5.0  # for a connection or a subscription
KEEPALIVE_S: Final = 15  # a dead broker is known after 1.5 times this
MAX_CERTIFICATE_BYTES: Final = 4 * 2**20  # a system's whole list has a quarter of one
MAX_PACKET_BYTES: Final = 262_144  # far above any result; the broker keeps longer packets from us
_AT_LEAST_ONCE: Final = 1
_ANY_CALLS: Final = 65_535  # packet identifiers that MQTT has; aiomqtt would warn of ten calls

_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsFiles:
    """Certificates for a broker, read anew at every connection; so they can be rotated without a restart."""

    ca: Path | None = None  # None: those of the operating system
    certificate: Path | None = None
    key: Path | None = None

    def context(self) -> ssl.SSLContext:
        """Return what TLS needs; raises ConfigError if a file cannot be used."""
        try:
            for path in (self.ca, self.certificate, self.key):
                if path is not None:
                    _check_plain(path)
            context = ssl.create_default_context(cafile=self.ca)
            if self.certificate is not None:
                context.load_cert_chain(self.certificate, self.key)
        except (OSError, ssl.SSLError) as exc:
            raise ConfigError(f"cannot use the certificates {self.ca}, {self.certificate}, {self.key}: {exc}") from exc
        return context


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerAddress:
    """Where the broker is and who we are to it; its text shows no password."""

    host: str
    port: int
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: TlsFiles | None = None

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    @property
    def exposure(self) -> str | None:
        """What to warn of before anything is sent there; None if nobody on the way can read it."""
        return exposure(self.host, is_encrypted=self.tls is not None, has_password=self.password is not None)


class Connection(aiomqtt.Client):
    """aiomqtt's client with an inbox of our own: whole batches, and acknowledgements after the commit."""

    def __init__(self, address: BrokerAddress, *, max_unsettled: int) -> None:
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho-mqtt's
        properties.ReceiveMaximum = max_unsettled
        properties.MaximumPacketSize = MAX_PACKET_BYTES
        super().__init__(
            address.host,
            address.port,
            username=address.username,
            password=address.password,
            protocol=aiomqtt.ProtocolVersion.V5,
            clean_start=True,
            properties=properties,
            timeout=TIMEOUT_S,
            keepalive=KEEPALIVE_S,
            tls_context=None if address.tls is None else address.tls.context(),
        )
        self.pending_calls_threshold = _ANY_CALLS
        self._client.manual_ack_set(True)
        self._max_unsettled = max_unsettled
        self._inbox: deque[Message] = deque()
        self._arrived = asyncio.Event()

    async def __aenter__(self) -> Self:
        try:
            return await super().__aenter__()
        except BaseException:
            self._client.disconnect()  # leaves no socket behind
            raise

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages: as many as came until ``patience_s`` after the first, ``limit`` at most.

        Raises
        ------
        BrokerError
            If the connection is lost; messages that were not taken come again.
        """
        if not self._inbox:
            self._arrived.clear()
            arrival = asyncio.ensure_future(self._arrived.wait())
            try:
                await asyncio.wait((arrival, self._disconnected), return_when=asyncio.FIRST_COMPLETED)
            finally:
                arrival.cancel()
        if self._disconnected.done():
            raise BrokerError("connection lost")
        if len(self._inbox) < limit:
            await asyncio.sleep(patience_s)
        return [self._inbox.popleft() for _ in range(min(limit, len(self._inbox)))]

    def send(self, messages: Iterable[Outgoing]) -> None:
        """Send messages at least once; who does not get them asks again, so nobody waits for the broker's word."""
        for message in messages:
            self._client.publish(message.topic, message.payload, _AT_LEAST_ONCE, message.is_retained)

    def settle(self, messages: Sequence[Message]) -> None:
        """Tell the broker that messages have arrived for good; it then sends as many others."""
        for message in messages:
            if message.packet_id:
                self._client.ack(message.packet_id, _AT_LEAST_ONCE)

    def _on_message(
        self,
        client: PahoClient,  # noqa: ARG002 - signature of paho-mqtt
        userdata: Any,  # noqa: ANN401, ARG002 - signature of paho-mqtt
        message: MQTTMessage,
    ) -> None:
        packet_id = message.mid if message.qos else 0
        if not packet_id and len(self._inbox) >= self._max_unsettled:
            return  # QoS 0 knows no limit, and promises nothing
        self._inbox.append(Message(topic=message.topic, payload=bytes(message.payload), packet_id=packet_id))
        self._arrived.set()

    def _on_publish(
        self,
        client: PahoClient,
        userdata: Any,  # noqa: ANN401 - signature of paho-mqtt
        mid: int,
        reason_code: ReasonCode,
        properties: Properties,
    ) -> None:
        if reason_code.is_failure:
            _LOG.warning("the broker refused an acknowledgement: %s", reason_code)
        super()._on_publish(client, userdata, mid, reason_code, properties)


@asynccontextmanager
async def connected(address: BrokerAddress, filters: Sequence[str], *, max_unsettled: int) -> AsyncIterator[Connection]:
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
    connection = Connection(address, max_unsettled=max_unsettled)
    try:
        await connection.__aenter__()
    except aiomqtt.MqttError as exc:
        raise BrokerError(f"broker {address}: {_one_line(exc)}") from exc
    try:
        codes = await connection.subscribe([(name, _AT_LEAST_ONCE) for name in filters])
        refused = [name for name, code in zip(filters, codes, strict=True) if _is_refusal(code)]
        if refused:
            raise BrokerError(f"broker {address} refuses the subscription to {', '.join(refused)}")
        yield connection
    except aiomqtt.MqttError as exc:
        raise BrokerError(f"broker {address}: {_one_line(exc)}") from exc
    finally:
        with contextlib.suppress(aiomqtt.MqttError):
            await connection.__aexit__(None, None, None)


def _check_plain(path: Path) -> None:
    """Raise OSError of what a library would read without an end, or wait for without one."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_CERTIFICATE_BYTES:
        raise OSError(errno.EINVAL, f"{path} is no plain file of at most {MAX_CERTIFICATE_BYTES >> 20} MiB")


def _is_refusal(code: object) -> bool:
    return isinstance(code, ReasonCode) and code.is_failure


def _one_line(exc: Exception) -> str:
    return " ".join(str(exc).split()) or type(exc).__name__
