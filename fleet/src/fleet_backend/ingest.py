"""An ingest worker: takes batches from the broker, commits them, then acknowledges; for ever.

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
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from datetime import datetime
from typing import Final, Protocol, TypeVar

from fleet_backend.choices import Pace
from fleet_backend.errors import BrokerError, DatabaseAwayError, RowRefusedError
from fleet_backend.intake import (
    IDENTITY_REASON,
    INGESTED,
    MessageKind,
    Taken,
    batch_of,
    receipts_of,
    refuse,
    take_all,
    vehicles_there,
)
from fleet_backend.writer import Batch, Identity, identity_of
from fleet_contract import Channel, JsonObject, Outgoing, ack_messages, filter_of, fluid_message
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

    @property
    def takes_bundles(self) -> bool:
        """Whether the bundles of vehicles come in by it."""

    @property
    def unsettled_count(self) -> int:
        """How many messages came and are not settled."""

    async def collect(self, limit: int, patience_s: float) -> list[Message]:
        """Return the next messages, or raise BrokerError when the connection is lost."""

    def send(self, messages: Sequence[Outgoing]) -> None:
        """Send messages at least once."""

    def settle(self, messages: Sequence[Message]) -> None:
        """Tell the broker that messages have arrived for good."""


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
        judge: Callable[[list[Taken], datetime], list[Taken]] = lambda taken, _at: taken,
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
                await self.settle(inbox, messages)

    async def settle(self, inbox: Inbox, messages: Sequence[Message]) -> None:
        """Commit messages, give receipts for them, and let the broker forget them, in this order.

        Of bundles no more than a batch is unpacked at a time.
        """
        self.begun_at = received_at = self._now()
        looked_at: list[Message] = []
        taken: list[Taken] = []
        for message in messages:
            looked_at.append(message)
            taken += take_all(message, received_at)
            if len(taken) >= self._pace.batch_size:
                await self._settle(inbox, looked_at, taken)
                looked_at, taken = [], []
        if looked_at:
            await self._settle(inbox, looked_at, taken)
        self.begun_at = None

    async def _settle(self, inbox: Inbox, messages: Sequence[Message], looked_at: list[Taken]) -> None:
        taken = await self._commit(self._judge(looked_at, self._now()))
        self.committed_at = self._now()
        sent_at = self.committed_at.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        takes_bundles = self._pace.takes_bundles and inbox.takes_bundles
        for vehicle, receipts in receipts_of(taken).items():
            acks = ack_messages(vehicle, receipts, sent_at=sent_at, worker=self._name, takes_bundles=takes_bundles)
            inbox.send(list(acks))
        await self._publish_fills(inbox, *vehicles_there(taken), sent_at)
        inbox.settle(messages)
        self.counts.update(item.kind for item in taken)
        _warn_of_strangers(taken)

    async def _publish_fills(self, inbox: Inbox, came: set[str], stayed: set[str], sent_at: str) -> None:
        """Tell vehicles which fluid fills the fleet knows: those that came, and those that do not know all of them.

        Whoever comes hears that there are none, too: an analysis waits for that. No broker needs to keep it.
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

    async def _commit(self, taken: list[Taken]) -> list[Taken]:
        """Store messages, together if the database takes them all; return what became of each."""
        try:
            aside = await until_it_answers(self._store.store, batch_of(taken))
        except RowRefusedError as exc:
            if len(taken) > 1:
                middle = len(taken) // 2
                return await self._commit(taken[:middle]) + await self._commit(taken[middle:])
            _LOG.warning("a message is kept aside: %s", exc)
            refused = refuse(taken[0].message, "database", str(exc), self._now())
            await until_it_answers(self._store.store, batch_of([refused]))
            return [refused]
        if not aside:
            return taken
        settled = [self._other(item, aside) for item in taken]
        await until_it_answers(
            self._store.store, batch_of([item for item in settled if item.kind is MessageKind.POISON])
        )
        return settled

    def _other(self, item: Taken, aside: AbstractSet[Identity]) -> Taken:
        """Return a result as one that is put aside, if it is one of those whose key another has."""
        if item.kind is not MessageKind.SHIFT or identity_of(item.row) not in aside:
            return item
        return refuse(item.message, "conflict", "another result of this key is stored already; it stays", self._now())


def _warn_of_strangers(taken: Sequence[Taken]) -> None:
    """Say at once who pretends to be another; ``fleet-backend alarms`` keeps saying so until it is acknowledged."""
    strangers = [item for item in taken if item.kind is MessageKind.POISON and item.row["reason"] == IDENTITY_REASON]
    if strangers:
        row = strangers[0].row
        _LOG.warning(
            "identity: %d messages put aside, the first on %s: %s", len(strangers), row["topic"], row["detail"]
        )


async def until_it_answers(ask: Callable[[AskedT], AnswerT], asked: AskedT) -> AnswerT:
    """Ask a database in a thread, however long it stays away."""
    pauses = Pauses()
    while True:
        try:
            return await asyncio.to_thread(ask, asked)
        except DatabaseAwayError as exc:
            await pauses.wait(exc)


class Pauses:
    """Growing, jittered waits, so that a fleet of workers does not come back in step; said once, not every time."""

    def __init__(self) -> None:
        self._count = 0

    def reset(self) -> None:
        """Begin anew; all is well."""
        self._count = 0

    async def wait(self, cause: Exception) -> None:
        """Wait before the next attempt."""
        _LOG.log(logging.INFO if self._count else logging.WARNING, "%s; trying again", cause)
        longest_s = min(FIRST_PAUSE_S * 2.0**self._count, LONGEST_PAUSE_S)
        self._count = min(self._count + 1, 16)
        await asyncio.sleep(longest_s * random.uniform(0.5, 1.0))  # noqa: S311 - jitter, no secret
