"""One MQTT connection: many messages in flight, refusals as errors, batches acknowledged when they are stored.

It speaks through paho-mqtt alone, by its public interface but for what `packets` bounds. aiomqtt, which is built on
it, tells nobody that a broker refused a message, and acknowledges what it received before anyone has kept it.
"""

import asyncio
import contextlib
import logging
import math
import ssl
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from socket import IPPROTO_TCP, TCP_NODELAY, socket
from typing import Any, Final, Self

from paho.mqtt.client import MQTT_ERR_SUCCESS, MQTT_LOG_ERR, Client, MQTTMessage, error_string
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from fleet_contract import Outgoing
from fleet_link.address import BrokerAddress, LinkDownError, MessageRefusedError, VersionRefusedError
from fleet_link.packets import BoundedClient

AT_MOST_ONCE: Final = 0
AT_LEAST_ONCE: Final = 1
MAX_PACKET_BYTES: Final = 262_144  # far above any message of the contract, properties and all
_MOST_WAITING: Final = 1_000  # of what wants an answer: a broker that gives none must not fill our memory
_PAHO_LOG: Final = logging.getLogger("mqtt")
_PAHO_LOG.setLevel(logging.WARNING)  # it would tell of every packet


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """What a broker delivered."""

    topic: str
    payload: bytes
    packet_id: int  # for its acknowledgement to the broker; 0 needs none
    is_retained: bool = False  # kept by the broker from before we asked for it
    unread_bytes: int = 0  # of properties, which nobody reads, and of a payload that is too long
    excess: str | None = None  # what is too long about it: it is to be put aside

    @property
    def size_bytes(self) -> int:
        """Of topic, properties and payload, as it was sent."""
        return len(self.topic.encode()) + self.unread_bytes + len(self.payload)


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """What a connection is made on."""

    is_version_5: bool = True  # else 3.1.1
    identifier: str | None = None  # None: the broker gives one
    timeout_s: float = 5.0  # for a connection or an acknowledgement
    stall_s: float = 60.0  # for taking more of what we send: a broker in a storm looks at one vehicle after the other
    keepalive_s: int = 20  # a dead peer is known after 1.5 times this
    will: Outgoing | None = None  # what the broker says for us when we vanish
    session_s: int = 0  # how long the broker keeps what is for us while we are away
    max_in_flight: int = 20  # messages of ours without an answer, unless the broker takes fewer
    max_unsettled: int | None = None  # messages that we hold and have not settled; None: settled as they come
    max_unsettled_bytes: int | None = None  # of them; half of it is a batch, whatever its count
    max_packet_bytes: int = MAX_PACKET_BYTES  # the broker keeps longer ones from us; of others the head is taken
    is_key_private: bool = True  # a key that others may read is refused


def make_client(address: BrokerAddress, terms: Terms) -> BoundedClient:
    """Return a client that has not connected yet; raises AddressError if a certificate cannot be used."""
    client = BoundedClient(
        CallbackAPIVersion.VERSION2,
        client_id=terms.identifier,
        clean_session=None if terms.is_version_5 else not terms.session_s,
        protocol=MQTTProtocolVersion.MQTTv5 if terms.is_version_5 else MQTTProtocolVersion.MQTTv311,
        reconnect_on_failure=False,
        manual_ack=terms.max_unsettled is not None,
        max_packet_bytes=terms.max_packet_bytes,
    )
    client.enable_logger(_PAHO_LOG)
    client.max_inflight_messages_set(terms.max_in_flight)
    client.max_queued_messages_set(_MOST_WAITING)
    if address.username is not None:
        client.username_pw_set(address.username, address.password)
    if address.tls is not None:
        client.tls_set_context(address.tls.context(is_key_private=terms.is_key_private))
    if terms.will is not None:
        client.will_set(terms.will.topic, terms.will.payload, AT_LEAST_ONCE, terms.will.is_retained)
    return client


def connect(client: Client, address: BrokerAddress, terms: Terms) -> None:
    """Open the socket of a client and ask for a connection; blocks; raises OSError."""
    if not terms.is_version_5:
        client.connect(address.host, address.port, terms.keepalive_s)
        return
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # paho-mqtt's
    if terms.session_s:
        properties.SessionExpiryInterval = terms.session_s
    if terms.max_unsettled is not None:
        properties.ReceiveMaximum = terms.max_unsettled
        # Not of vehicles: brokers of MQTT 3.1.1 alone, such as amqtt, misread properties and wait for ever.
        properties.MaximumPacketSize = terms.max_packet_bytes
    clean_start = not terms.session_s
    client.connect(address.host, address.port, terms.keepalive_s, clean_start=clean_start, properties=properties)


_LOG: Final = logging.getLogger(__name__)
_MISC_PERIOD_S: Final = 1.0  # of what is due without news from the socket: pings
_MOST_AT_ONCE: Final = 100  # packets, before others on the loop have their turn
_NOBODYS: Final = "-"  # a topic that nobody subscribes to


class SocketLoop:
    """Reads, writes and pings for a client whenever its socket is ready.

    ``connect`` blocks and so runs in a thread; paho-mqtt opens the socket there, hence the thread-safe calls.

    Parameters
    ----------
    lose :
        Called when reading or writing fails in a way that the client does not report itself.
    wrote :
        Called whenever the socket took some of what is to be written.
    """

    def __init__(self, client: Client, lose: Callable[[], None], wrote: Callable[[], None]) -> None:
        self._client = client
        self._lose = lose
        self._wrote = wrote
        self._loop = asyncio.get_running_loop()
        self._pings: asyncio.Task[None] | None = None
        self._is_ended = False
        self._is_paused = False
        self._judged_after_s = 0.0  # until then a peer that is not heard is none that has gone
        self._message_count = 0
        client.on_socket_open = self._on_open
        client.on_socket_close = self._on_close
        client.on_socket_register_write = self._on_write_wanted
        client.on_socket_unregister_write = self._on_write_done

    def end(self) -> None:
        """Ping no more; a socket that is opened after this is closed at once."""
        self._is_ended = True
        if self._pings is not None:
            self._pings.cancel()

    def count_message(self) -> None:
        """Note that a message came: there may be more to read."""
        self._message_count += 1

    def pause(self) -> None:
        """Read no more; what the peer still sends waits in the system's buffers, then with the peer."""
        if not self._is_paused:
            self._is_paused = True
            if (sock := self._open_socket()) is not None:
                self._loop.remove_reader(sock.fileno())

    def resume(self) -> None:
        if self._is_paused:
            self._is_paused = False
            self._judged_after_s = self._loop.time() + self._client.keepalive  # its answers wait behind what it sent
            if (sock := self._open_socket()) is not None:
                self._loop.add_reader(sock.fileno(), self._read)
                self._loop.call_soon(self._read)  # TLS may have decrypted what the system holds no longer

    def _open_socket(self) -> socket | None:
        sock = self._client.socket()
        return sock if isinstance(sock, socket) and sock.fileno() >= 0 else None

    def _on_open(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        self._loop.call_soon_threadsafe(self._watch, sock)

    def _watch(self, sock: socket) -> None:
        if self._is_ended:  # whoever opened it has been cancelled meanwhile
            self._client.disconnect()
            self._client.loop_write()
        elif sock.fileno() >= 0:
            sock.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)  # else a second message waits until the first has arrived
            if not self._is_paused:
                self._loop.add_reader(sock.fileno(), self._read)
            self._pings = self._loop.create_task(self._ping(), name="mqtt-pings")

    def _on_close(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        if sock.fileno() >= 0:
            self._loop.remove_reader(sock.fileno())
            self._loop.remove_writer(sock.fileno())
        if self._pings is not None:
            self._loop.call_soon_threadsafe(self._pings.cancel)

    def _on_write_wanted(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        self._loop.call_soon_threadsafe(self._want_write, sock)

    def _want_write(self, sock: socket) -> None:
        if sock.fileno() >= 0:
            self._loop.add_writer(sock.fileno(), self._write)

    def _on_write_done(self, _client: Client, _userdata: object, sock: Any) -> None:  # noqa: ANN401 - paho-mqtt's
        if sock.fileno() >= 0:
            self._loop.remove_writer(sock.fileno())

    def _read(self) -> None:
        for _ in range(_MOST_AT_ONCE):
            before = self._message_count
            if self._is_paused or self._open_socket() is None:
                return
            self._advance(self._client.loop_read)
            if self._message_count == before:
                break
        # The socket does not become ready for what TLS has decrypted already.
        while not self._is_paused and isinstance(sock := self._client.socket(), ssl.SSLSocket) and sock.pending():
            self._advance(self._client.loop_read)

    def _write(self) -> None:
        self._advance(self._client.loop_write)
        self._wrote()

    def _advance(self, step: Callable[[], object]) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - a peer may send anything; whatever it was, this connection is at its end
            _LOG.debug("the connection breaks", exc_info=True)
            self._client.disconnect()
            self._lose()

    async def _ping(self) -> None:
        """Ping, and end the connection without an answer; while reading is paused, only send signs of life."""
        period_s = min(_MISC_PERIOD_S, self._client.keepalive / 4)
        spoke_s = self._loop.time()
        while True:
            now_s = self._loop.time()
            if not self._is_paused and now_s >= self._judged_after_s:
                if self._client.loop_misc() != MQTT_ERR_SUCCESS:
                    return
            elif now_s >= spoke_s + self._client.keepalive / 2:
                self._client.unsubscribe(_NOBODYS)  # paho-mqtt takes a ping without an answer for a loss
                spoke_s = now_s
            await asyncio.sleep(period_s)


_UNLIMITED_IN_FLIGHT: Final = 65535  # MQTT 5.0, 3.2.2.3.3: without a Receive Maximum
_UNSUPPORTED_PROTOCOL: Final = 132  # MQTT 5.0, table 3-1
_LOST: Final = "connection lost"


@contextlib.asynccontextmanager
async def in_time(limit_s: float, what: str = "no answer") -> AsyncIterator[None]:
    """Raise LinkDownError if the block takes longer than ``limit_s``."""
    try:
        async with asyncio.timeout(limit_s):
            yield
    except TimeoutError:
        raise LinkDownError(f"{what} in {limit_s:g} s") from None


class Connection:
    """One connection, from `open` to `close`."""

    def __init__(self, address: BrokerAddress, terms: Terms) -> None:
        self._address = address
        self._terms = terms
        self._window = 1
        self._in_flight: dict[int, str] = {}  # packet id -> topic, of what `publish_all` waits for
        self._unanswered: set[int] = set()  # packet ids of what `send` sent at least once
        self.takes_bundles = True  # told by whoever subscribes
        self.unsettled_count = 0  # messages that we were sent and have not acknowledged
        self._unsettled_bytes = 0  # of them
        self._granted: set[str] = set()  # topics on which the broker took a message
        self._is_probing = False  # on a topic that is not among them
        self._refusal: str | None = None  # of a message of the last batch
        self._complaint: str | None = None  # of the socket: TLS says no after the handshake
        self._inbox: deque[Message] = deque()
        self._answered = asyncio.Event()  # a message of ours was acknowledged or refused, or all is lost
        self._arrived = asyncio.Event()  # a message came, or all is lost
        self._wrote = asyncio.Event()  # the socket took some of what we send, or all is lost
        self._is_lost = asyncio.Event()
        loop = asyncio.get_running_loop()
        self._accepted: asyncio.Future[ReasonCode | None] = loop.create_future()
        self._subscribed: dict[int, asyncio.Future[list[ReasonCode] | None]] = {}
        self._client = make_client(address, terms)
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = lambda *_: self._lose()
        self._client.on_subscribe = self._on_subscribe
        self._client.on_message = self._on_message
        self._client.on_publish = self._on_publish
        self._client.on_log = self._on_log
        self._socket_loop = SocketLoop(self._client, self._lose, self._wrote.set)

    @classmethod
    async def open(cls, address: BrokerAddress, terms: Terms) -> Self:
        """Connect.

        Raises
        ------
        VersionRefusedError, LinkDownError
            If the broker does not speak this version; if it is absent, silent or refuses us.
        AddressError
            If a certificate cannot be used.
        """
        connection = cls(address, terms)
        try:
            await connection._connect()
        except BaseException:
            await connection.close()
            raise
        return connection

    async def publish_all(self, messages: Sequence[Outgoing]) -> None:
        """Return when the broker has acknowledged all messages.

        Raises
        ------
        MessageRefusedError, LinkDownError
            If it refuses one; if it does not answer for as long as a call may take, or the connection is gone.
        """
        self._refusal = None
        self._in_flight.clear()  # what an interrupted call left behind
        queue = deque(messages)
        while queue or self._in_flight:
            while queue and self._may_start(queue[0].topic):
                self._start(queue.popleft())
            self._answered.clear()
            async with in_time(self._terms.timeout_s):  # until the next answer, not the last
                await self._answered.wait()
            if self._refusal is not None:  # some brokers say no and hang up
                raise MessageRefusedError(self._refusal)
            if self._is_lost.is_set():
                raise LinkDownError(_LOST)

    def send(self, messages: Iterable[Outgoing]) -> None:
        """Send messages without waiting for an answer: a vehicle asks again. `collect` waits until all is written.

        They are sent at least once, but at most once while as many as may be in flight have no answer: answers wait
        behind what the broker sends us, for which there may be no room. What is retained waits for its turn.
        """
        for message in messages:
            is_asking = message.is_retained or len(self._unanswered) < self._window
            qos = AT_LEAST_ONCE if is_asking else AT_MOST_ONCE
            info = self._client.publish(message.topic, message.payload, qos, message.is_retained)
            if is_asking and info.rc == MQTT_ERR_SUCCESS:
                self._unanswered.add(info.mid)

    async def subscribe(self, filters: Sequence[str]) -> None:
        """Subscribe; raises LinkDownError if the broker refuses one."""
        result, packet_id = self._client.subscribe([(name, AT_LEAST_ONCE) for name in filters])
        if result != MQTT_ERR_SUCCESS or packet_id is None:
            raise LinkDownError(_LOST)
        granted = self._subscribed[packet_id] = asyncio.get_running_loop().create_future()
        try:
            async with in_time(self._terms.timeout_s):
                codes = await granted
        finally:
            del self._subscribed[packet_id]
        if codes is None:
            raise LinkDownError(_LOST)
        refused = [name for name, code in zip(filters, codes, strict=True) if code.is_failure]
        if refused:
            raise LinkDownError(f"subscription to {', '.join(refused)} was refused")

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages: as many as came until ``patience_s`` after the first, ``limit`` at most.

        Fewer where these hold as many bytes as a batch may have.

        Raises
        ------
        LinkDownError
            If the connection is lost, or the broker takes nothing; messages that were not settled come again.
        """
        await self._written()
        while not self._inbox and not self._is_lost.is_set():
            self._arrived.clear()
            await self._arrived.wait()
        if self._is_lost.is_set() and (self._terms.max_unsettled is not None or not self._inbox):
            raise LinkDownError(_LOST)
        most_bytes = (self._terms.max_unsettled_bytes or math.inf) / 2
        if len(self._inbox) < limit and sum(message.size_bytes for message in self._inbox) < most_bytes:
            await asyncio.sleep(patience_s)
        batch, size = list[Message](), 0
        while self._inbox and len(batch) < limit and size < most_bytes:
            batch.append(self._inbox.popleft())
            size += batch[-1].size_bytes
        return batch

    async def _written(self) -> None:
        """Return when all is written to the socket: a broker that does not read must not fill our memory."""
        while self._client.want_write() and not self._is_lost.is_set():
            self._wrote.clear()
            async with in_time(self._terms.stall_s, "nothing was taken"):
                await self._wrote.wait()

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Tell the broker that messages have arrived for good; it then sends as many others."""
        for message in messages:
            if message.packet_id:
                self._client.ack(message.packet_id, AT_LEAST_ONCE)
                self.unsettled_count -= 1
                self._unsettled_bytes -= message.size_bytes
        if not self._is_overfull:
            self._socket_loop.resume()

    @property
    def _is_overfull(self) -> bool:
        """Whether the broker sent more than the Receive Maximum that it was told allows, or more than we hold."""
        limit, most_bytes = self._terms.max_unsettled, self._terms.max_unsettled_bytes
        is_long = most_bytes is not None and self._unsettled_bytes > most_bytes
        return is_long or (limit is not None and self.unsettled_count > limit)

    async def lost(self) -> None:
        await self._is_lost.wait()

    async def close(self) -> None:
        """Take leave of the broker; the socket is closed when this returns, or soon after if the broker is slow."""
        if self._client.disconnect() == MQTT_ERR_SUCCESS:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._terms.timeout_s):
                    await self._is_lost.wait()
        self._socket_loop.end()

    async def _connect(self) -> None:
        try:
            await asyncio.to_thread(connect, self._client, self._address, self._terms)  # it blocks
            async with asyncio.timeout(self._terms.timeout_s):
                code = await self._accepted
        except TimeoutError:  # one of the system's is an OSError, too
            raise LinkDownError(self._complaint or "Operation timed out") from None
        except OSError as exc:
            raise LinkDownError(" ".join(str(exc).split()) or type(exc).__name__) from exc
        if code is None:
            raise LinkDownError(self._complaint or _LOST)
        if code.is_failure:
            kind = VersionRefusedError if code.value == _UNSUPPORTED_PROTOCOL else LinkDownError
            raise kind(f"connection refused: [code:{code.value}] {code}")

    def _may_start(self, topic: str) -> bool:
        """Return whether a message may go now: the first of a topic goes alone.

        Mosquitto 2.0.11 says no to a message and then drops the connection if more came with it; its answer is lost.
        """
        if not self._in_flight:
            return True
        return topic in self._granted and not self._is_probing and len(self._in_flight) < self._window

    def _start(self, message: Outgoing) -> None:
        info = self._client.publish(message.topic, message.payload, AT_LEAST_ONCE, message.is_retained)
        if info.rc != MQTT_ERR_SUCCESS:
            raise LinkDownError(f"cannot send: {error_string(info.rc)}")
        self._in_flight[info.mid] = message.topic
        self._is_probing = message.topic not in self._granted

    def _lose(self) -> None:
        self._is_lost.set()
        self._answered.set()
        self._arrived.set()
        self._wrote.set()
        if not self._accepted.done():
            self._accepted.set_result(None)
        for granted in self._subscribed.values():
            if not granted.done():
                granted.set_result(None)

    def _on_connect(
        self, _client: Client, _userdata: object, _flags: object, reason_code: ReasonCode, properties: Properties | None
    ) -> None:
        if not reason_code.is_failure:
            self._client.on_log = None  # else each packet is written out for it: a tenth of the work for a message
            self._client.disable_logger()  # which would be asked twice for each: a twentieth
        self._window = min(getattr(properties, "ReceiveMaximum", _UNLIMITED_IN_FLIGHT), self._terms.max_in_flight)
        if not self._accepted.done():  # paho-mqtt may call more than once
            self._accepted.set_result(reason_code)

    def _on_subscribe(
        self, _client: Client, _userdata: object, mid: int, codes: list[ReasonCode], _properties: Properties | None
    ) -> None:
        granted = self._subscribed.get(mid)
        if granted is not None and not granted.done():
            granted.set_result(codes)

    def _on_message(self, _client: Client, _userdata: object, message: MQTTMessage) -> None:
        self._socket_loop.count_message()
        packet_id = message.mid if message.qos else 0
        limit = self._terms.max_unsettled
        if not packet_id and limit is not None and len(self._inbox) >= limit:
            return  # QoS 0 knows no limit, and promises nothing
        arrived = Message(
            topic=message.topic,
            payload=bytes(message.payload),
            packet_id=packet_id,
            is_retained=bool(message.retain),
            unread_bytes=self._client.unread_bytes,
            excess=self._client.excess,
        )
        self._inbox.append(arrived)
        self._arrived.set()
        if packet_id:
            self.unsettled_count += 1
            self._unsettled_bytes += arrived.size_bytes
        if self._is_overfull:
            self._socket_loop.pause()

    def _on_publish(
        self, _client: Client, _userdata: object, mid: int, reason_code: ReasonCode, _properties: Properties
    ) -> None:
        topic = self._in_flight.pop(mid, None)
        if topic is None:
            self._unanswered.discard(mid)
            if reason_code.is_failure:
                _LOG.warning("the broker refused an acknowledgement: %s", reason_code)
            return
        if reason_code.is_failure:
            self._refusal = f"{topic} was refused: {reason_code}"
        else:
            self._granted.add(topic)
        self._answered.set()

    def _on_log(self, _client: Client, _userdata: object, level: int, text: str) -> None:
        if level == MQTT_LOG_ERR:
            self._complaint = text
