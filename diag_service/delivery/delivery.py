"""One connection's worth of delivery: batches out, receipts in, and again what nobody acknowledged."""

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from typing import Final

from canlog.notice import NOTICE
from diag_service.delivery.base import DeliveryLimits, Link
from diag_service.delivery.in_flight import InFlight
from diag_service.diagnosis.results import StoredResult, clutch_record, parse_record
from diag_service.store import ResultStore
from fleet_contract import Outcome, Outgoing, Receipt, clutch_message, raw_shift_message

BATCH: Final = 200
_BACKLOG_SHARE: Final = 4  # one of so many results of a batch is backlog, however much comes in
_NEWEST_SHARE: Final = 4  # and one of so many of the backlog is its newest
_LOG = logging.getLogger(__name__)


class Acknowledge(StrEnum):
    """Whose word lets the outbox forget a result."""

    BROKER = "broker"  # who may lose it: enough for subscribers that only watch
    BACKEND = "backend"  # given after the commit of its database


@dataclass(slots=True)
class Counts:
    """What an outbox did, for metrics and people."""

    sent: int = 0  # repetitions included
    repeated: int = 0
    acknowledged: int = 0
    quarantined: int = 0  # acknowledged, but of no use to the backend
    failed: int = 0  # connections that broke, or were refused


class SendPriority:
    """In which order one connection sends what waits; each result is handed out once.

    Results stored since the connection began go first: what happens now is not to wait behind what happened in the
    tunnel. What waited before is the backlog: it is sent from its old end, and a share of each batch from its new end,
    so that the last hour is known long before the last day is through.
    """

    def __init__(self, store: ResultStore, vehicle: str) -> None:
        self._store = store
        self._vehicle = vehicle
        self._fresh = store.last_position(vehicle)  # handed out up to here
        self._old = 0
        self._new = self._fresh + 1  # handed out from here on

    def next(self, limit: int) -> list[StoredResult]:
        """Return what is sent next, ``limit`` results at most; none if nothing is left."""
        reserved = limit // _BACKLOG_SHARE if self._old + 1 < self._new else 0
        fresh = self.next_fresh(limit - reserved)
        return fresh + self._backlog(limit - len(fresh))

    def next_fresh(self, limit: int) -> list[StoredResult]:
        """Return what came since the connection began, and nothing of the backlog."""
        rows = self._store.waiting(self._vehicle, after=self._fresh, limit=limit)
        if rows:
            self._fresh = rows[-1].position
        return rows

    def _backlog(self, limit: int) -> list[StoredResult]:
        if self._old + 1 >= self._new or limit < 1:
            return []
        oldest = self._store.waiting(self._vehicle, after=self._old, before=self._new, limit=limit)
        if len(oldest) < limit:  # all that is left
            self._new = self._old + 1
            return oldest
        share = limit // _NEWEST_SHARE
        oldest = oldest[: limit - share]
        self._old = oldest[-1].position
        newest = self._store.waiting(self._vehicle, after=self._old, before=self._new, limit=share, newest_first=True)
        if newest:
            self._new = newest[-1].position
        return newest + oldest


class Delivery:
    """Sends what waits over one link.

    Parameters
    ----------
    repeat :
        Positions that earlier connections may have taken with them; those that are sent are taken out.
    published :
        Called with the positions that a broker acknowledged and that are therefore forgotten.
    holds_states :
        Whether the states of clutches must not be sent yet.
    """

    def __init__(
        self,
        store: ResultStore,
        vehicle: str,
        link: Link,
        *,
        acknowledge: Acknowledge,
        repeat: dict[int, None],
        published: Callable[[list[int]], None],
        counts: Counts,
        holds_states: Callable[[], bool] = lambda: False,
        limits: DeliveryLimits,
    ) -> None:
        self._store = store
        self._vehicle = vehicle
        self._link = link
        self._acknowledge = acknowledge
        self._repeat = repeat
        self._published = published
        self._counts = counts
        self._holds_states = holds_states
        self._are_states_held = False  # whether some were to be sent and were not
        self._priority: SendPriority | None = None  # not begun
        self._inbox: list[Receipt] = []
        self._limits = limits
        self._in_flight = InFlight(limits.astray_after_s)
        self._resend_s = limits.resend_after_s
        self._has_news = False  # since results were last found overdue
        self._is_silent = False
        self._asked_s = 0.0  # when a silent backend was last asked [s of the loop]
        self._state_position: dict[int, int] = {}  # clutch -> position of the newest result whose state was sent
        self.wake = asyncio.Event()  # set when there is something new to do

    async def begin(self, greetings: Sequence[Outgoing]) -> None:
        """Tell the lasting states, which a restarted broker may not know, and begin to hear the backend."""
        if self._acknowledge is Acknowledge.BACKEND:
            await self._link.listen(self._vehicle, self._add_receipts)
        latest = await asyncio.to_thread(self._store.latest, self._vehicle)
        messages = [*greetings, *self._states(latest)]
        if messages:
            await self._link.send(messages)

    async def step(self) -> bool:
        """Do what there is to do; False if nothing is left but to wait."""
        self.wake.clear()
        await self._note_receipts()
        await self._send_held_states()
        batch = await asyncio.to_thread(self._next_batch, self._now_s())
        if not batch:
            return False
        messages = [raw_shift_message(row.key, row.produced_at, row.text) for row in batch]
        await self._link.send(messages + self._states(batch))
        self._counts.sent += len(batch)
        positions = [row.position for row in batch]
        for position in positions:
            self._repeat.pop(position, None)
        if self._acknowledge is Acknowledge.BACKEND:
            self._in_flight.add(positions, self._now_s())
            return True
        await asyncio.to_thread(self._store.mark_published, positions)
        self._counts.acknowledged += len(positions)
        self._published(positions)
        return True

    async def _send_held_states(self) -> None:
        if self._are_states_held and not self._holds_states():
            self._are_states_held = False
            await self._link.send(self._states(await asyncio.to_thread(self._store.latest, self._vehicle)))

    @property
    def awaits_receipts(self) -> bool:
        """Whether receipts are outstanding, or heard and not noted."""
        return bool(len(self._in_flight) or self._inbox)

    def backoff_s(self) -> float | None:
        """Return how long to wait until something must be sent again; None: for ever."""
        due_s = self._due_s()
        return None if due_s is None else max(0.0, due_s - self._now_s())

    def _add_receipts(self, receipts: list[Receipt]) -> None:
        self._inbox += receipts
        self.wake.set()

    async def _note_receipts(self) -> None:
        """Note the receipts heard since the last step, in one transaction."""
        if not self._inbox:
            return
        receipts, self._inbox = self._inbox, []
        positions = await asyncio.to_thread(self._store.note_receipts, receipts)
        self._in_flight.acknowledge(positions)
        for position in positions:
            self._repeat.pop(position, None)
        self._counts.acknowledged += len(positions)
        self._complain_of([receipt for receipt in receipts if receipt.outcome is Outcome.QUARANTINED])
        if self._is_silent:
            _LOG.log(NOTICE, "the backend acknowledges results again")
        self._resend_s, self._asked_s = self._limits.resend_after_s, 0.0
        self._has_news, self._is_silent = True, False

    def _complain_of(self, refused: list[Receipt]) -> None:
        self._counts.quarantined += len(refused)
        if refused:
            key, reason = refused[0].key.text, refused[0].reason
            _LOG.warning("the backend put aside %d results, the first %s: %s", len(refused), key, reason)

    def _next_batch(self, now_s: float) -> list[StoredResult]:
        """Return what is sent next: what may be lost, what is overdue, what waits. Reads the store."""
        if self._priority is None:
            self._priority = SendPriority(self._store, self._vehicle)
        self._collect_overdue(now_s)
        again = self._next_repeated()
        if again:
            return again
        room = self._limits.window_count - len(self._in_flight)
        if room > 0 and self._in_flight.lag_s(now_s) < self._limits.backlog_lag_s:
            return self._priority.next(min(BATCH, room))
        # The backend is behind; what happens now does not wait until it has caught up.
        return self._priority.next_fresh(min(BATCH, self._limits.window_count + room))

    def _next_repeated(self) -> list[StoredResult]:
        while self._repeat:
            again = list(islice(self._repeat, BATCH))
            rows = self._store.stored(again)
            for position in set(again).difference(row.position for row in rows):  # dropped for the disk budget
                del self._repeat[position]
            if rows:
                self._counts.repeated += len(rows)
                return rows
        return []

    def _collect_overdue(self, now_s: float) -> None:
        """Take up again what went astray or was sent too long ago; of what meets with silence a few, to ask."""
        self._repeat.update(dict.fromkeys(self._in_flight.pop_astray()))
        due_s = self._due_s()
        if due_s is None or due_s > now_s:
            return
        if self._has_news:
            overdue = self._in_flight.pop_sent_until(now_s - self._resend_s)
            self._has_news = False
        else:
            self._note_silence(now_s)
            overdue = self._in_flight.pop_oldest(self._limits.probe_count)
        self._repeat.update(dict.fromkeys(overdue))

    def _due_s(self) -> float | None:
        """Return when something must be sent again; None: nothing is in flight."""
        oldest_s = self._in_flight.oldest_s()
        return None if oldest_s is None else max(oldest_s, self._asked_s) + self._resend_s

    def _note_silence(self, now_s: float) -> None:
        if self._is_silent:
            self._resend_s = min(2.0 * self._resend_s, self._limits.longest_resend_s)
        else:
            _LOG.warning(
                "no backend acknowledged %d results in %g s; they are kept and sent again",
                len(self._in_flight),
                self._limits.resend_after_s,
            )
        self._is_silent, self._asked_s = True, now_s

    def _states(self, rows: Sequence[StoredResult]) -> list[Outgoing]:
        """Return the states of clutches that these results leave, unless a newer one has been told or all are held."""
        if self._holds_states():
            self._are_states_held = True
            return []
        newest = {row.clutch: row for row in sorted(rows, key=lambda row: row.position)}
        news = [row for row in newest.values() if row.position > self._state_position.get(row.clutch, -1)]
        self._state_position.update({row.clutch: row.position for row in news})
        return [clutch_message(clutch_record(parse_record(row.text))) for row in news]

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()
