"""A connection to NATS JetStream: pulls messages from a stream on disk, which drops them when acknowledged.

Vehicles speak MQTT to the gateway of a nats-server; a topic ``a/b`` is the subject ``a.b`` here. What they publish goes
into the stream besides, where workers share it: each message to one of them, and to another if that one vanishes.
"""

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final, Self

from fleet_contract import Outgoing
from fleet_link.address import BrokerAddress, LinkDownError
from fleet_link.connection import Message
from fleet_link.packets import excess_of

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg
    from nats.js import JetStreamContext

STREAM: Final = "CLUTCHDIAG"
ACK_WAIT_S: Final = 60.0  # then a message goes to another worker; a batch takes far less
MOST_UNSETTLED: Final = 50_000  # of all workers together
_EXPIRES_S: Final = 20.0  # of a question for messages
_LEAST_PATIENCE_S: Final = 0.01
_TIMEOUT_S: Final = 5
_PING_S: Final = 10
_LOST: Final = "connection lost"
_LOG: Final = logging.getLogger(__name__)


def subject_of(filter_text: str) -> str:
    """Return the subject that a subscription of MQTT is, shared or not."""
    shared = filter_text.split("/", 2)[2] if filter_text.startswith("$share/") else filter_text
    return shared.replace("/", ".").replace("+", "*")


def covers(pattern: str, subject: str) -> bool:
    """Return whether a subject of a stream takes all that another one does."""
    theirs, ours = pattern.split("."), subject.split(".")
    if theirs[-1] == ">":
        theirs = theirs[:-1] + ["*"] * max(1, len(ours) - len(theirs) + 1)
    return len(theirs) == len(ours) and all(part in {"*", other} for part, other in zip(theirs, ours, strict=True))


def _heed_cancellation() -> None:
    """Raise CancelledError if this task is to end: nats-py and Python 3.11 lose a cancellation that meets a message."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def _arrived(message: "Msg", number: int) -> Message:
    """Return what the stream delivered; headers are what properties are in MQTT."""
    header_bytes = sum(len(name) + len(text) for name, text in (message.headers or {}).items())
    return Message(
        topic=message.subject.replace(".", "/"),
        payload=message.data,
        packet_id=number,
        unread_bytes=header_bytes,
        excess=excess_of(header_bytes),
    )


class JetStream:
    """One connection, from `open` to `close`; its worker is one of a group that shares the stream."""

    def __init__(self, client: "Client") -> None:
        self.strangers: frozenset[str] = frozenset()  # of the subscriptions asked for, those that the stream lacks
        self.takes_bundles = True  # told by whoever subscribes
        self._client = client
        self._subscription: JetStreamContext.PullSubscription
        self._replies: dict[int, str] = {}  # of messages that are not settled
        self._count = 0
        self._outbox: deque[tuple[str, bytes]] = deque()
        self._is_trying = True  # to connect

    @classmethod
    async def open(cls, address: BrokerAddress, filters: Sequence[str], group: str) -> Self:
        """Connect; make the stream of these topics and its group unless they are there.

        Raises
        ------
        LinkDownError
            If the broker is absent, silent, refuses us or has no JetStream.
        AddressError
            If a certificate cannot be used.
        """
        from nats.aio.client import Client  # noqa: PLC0415 - an extra
        from nats.errors import Error  # noqa: PLC0415

        client = Client()
        made = cls(client)
        context = None if address.tls is None else address.tls.context(is_key_private=False)
        try:
            async with asyncio.timeout(2 * _TIMEOUT_S):
                await client.connect(
                    f"{'nats' if context is None else 'tls'}://{address}",
                    user=address.username,
                    password=address.password,
                    tls=context,
                    allow_reconnect=False,
                    connect_timeout=_TIMEOUT_S,
                    ping_interval=_PING_S,
                    error_cb=made._complain,
                )
                made._is_trying = False
                await made._prepare(filters, group)
        except BaseException as exc:
            await made.close()
            _heed_cancellation()
            if isinstance(exc, Error | OSError):
                raise LinkDownError(" ".join(str(exc).split()) or type(exc).__name__) from exc
            raise
        return made

    @property
    def unsettled_count(self) -> int:
        return len(self._replies)

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages: as many as came until ``patience_s`` after the first, ``limit`` at most.

        Raises
        ------
        LinkDownError
            If the connection is lost; messages that were not settled come again.
        """
        from nats.errors import Error  # noqa: PLC0415 - an extra

        fetched: list[Msg] = []
        try:
            await self._flush()
            while not fetched:
                _heed_cancellation()
                with contextlib.suppress(TimeoutError):
                    fetched = await self._subscription.fetch(1, _EXPIRES_S)
            if limit > 1:
                with contextlib.suppress(TimeoutError):
                    fetched += await self._subscription.fetch(limit - 1, max(patience_s, _LEAST_PATIENCE_S))
        except Error as exc:
            raise LinkDownError(str(exc) or _LOST) from exc
        finally:
            _heed_cancellation()
        numbered = list(enumerate(fetched, self._count + 1))
        self._count += len(fetched)
        self._replies |= {number: message.reply for number, message in numbered}
        return [_arrived(message, number) for number, message in numbered]

    def send(self, messages: Iterable[Outgoing]) -> None:
        """Send messages with the next `collect`; who does not get them asks again."""
        self._outbox.extend((message.topic.replace("/", "."), message.payload) for message in messages)

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Let the stream forget messages, with the next `collect`."""
        for message in messages:
            reply = self._replies.pop(message.packet_id, None)
            if reply is not None:
                self._outbox.append((reply, b""))

    async def close(self) -> None:
        """Take leave of the broker; what was to be sent is sent."""
        with contextlib.suppress(Exception):  # whatever it was, this connection is at its end
            if self._client.is_connected:
                await self._flush()
            async with asyncio.timeout(_TIMEOUT_S):
                await self._client.close()

    async def _prepare(self, filters: Sequence[str], group: str) -> None:
        """Make stream and group where they are missing; how an operator made them is not changed."""
        from nats.js.api import (  # noqa: PLC0415 - an extra
            AckPolicy,
            ConsumerConfig,
            DeliverPolicy,
            RetentionPolicy,
            StorageType,
            StreamConfig,
        )
        from nats.js.errors import NotFoundError  # noqa: PLC0415

        manager = self._client.jetstream(timeout=_TIMEOUT_S)
        try:
            known = (await manager.stream_info(STREAM)).config.subjects or []
            self.strangers = frozenset(
                name for name in filters if not any(covers(pattern, subject_of(name)) for pattern in known)
            )
        except NotFoundError:
            config = StreamConfig(
                name=STREAM,
                subjects=[subject_of(name) for name in filters],
                retention=RetentionPolicy.WORK_QUEUE,
                storage=StorageType.FILE,
            )
            await manager.add_stream(config)
        try:
            await manager.consumer_info(STREAM, group)
        except NotFoundError:
            consumer = ConsumerConfig(
                durable_name=group,
                deliver_policy=DeliverPolicy.ALL,
                ack_policy=AckPolicy.EXPLICIT,
                ack_wait=ACK_WAIT_S,
                max_ack_pending=MOST_UNSETTLED,
            )
            await manager.add_consumer(STREAM, consumer)
        self._subscription = await manager.pull_subscribe_bind(group, STREAM)

    async def _flush(self) -> None:
        while self._outbox:
            await self._client.publish(*self._outbox.popleft())

    async def _complain(self, error: Exception) -> None:
        """Raise LinkDownError while connecting, which the library would retry."""
        if self._is_trying:
            raise LinkDownError(" ".join(str(error).split()) or type(error).__name__)
        _LOG.debug("nats: %s", error)
