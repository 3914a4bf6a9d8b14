"""The outbox: keeps a connection to a broker, delivers what the store holds, retries without end.

A result stays in the store as undelivered until the one whose word counts has acknowledged it, so a slow, absent or
refusing broker or backend costs nothing but time. Delivery is at least once and in any order; the key (vehicle, stream,
seq, versions) tells a repetition. A broker's word is weak: it acknowledges before its subscribers or its disk have the
message, so what it acknowledged shortly before a connection broke is sent again. A backend's word is its commit.
"""

import asyncio
import logging
import math
import random
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import asdict

from canlog.errors import NOTICE
from diag_service.delivery.delivery import Acknowledge, Bundling, Deliverer, OutboxState
from diag_service.delivery.reporters import DeliveryLimits, Link
from diag_service.errors import PublishError, StoreFullError
from diag_service.store import ResultStore
from fleet_contract import Outgoing

DRAIN_S = 5.0  # how long an ending service waits for its broker
METRICS_PERIOD_S = 60.0

Connect = Callable[[], AbstractAsyncContextManager[Link]]
MetricsMessage = Callable[[Mapping[str, float]], Outgoing]
_LOG = logging.getLogger(__name__)


class Outbox:
    """Sends what the store holds for one vehicle, for as long as ``run`` runs."""

    def __init__(
        self,
        store: ResultStore,
        vehicle: str,
        connect: Connect,  # or raises PublishError
        where: str,  # the broker, for people; without credentials
        *,
        acknowledge: Acknowledge = Acknowledge.BROKER,
        greetings: Sequence[Outgoing] = (),  # open every connection
        metrics: MetricsMessage | None = None,  # makes a message of the outbox's numbers, now and then
        holds_states: bool = False,  # until ``release_states``: the states that a part of a drive leaves are none
        limits: DeliveryLimits | None = None,
    ) -> None:
        self._state = OutboxState(
            store=store,
            vehicle=vehicle,
            acknowledge=acknowledge,
            limits=limits or DeliveryLimits(),
            bundling=Bundling(store, is_allowed=acknowledge is Acknowledge.BACKEND),
            holds_states=holds_states,
        )
        self.counts, self.limits = self._state.counts, self._state.limits
        self._connect = connect
        self._where = where
        self._greetings = greetings
        self._metrics = metrics
        self._metrics_due_s = 0.0  # of the loop
        self._delivery: Deliverer | None = None  # over the present connection
        self._lasting: dict[str, Outgoing] = {}  # by topic: what a restarted broker may not know
        self._unsent: dict[str, Outgoing] = {}
        self._closing = asyncio.Event()
        self._is_down = False

    def wake(self) -> None:
        """Say that the store holds something new."""
        if self._delivery is not None:
            self._delivery.wake.set()

    def publish_state(self, message: Outgoing) -> None:
        """Send a retained message, now or with the next connection, and again with each later one."""
        self._lasting[message.topic] = self._unsent[message.topic] = message
        self.wake()

    def release_states(self) -> None:
        """Send the states of clutches that were held back."""
        self._state.holds_states = False
        self.wake()

    def await_fleet(self) -> None:
        """Wait, in a thread, until the fluid fills that the fleet knows are in the store; once, and not for long."""
        heard, wait_s = self._state.fleet_is_heard, self.limits.answer_s
        if not heard.wait(wait_s) and self._state.acknowledge is Acknowledge.BACKEND:
            _LOG.warning("the fleet did not tell its fluid fills in %g s; those in the store count", wait_s)
        heard.set()

    async def run(self) -> None:
        """Connect, send, reconnect; return after ``close`` once all is sent or a fresh attempt has sent nothing.

        A connection that did some good, new results arrived or it lasted, is no failure when it breaks.
        """
        failure_count = 0
        while True:
            is_last_attempt = self._closing.is_set()
            sent_before, arrived_before, lasts_s = self.counts.sent, self._arrived_count, math.inf
            try:
                async with self._connect() as link:
                    lasts_s = self._now_s() + self.limits.longest_pause_s
                    await self._serve(link)
                    return
            except (PublishError, StoreFullError) as exc:  # a full disk cannot note receipts; they come again
                self._state.resend_published(self._now_s())
                await self._note_failure(exc)
            finally:
                self._delivery = None
            if is_last_attempt and self.counts.sent == sent_before:
                return
            if self._arrived_count > arrived_before or self._now_s() > lasts_s:
                failure_count = 0
            await self._pause(failure_count)
            failure_count += 1

    async def close(self, sender: asyncio.Task[None], timeout_s: float = DRAIN_S) -> int:
        """Let ``sender``, the task of ``run``, send what is left, for a limited time; return what remains unsent."""
        self._closing.set()
        self.wake()
        try:
            async with asyncio.timeout(timeout_s):
                await sender
        except TimeoutError:
            _LOG.info("broker %s did not take everything in %g s", self._where, timeout_s)
        return await asyncio.to_thread(self._unpublished_count)

    async def _serve(self, link: Link) -> None:
        delivery = self._delivery = Deliverer(self._state, link)
        self._unsent.clear()
        await delivery.begin([*self._greetings, *self._lasting.values()])
        sent_before = self.counts.sent
        while True:
            is_going_on = True
            while is_going_on:
                is_going_on = await delivery.step()
                if self._is_down and (self.counts.sent > sent_before or not is_going_on):
                    self._is_down = False
                    _LOG.log(NOTICE, "broker %s takes results again", self._where)
                await self._send_metrics(link)
            messages, self._unsent = list(self._unsent.values()), {}
            if messages:
                await link.send(messages)
            if self._closing.is_set() and not delivery.awaits_receipts and not delivery.wake.is_set():
                return
            await self._wait(link, delivery)

    async def _wait(self, link: Link, delivery: Deliverer) -> None:
        """Return when there is something to do; raises PublishError if the connection is lost."""
        wait_s = delivery.backoff_s()
        if self._metrics is not None:
            metrics_s = max(0.0, self._metrics_due_s - self._now_s())
            wait_s = metrics_s if wait_s is None else min(wait_s, metrics_s)
        news = asyncio.ensure_future(delivery.wake.wait())
        loss = asyncio.ensure_future(link.lost())
        try:
            await asyncio.wait((news, loss), return_when=asyncio.FIRST_COMPLETED, timeout=wait_s)
        finally:
            news.cancel()
            loss.cancel()
            await asyncio.gather(news, loss, return_exceptions=True)
        if not loss.cancelled():
            loss.result()
            raise PublishError("connection lost")

    async def _send_metrics(self, link: Link) -> None:
        if self._metrics is None or self._now_s() < self._metrics_due_s:
            return
        self._metrics_due_s = self._now_s() + METRICS_PERIOD_S
        await link.send([await asyncio.to_thread(self._metrics_message, self._metrics)])

    def _metrics_message(self, make: MetricsMessage) -> Outgoing:
        counts = {"waiting": self._unpublished_count(), **asdict(self.counts)}
        return make({f"outbox_{name}_count": count for name, count in counts.items()})

    @property
    def _arrived_count(self) -> int:
        """How many results have arrived, those not counted that were sent again."""
        return self.counts.acknowledged - self.counts.repeated

    def _unpublished_count(self) -> int:
        return self._state.store.unpublished_count(self._state.vehicle)

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()

    async def _note_failure(self, exc: PublishError | StoreFullError) -> None:
        self.counts.failure += 1
        self._state.fleet_is_heard.set()  # a log does not wait for a broker that is away
        if self._is_down:
            return
        self._is_down = True
        waiting = await asyncio.to_thread(self._unpublished_count)
        _LOG.warning("broker %s: %s; %d results wait in the store, trying again", self._where, exc, waiting)

    async def _pause(self, failure_count: int) -> None:
        """Wait longer after each failure, at random so that a fleet does not come back as one; ``close`` ends it."""
        longest_s = min(self.limits.longest_pause_s, self.limits.first_pause_s * 2.0 ** min(failure_count, 10))
        pause_s = longest_s * (0.5 + 0.5 * random.random())  # noqa: S311 - spreads load, guards nothing
        with suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._closing.wait()
