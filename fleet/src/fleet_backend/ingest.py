"""An ingest worker: reads batches from the broker, commits them, then acknowledges them.

The order is what makes it safe: commit, receipt to the vehicle, PUBACK to the broker. Killed between any two of them, a
worker leaves at worst a result that is sent again, and writing it again changes nothing.

MQTT 5 is needed: its Receive Maximum asks the broker to stop at that many unacknowledged messages, so a database that
is away fills the broker and the vehicles' outboxes. Of a broker that sends more, by count or bytes, we read no further
(decision 0013): a bundle holds many results.
"""

import asyncio
import logging
import random
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from datetime import datetime
from typing import Final, Protocol, TypeVar

from fleet_backend.choices import Pace
from fleet_backend.errors import BrokerError, DatabaseAwayError, RowRefusedError
from fleet_backend.intake import (
    INGESTED,
    MessageKind,
    Received,
    batch_of,
    receipts_of,
    receive_all,
    refuse,
    vehicles_there,
)
from fleet_backend.writer import Batch, Identity, identity_of
from fleet_contract import Channel, IdentityError, JsonObject, Outgoing, ack_messages, filter_of, fluid_message
from fleet_link import BrokerAddress, Connection, JetStream, LinkDownError, LinkError, Message, Terms
from fleet_link.jetstream import STREAM, subject_of

GROUP: Final = "ingest"  # of workers that share what comes, unless another name is told
KEEPALIVE_S: Final = 15  # a dead broker is known after 1.5 times this
MOST_IN_FLIGHT: Final = 100  # receipts without the broker's answer; the others go without one
USUAL_BYTES: Final = 4096  # of one of the messages that may be unsettled: a result alone has less, most bundles more
_LOG: Final = logging.getLogger(__name__)


@asynccontextmanager
async def connected(address: BrokerAddress, filters: Sequence[str], *, max_unsettled: int) -> AsyncIterator["Inbox"]:
    """Connect and subscribe for as long as the block lasts.

    The broker keeps no session for us: what it had sent and we had not stored is sent again by the vehicles, to
    whichever worker is there. Raises BrokerError if the broker is absent, silent, refuses us or goes away, or a
    certificate cannot be used: it could be when the address was read, and is perhaps just renewed.
    """
    terms = Terms(
        keepalive_s=KEEPALIVE_S,
        max_unsettled=max_unsettled,
        max_unsettled_bytes=max_unsettled * USUAL_BYTES,
        max_in_flight=MOST_IN_FLIGHT,
        is_key_private=False,  # a container's secrets are its only user's, whatever their mode says
    )
    connection: Connection | JetStream
    try:
        if address.is_nats:
            connection = await JetStream.open(address, filters, GROUP)
        else:
            connection = await Connection.open(address, terms)
        try:
            connection.takes_bundles = await _subscribed(connection, filters)
            yield connection
        finally:
            await connection.close()
    except LinkError as exc:
        raise BrokerError(f"broker {address}: {exc}") from exc


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


def filters_of(group: str = GROUP) -> tuple[str, ...]:
    """Return what a worker of a group subscribes to.

    States go to every worker: a shared subscription never gets what the broker retained, and two writers agree.
    """
    return tuple(filter_of(channel, group=None if channel.is_retained else group) for channel in INGESTED)


FILTERS: Final = filters_of()
FIRST_PAUSE_S: Final = 0.2
LONGEST_PAUSE_S: Final = 10.0

AskedT = TypeVar("AskedT")
AnswerT = TypeVar("AnswerT")


class Inbox(Protocol):
    """An open connection to a broker."""

    takes_bundles: bool  # of vehicles come in by it

    @property
    def unsettled_count(self) -> int:
        """How many messages came and are not acknowledged."""

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages, or raise LinkDownError when the connection is lost."""

    def send(self, messages: Sequence[Outgoing]) -> None:
        """Send messages at least once."""

    def acknowledge(self, messages: Sequence[Message]) -> None:
        """Acknowledge messages to the broker."""


class Store(Protocol):
    """Where batches go."""

    def store(self, batch: Batch) -> AbstractSet[Identity]:
        """Store all of a batch but results whose key is taken, which are returned.

        Raises DatabaseAwayError (ask again) or RowRefusedError (one row never fits).
        """

    def fills(self, vehicles: Sequence[str]) -> dict[str, list[JsonObject]]:
        """Return the fluid fills of those vehicles that have any, or raise DatabaseAwayError (ask again)."""


class Worker:
    """Moves messages from a broker into a store, for as long as ``run`` runs.

    Parameters
    ----------
    connect :
        Opens a connection that is subscribed, or raises BrokerError.
    name :
        Tells this worker's acknowledgements from others'.
    now : callable
        Returns the present moment in UTC.
    """

    def __init__(
        self,
        connect: Callable[[], AbstractAsyncContextManager[Inbox]],
        store: Store,
        *,
        name: str,
        now: Callable[[], datetime],
        pace: Pace,
        judge: Callable[[list[Received], datetime], list[Received]] = lambda received, _at: received,
    ) -> None:
        self._connect = connect
        self._store = store
        self._name = name
        self._now = now
        self._pace = pace
        self._judge = judge  # what is beyond a quota is withheld
        self.counts: Counter[MessageKind] = Counter()  # committed, repetitions included
        self.is_listening = False
        self.committed_at: datetime | None = None
        self.begun_at: datetime | None = None  # the batch at hand
        self.inbox: Inbox | None = None
        self._published: dict[str, list[JsonObject]] = {}  # the fills that a vehicle was sent last

    async def run(self) -> None:
        """Connect, take, commit, acknowledge; come back after every loss. Ends only when it is cancelled."""
        pauses = Pauses()
        while True:
            try:
                async with self._connect() as inbox:
                    _LOG.info("listening")
                    pauses.reset()
                    self.inbox, self.is_listening = inbox, True
                    await self._serve(inbox)
            except BrokerError as exc:
                self.is_listening, self.begun_at = False, None
                await pauses.wait(exc)

    async def _serve(self, inbox: Inbox) -> None:
        while True:
            messages = await inbox.collect(self._pace.batch_size, self._pace.patience_s)
            if messages:
                await self.process(inbox, messages)

    async def process(self, inbox: Inbox, messages: Sequence[Message]) -> None:
        """Commit messages, send receipts for them, and acknowledge them to the broker, in this order.

        Bundles are unpacked until a batch is full.
        """
        self.begun_at = received_at = self._now()
        unpacked: list[Message] = []
        received: list[Received] = []
        for message in messages:
            unpacked.append(message)
            received += receive_all(message, received_at)
            if len(received) >= self._pace.batch_size:
                await self._process_batch(inbox, unpacked, received)
                unpacked, received = [], []
        if unpacked:
            await self._process_batch(inbox, unpacked, received)
        self.begun_at = None

    async def _process_batch(self, inbox: Inbox, messages: Sequence[Message], batch: list[Received]) -> None:
        received = await self._commit(self._judge(batch, self._now()))
        self.committed_at = self._now()
        sent_at = self.committed_at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        takes_bundles = self._pace.takes_bundles and inbox.takes_bundles
        for vehicle, receipts in receipts_of(received).items():
            acks = ack_messages(vehicle, receipts, sent_at=sent_at, worker=self._name, takes_bundles=takes_bundles)
            inbox.send(list(acks))
        await self._publish_fills(inbox, *vehicles_there(received), sent_at)
        inbox.acknowledge(messages)
        self.counts.update(item.kind for item in received)
        _warn_of_strangers(received)

    async def _publish_fills(self, inbox: Inbox, came: set[str], stayed: set[str], sent_at: str) -> None:
        """Publish the fluid fills of vehicles that just connected, and of those whose fills have changed since.

        A vehicle that connects is also sent an empty list, not retained: an analysis of logs waits for it.
        """
        if not came | stayed:
            return
        known = await until_it_answers(self._store.fills, sorted(came | stayed))
        changed = {vehicle for vehicle in stayed if known.get(vehicle, []) != self._published.get(vehicle, [])}
        for vehicle in sorted(came | changed):
            fills = known.get(vehicle, [])
            message = fluid_message(vehicle, sent_at, fills, is_to_vehicle=True)
            inbox.send([message if fills else replace(message, is_retained=False)])
            if fills:  # as of few vehicles
                self._published[vehicle] = fills

    async def _commit(self, received: list[Received]) -> list[Received]:
        """Store messages, in one transaction if the database takes them all; return what became of each."""
        try:
            aside = await until_it_answers(self._store.store, batch_of(received))
        except RowRefusedError as exc:
            if len(received) > 1:
                middle = len(received) // 2
                return await self._commit(received[:middle]) + await self._commit(received[middle:])
            _LOG.warning("a message is kept aside: %s", exc)
            refused = refuse(received[0].message, "database", str(exc), self._now())
            await until_it_answers(self._store.store, batch_of([refused]))
            return [refused]
        if not aside:
            return received
        judged = [self._without_conflict(item, aside) for item in received]
        poison = [item for item in judged if item.kind is MessageKind.POISON]
        await until_it_answers(self._store.store, batch_of(poison))
        return judged

    def _without_conflict(self, item: Received, aside: AbstractSet[Identity]) -> Received:
        """Return a message; a result whose key is stored with another content becomes poison."""
        if item.kind is not MessageKind.SHIFT or identity_of(item.row) not in aside:
            return item
        return refuse(item.message, "conflict", "another result of this key is stored already; it stays", self._now())


def _warn_of_strangers(received: Sequence[Received]) -> None:
    """Log messages whose sender is not the vehicle that they name; ``fleet-backend alarms`` lists them, too."""
    strangers = [
        item for item in received if item.kind is MessageKind.POISON and item.row["reason"] == IdentityError.reason
    ]
    if strangers:
        row = strangers[0].row
        _LOG.warning(
            "identity: %d messages put aside, the first on %s: %s", len(strangers), row["topic"], row["detail"]
        )


async def until_it_answers(ask: Callable[[AskedT], AnswerT], asked: AskedT) -> AnswerT:
    """Call a database function in a thread, again and again while the database is away."""
    pauses = Pauses()
    while True:
        try:
            return await asyncio.to_thread(ask, asked)
        except DatabaseAwayError as exc:
            await pauses.wait(exc)


class Pauses:
    """Growing, jittered pauses, so that workers do not reconnect in step; the first is logged as a warning."""

    def __init__(self) -> None:
        self._count = 0

    def reset(self) -> None:
        """Make the next pause the shortest again."""
        self._count = 0

    async def wait(self, cause: Exception) -> None:
        """Wait before the next attempt."""
        _LOG.log(logging.INFO if self._count else logging.WARNING, "%s; trying again", cause)
        longest_s = min(FIRST_PAUSE_S * 2.0**self._count, LONGEST_PAUSE_S)
        self._count = min(self._count + 1, 16)
        await asyncio.sleep(longest_s * random.uniform(0.5, 1.0))  # noqa: S311 - jitter, no secret
