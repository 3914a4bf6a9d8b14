"""The outbox: forwards stored results to a broker in order, marks what it acknowledged, survives its absence.

A result that is not acknowledged stays unpublished in the store, so a slow, absent or refusing broker costs nothing but
time. A broker acknowledges before its subscribers or its disk have the message: what it acknowledged shortly before a
connection broke is sent again. Delivery is at least once; the key (vehicle, stream, seq, versions) tells a repetition.
"""

import asyncio
import logging
import random
from collections import deque
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Protocol

from diag_service.errors import PublishError
from diag_service.notices import NOTICE
from diag_service.publishers.base import Link
from diag_service.records import ShiftResult
from diag_service.results import StoredResult

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
DRAIN_S = 5.0  # how long an ending service waits for its broker
SETTLE_S = 5.0  # after this an acknowledged result is taken to be where it belongs
_ROWS_PER_READ = 100
_MAX_UNSETTLED = 1000

Connect = Callable[[], AbstractAsyncContextManager[Link]]
_LOG = logging.getLogger(__name__)


class OutboxStore(Protocol):
    """The part of the store that the outbox reads."""

    def unpublished(self, vehicle: str, limit: int) -> list[StoredResult]:
        """Return the oldest results that no broker has acknowledged."""

    def unpublished_count(self, vehicle: str) -> int:
        """Return how many results wait."""

    def mark_published(self, position: int) -> None:
        """Note an acknowledged result."""

    def latest_published(self, vehicle: str) -> list[ShiftResult]:
        """Return the last acknowledged result of each clutch."""


class Outbox:
    """Sends what the store holds for one vehicle, for as long as ``run`` runs.

    Parameters
    ----------
    connect :
        Opens a connection, or raises PublishError.
    where :
        The broker, for people; without credentials.
    """

    def __init__(self, store: OutboxStore, vehicle: str, connect: Connect, where: str) -> None:
        self._store = store
        self._vehicle = vehicle
        self._connect = connect
        self._where = where
        self._news = asyncio.Event()
        self._closing = asyncio.Event()
        self._is_down = False
        self._sent_count = 0  # over the present connection
        self._unsettled: deque[tuple[float, ShiftResult]] = deque(maxlen=_MAX_UNSETTLED)  # when, what

    def nudge(self) -> None:
        """Say that the store holds something new."""
        self._news.set()

    async def run(self) -> None:
        """Connect, send, reconnect; return after ``close`` once all is sent or a fresh attempt has sent nothing."""
        failure_count = 0
        while True:
            is_last_attempt = self._closing.is_set()
            self._sent_count = 0
            try:
                async with self._connect() as link:
                    failure_count = 0
                    await self._serve(link)
                    return
            except PublishError as exc:
                self._forget_settled()
                await self._note_failure(exc)
            if is_last_attempt and not self._sent_count:
                return
            await self._pause(failure_count)
            failure_count += 1

    async def close(self, sender: asyncio.Task[None], timeout_s: float = DRAIN_S) -> int:
        """Let ``sender``, the task of ``run``, send what is left, for a limited time; return what remains unsent."""
        self._closing.set()
        self._news.set()
        try:
            await asyncio.wait_for(sender, timeout_s)
        except TimeoutError:
            _LOG.info("broker %s did not take everything in %g s", self._where, timeout_s)
        return await asyncio.to_thread(self._store.unpublished_count, self._vehicle)

    async def _serve(self, link: Link) -> None:
        for result in await asyncio.to_thread(self._store.latest_published, self._vehicle):
            await link.refresh(result)
        await self._repeat_unsettled(link)
        while True:
            self._news.clear()
            await self._send_backlog(link)
            if self._closing.is_set():
                return
            await self._wait_for_news(link)

    async def _send_backlog(self, link: Link) -> None:
        while rows := await asyncio.to_thread(self._store.unpublished, self._vehicle, _ROWS_PER_READ):
            for row in rows:
                await link.publish(row.result)
                await asyncio.to_thread(self._store.mark_published, row.position)
                self._sent_count += 1
                self._forget_settled()
                self._unsettled.append((self._now_s(), row.result))
            if self._is_down:
                self._is_down = False
                _LOG.log(NOTICE, "broker %s takes results again", self._where)

    async def _repeat_unsettled(self, link: Link) -> None:
        for result in [result for _, result in self._unsettled]:
            await link.publish(result)
        again_s = self._now_s()
        self._unsettled = deque(((again_s, result) for _, result in self._unsettled), maxlen=_MAX_UNSETTLED)

    def _forget_settled(self) -> None:
        while self._unsettled and self._now_s() - self._unsettled[0][0] > SETTLE_S:
            self._unsettled.popleft()

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()

    async def _wait_for_news(self, link: Link) -> None:
        news = asyncio.ensure_future(self._news.wait())
        loss = asyncio.ensure_future(link.lost())
        try:
            await asyncio.wait((news, loss), return_when=asyncio.FIRST_COMPLETED)
        finally:
            news.cancel()
            loss.cancel()
            await asyncio.gather(news, loss, return_exceptions=True)
        if not loss.cancelled():
            raise PublishError("connection lost")

    async def _note_failure(self, exc: PublishError) -> None:
        if self._is_down:
            return
        self._is_down = True
        waiting = await asyncio.to_thread(self._store.unpublished_count, self._vehicle)
        _LOG.warning("broker %s: %s; %d results wait in the store, trying again", self._where, exc, waiting)

    async def _pause(self, failure_count: int) -> None:
        """Wait longer after each failure, at random so that a fleet does not come back as one; ``close`` ends it."""
        longest_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(failure_count, 10))
        pause_s = longest_s * (0.5 + 0.5 * random.random())  # noqa: S311 - spreads load, guards nothing
        try:
            await asyncio.wait_for(self._closing.wait(), pause_s)
        except TimeoutError:
            return
