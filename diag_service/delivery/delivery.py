"""One connection's worth of delivery: batches out, receipts in, and again what nobody acknowledged."""

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from itertools import islice, takewhile
from operator import itemgetter
from typing import Final

from canlog.errors import NOTICE
from clutch_results.clocks import nanoseconds
from clutch_results.records import (
    FluidFill,
    ShiftResult,
    StoredResult,
    Tier,
    clutch_record,
    fill_record,
    iso_utc,
    parse_shift,
    shift_record,
)
from clutch_results.shifting import shifting_of, unknown_friction_words
from diag_service.delivery.reporters import DeliveryLimits, Link
from diag_service.diagnosis.summary import is_relative, latest_of, of_present_fluid, order_by
from diag_service.errors import PublishError, PublishRefusedError
from diag_service.store import ResultStore
from fleet_contract import Outcome, Outgoing, Receipt, bundle_messages, clutch_message, fluid_message, raw_shift_message

_BACKLOG_SHARE: Final = 4  # one of so many results of a batch is backlog, however much comes in
BATCH: Final = 200
MOST_TOLD: Final = 200  # newest results that say how a vehicle without friction shifts
_MAX_PUBLISHED: Final = 1000  # results that are remembered after a broker acknowledged them
_LOG = logging.getLogger(__name__)


class Bundling:
    """What an outbox knows of bundles, from one connection to the next."""

    def __init__(self, store: ResultStore, *, is_allowed: bool) -> None:
        self._store = store
        self._is_allowed = is_allowed  # where the word of a backend counts
        self._is_taken = False  # by the backend, as it said last
        self._is_proven = False  # over this connection: some arrived
        self._has_failed = False  # over this connection
        self._has_broken = False  # the last connection, before a bundle arrived: the next one goes without
        self._in_flight: set[int] = set()  # positions that went in bundles

    def begin(self) -> None:
        """Begin with a new connection; reads the store."""
        self._is_taken = self._is_allowed and self._store.takes_bundles()
        self._is_proven = False
        self._has_failed, self._has_broken = self._has_broken, False
        self._in_flight.clear()

    def packed(self, groups: Iterable[Sequence[StoredResult]]) -> list[Outgoing]:
        """Return the messages of results; those of one group may travel together."""
        is_on = self._is_taken and not self._has_failed
        messages: list[Outgoing] = []
        for group in groups:
            alone = [raw_shift_message(row.key, row.produced_at, row.text) for row in group]
            messages += bundle_messages(alone) if is_on else alone
            note = self._in_flight.update if is_on and len(group) > 1 else self._in_flight.difference_update
            note(row.position for row in group)
        return messages

    def note_word(self, *, is_taken: bool) -> None:
        """Note what the backend says; writes into the store if that is new."""
        if self._is_allowed and is_taken != self._is_taken:
            self._is_taken = is_taken
            self._store.note_takes_bundles(is_taken=is_taken)

    def note_arrived(self, positions: Iterable[int]) -> None:
        """Note that the backend has acknowledged results."""
        arrived = self._in_flight.intersection(positions)
        if arrived:
            self._in_flight -= arrived
            self._is_proven = True

    def note_broken(self, positions: Iterable[int], *, refusal: str | None = None) -> bool:
        """Return whether there were bundles among results whose sending failed."""
        lost = self._in_flight.intersection(positions)
        if not lost:
            return False
        self._in_flight -= lost
        self._has_failed, self._has_broken = True, not self._is_proven
        if refusal is not None:
            _LOG.warning("results go one by one: %s", refusal)
        return True


class InFlight:
    """Results that were sent and not acknowledged, by position; times are those of the event loop [s]."""

    def __init__(self) -> None:
        self._sent_s: dict[int, float] = {}  # the longest in flight first
        self._landed_s = float("-inf")  # when the youngest acknowledged result was sent

    def __len__(self) -> int:
        return len(self._sent_s)

    def add(self, positions: Iterable[int], now_s: float) -> None:
        """Note that results were sent."""
        self._sent_s.update(dict.fromkeys(positions, now_s))

    def acknowledge(self, positions: Iterable[int]) -> None:
        for position in positions:
            self._landed_s = max(self._landed_s, self._sent_s.pop(position, self._landed_s))

    def pop_sent_until(self, limit_s: float) -> list[int]:
        """Remove and return what was sent until a moment."""
        return self._pop(takewhile(lambda position: self._sent_s[position] <= limit_s, self._sent_s))

    def pop_oldest(self, count: int) -> list[int]:
        """Remove and return some of what has waited longest."""
        return self._pop(islice(self._sent_s, count))

    def lag_s(self, now_s: float) -> float:
        """Return how long the backend has had the oldest result that is younger than all it acknowledged."""
        return now_s - next((sent_s for sent_s in self._sent_s.values() if sent_s > self._landed_s), now_s)

    def oldest_s(self) -> float | None:
        """Return when the result was sent that has waited longest; None: nothing is in flight."""
        return next(iter(self._sent_s.values()), None)

    def _pop(self, positions: Iterable[int]) -> list[int]:
        removed = list(positions)
        for position in removed:
            del self._sent_s[position]
        return removed


class SendPriority:
    """In which order one connection sends what waits; each result is handed out once.

    Results stored since the connection began go first: what happens now does not wait behind what happened in the
    tunnel. What waited before is the backlog: its oldest results take a share of each batch.
    """

    def __init__(self, store: ResultStore, vehicle: str) -> None:
        self._store = store
        self._vehicle = vehicle
        self._began = store.last_position(vehicle)
        self._fresh = self._began  # handed out up to here
        self._old = 0  # and of the backlog up to here

    def next(self, limit: int) -> list[StoredResult]:
        """Return what is sent next, ``limit`` results at most; none if nothing is left."""
        reserved = limit // _BACKLOG_SHARE if self._old < self._began else 0
        fresh = self.next_fresh(limit - reserved)
        return fresh + self._backlog(limit - len(fresh))

    def groups(self, rows: Sequence[StoredResult]) -> list[list[StoredResult]]:
        """Return what may travel together: what happens now does not wait for as long as a backlog takes on air."""
        fresh = [row for row in rows if row.position > self._began]
        return [fresh, [row for row in rows if row.position <= self._began]]

    def next_fresh(self, limit: int) -> list[StoredResult]:
        """Return what came since the connection began, and nothing of the backlog."""
        rows = self._store.waiting(self._vehicle, after=self._fresh, limit=limit)
        if rows:
            self._fresh = rows[-1].position
        return rows

    def _backlog(self, limit: int) -> list[StoredResult]:
        if self._old >= self._began or limit < 1:
            return []
        rows = self._store.waiting(self._vehicle, after=self._old, before=self._began + 1, limit=limit)
        self._old = rows[-1].position if len(rows) == limit else self._began
        return rows


class FluidExchange:
    """What both sides know, as long as one link lasts; each fill is noted once, so nothing goes in circles."""

    def __init__(self, state: "OutboxState", link: Link, wake: asyncio.Event) -> None:
        self._store = state.store
        self._vehicle = state.vehicle
        self._link = link
        self._wake = wake  # set when there is something to note
        self._is_noted = state.fleet_is_heard
        self._is_answered = False
        self._heard: list[FluidFill] = []
        self._told: list[FluidFill] = []

    async def note(self) -> None:
        """Note what the fleet told; the next shift finds it in the store."""
        fills, self._heard = self._heard, []
        if fills and (count := await asyncio.to_thread(self._store.add_fills, fills)):
            _LOG.log(NOTICE, "the fleet told of %d change(s) of fluid fills", count)
        if self._is_answered:
            self._is_noted.set()

    async def tell(self) -> None:
        """Tell the fleet what the vehicle knows, unless this link has carried the same before."""
        fills = await asyncio.to_thread(self._store.all_fills, self._vehicle)
        if fills == self._told:
            return
        self._told = fills
        records = [fill_record(fill) for fill in fills]
        try:
            await self._link.send(
                [fluid_message(self._vehicle, iso_utc(datetime.now(UTC)), records, is_to_vehicle=False)]
            )
        except PublishError as exc:  # of a connection that is lost the next message tells
            _LOG.warning("the fleet was not told of fluid fills: %s", exc)

    def hear(self, fills: list[FluidFill], *, is_answer: bool = True) -> None:
        """Take what the fleet tells, now or through the broker from before."""
        self._heard += fills
        self._is_answered |= is_answer
        self._wake.set()


class Acknowledge(StrEnum):
    """Whose word lets the outbox forget a result."""

    BROKER = "broker"  # who may lose it: enough for subscribers that only watch
    BACKEND = "backend"  # given after the commit of its database


@dataclass(slots=True)
class Counts:
    """What an outbox did; metrics name the counts so."""

    sent: int = 0  # repetitions included
    repeated: int = 0
    acknowledged: int = 0
    quarantined: int = 0  # acknowledged, but of no use to the backend
    failure: int = 0  # connections that broke, or were refused


@dataclass(slots=True, kw_only=True)
class OutboxState:
    """What an outbox is to do, and what it remembers from one connection to the next."""

    store: ResultStore
    vehicle: str
    acknowledge: Acknowledge
    limits: DeliveryLimits
    bundling: Bundling
    holds_states: bool  # whether the states of clutches must not be sent yet
    fleet_is_heard: threading.Event = field(default_factory=threading.Event)  # its fills are in the store
    counts: Counts = field(default_factory=Counts)
    repeat: dict[int, None] = field(default_factory=dict)  # positions that a connection may have lost, in order
    published: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=_MAX_PUBLISHED))  # when, position

    def note_published(self, positions: Sequence[int], now_s: float) -> None:
        """Remember for a while what a broker acknowledged: it does so before its subscribers or its disk have it."""
        self._forget_settled(now_s)
        self.published.extend((now_s, position) for position in positions)

    def resend_published(self, now_s: float) -> None:
        """Send again, over the next connection, what a broker acknowledged just before this one broke."""
        self._forget_settled(now_s)
        self.repeat.update((position, None) for _, position in self.published)
        self.published.clear()

    def _forget_settled(self, now_s: float) -> None:
        while self.published and now_s - self.published[0][0] > self.limits.settled_after_s:
            self.published.popleft()


class Deliverer:
    """Sends what waits over one link; takes what it sends out of what the outbox is to repeat."""

    def __init__(self, state: OutboxState, link: Link) -> None:
        self._state = state
        self._link = link
        self._are_states_held = False  # whether some were to be sent and were not
        self._priority: SendPriority | None = None  # not begun
        self._inbox: list[Receipt] = []
        self._takes_bundles = False  # who gave the last of them
        self._in_flight = InFlight()
        self._resend_s = state.limits.resend_after_s
        self._has_news = False  # since results were last found overdue
        self._is_silent = False
        self._asked_s = 0.0  # when a silent backend was last asked [s of the loop]
        self._newest: dict[int, tuple[int, ShiftResult]] = {}  # of each clutch, and its position
        self._told: dict[str, bytes] = {}  # topic of the state of a clutch -> what was sent there
        self.wake = asyncio.Event()  # set when there is something new to do
        self._fluid = FluidExchange(state, link, self.wake)

    async def begin(self, greetings: Sequence[Outgoing]) -> None:
        """Tell the lasting states, which a restarted broker may not know, and begin to hear the backend."""
        if self._state.acknowledge is Acknowledge.BACKEND:
            await self._link.listen(self._state.vehicle, self._add_receipts)
        await self._link.hear_fills(self._state.vehicle, self._fluid.hear)
        await asyncio.to_thread(self._state.bundling.begin)
        latest = await asyncio.to_thread(self._state.store.ends, self._state.vehicle)
        messages = [*greetings, *await asyncio.to_thread(self._states, latest)]
        if messages:
            await self._link.send(messages)
        await self._fluid.note()
        await self._fluid.tell()

    async def step(self) -> bool:
        """Do what there is to do; False if nothing is left but to wait."""
        self.wake.clear()
        await self._note_receipts()
        await self._send_held_states()
        await self._fluid.note()
        batch, messages = await asyncio.to_thread(self._next_messages, self._now_s())
        told_before, states = self._told.copy(), await asyncio.to_thread(self._states, batch)
        if not batch:
            await self._fluid.tell()
            if states:
                await self._link.send(states)
            return False
        positions = [row.position for row in batch]
        if not await self._sent([*messages, *states], positions):
            self._told = told_before
            return True
        self._state.counts.sent += len(batch)
        for position in positions:
            self._state.repeat.pop(position, None)
        if self._state.acknowledge is Acknowledge.BACKEND:
            self._in_flight.add(positions, self._now_s())
            return True
        await asyncio.to_thread(self._state.store.mark_published, positions)
        self._state.counts.acknowledged += len(positions)
        self._state.note_published(positions, self._now_s())
        return True

    async def _sent(self, messages: Sequence[Outgoing], positions: Sequence[int]) -> bool:
        """Send results and states; False if the broker refuses bundles: what was in them goes alone, and next."""
        try:
            await self._link.send(messages)
        except PublishError as exc:
            refusal = str(exc) if isinstance(exc, PublishRefusedError) else None
            if self._state.bundling.note_broken(positions, refusal=refusal):
                self._state.repeat.update(dict.fromkeys(positions))
                if refusal is not None:
                    return False
            raise
        return True

    async def _send_held_states(self) -> None:
        if self._are_states_held and not self._state.holds_states:
            self._are_states_held = False
            latest = await asyncio.to_thread(self._state.store.ends, self._state.vehicle)
            await self._link.send(await asyncio.to_thread(self._states, latest))

    @property
    def awaits_receipts(self) -> bool:
        """Whether receipts are outstanding, or heard and not noted."""
        return bool(len(self._in_flight) or self._inbox)

    def backoff_s(self) -> float | None:
        """Return how long to wait until something must be sent again; None: for ever."""
        due_s = self._due_s()
        return None if due_s is None else max(0.0, due_s - self._now_s())

    def _add_receipts(self, receipts: list[Receipt], *, takes_bundles: bool = False) -> None:
        self._inbox += receipts
        self._takes_bundles = takes_bundles
        self.wake.set()

    async def _note_receipts(self) -> None:
        """Note the receipts heard since the last step, in one transaction."""
        if not self._inbox:
            return
        receipts, self._inbox = self._inbox, []
        await asyncio.to_thread(self._state.bundling.note_word, is_taken=self._takes_bundles)
        positions = await asyncio.to_thread(self._state.store.note_receipts, receipts)
        self._in_flight.acknowledge(positions)
        self._state.bundling.note_arrived(positions)
        for position in positions:
            self._state.repeat.pop(position, None)
        self._state.counts.acknowledged += len(positions)
        if refused := [receipt for receipt in receipts if receipt.outcome is Outcome.QUARANTINED]:
            self._state.counts.quarantined += len(refused)
            key, reason = refused[0].key.text, refused[0].reason
            _LOG.warning("the backend put aside %d results, the first %s: %s", len(refused), key, reason)
        if self._is_silent:
            _LOG.log(NOTICE, "the backend acknowledges results again")
        self._resend_s, self._asked_s = self._state.limits.resend_after_s, 0.0
        self._has_news, self._is_silent = True, False

    def _next_messages(self, now_s: float) -> tuple[list[StoredResult], list[Outgoing]]:
        """Return what is sent next, and the messages of it; what is sent again goes alone. Reads the store."""
        if self._priority is None:
            self._priority = SendPriority(self._state.store, self._state.vehicle)
        self._collect_overdue(now_s)
        again = self._next_repeated()
        if again:
            return again, self._state.bundling.packed([row] for row in again)
        rows = self._next_waiting(self._priority, now_s)
        return rows, self._state.bundling.packed(self._priority.groups(rows))

    def _next_waiting(self, priority: SendPriority, now_s: float) -> list[StoredResult]:
        room = self._state.limits.window_count - len(self._in_flight)
        if room > 0 and self._in_flight.lag_s(now_s) < self._state.limits.backlog_lag_s:
            return priority.next(min(BATCH, room))
        # The backend is behind; what happens now does not wait until it has caught up.
        return priority.next_fresh(min(BATCH, self._state.limits.window_count + room))

    def _next_repeated(self) -> list[StoredResult]:
        while self._state.repeat:
            again = list(islice(self._state.repeat, BATCH))
            rows = self._state.store.stored(again)
            for position in set(again).difference(row.position for row in rows):  # dropped for the disk budget
                del self._state.repeat[position]
            if rows:
                self._state.counts.repeated += len(rows)
                return rows
        return []

    def _collect_overdue(self, now_s: float) -> None:
        """Send again what was sent too long ago; while the backend is silent only a few, to ask."""
        due_s = self._due_s()
        if due_s is None or due_s > now_s:
            return
        if self._has_news:
            overdue = self._in_flight.pop_sent_until(now_s - self._resend_s)
            self._has_news = False
        else:
            self._note_silence(now_s)
            overdue = self._in_flight.pop_oldest(self._state.limits.probe_count)
        self._state.repeat.update(dict.fromkeys(overdue))

    def _due_s(self) -> float | None:
        """Return when something must be sent again; None: nothing is in flight."""
        oldest_s = self._in_flight.oldest_s()
        return None if oldest_s is None else max(oldest_s, self._asked_s) + self._resend_s

    def _note_silence(self, now_s: float) -> None:
        if self._is_silent:
            self._resend_s = min(2.0 * self._resend_s, self._state.limits.longest_resend_s)
        else:
            _LOG.warning(
                "no backend acknowledged %d results in %g s; they are kept and sent again",
                len(self._in_flight),
                self._state.limits.resend_after_s,
            )
        self._is_silent, self._asked_s = True, now_s

    def _states(self, rows: Sequence[StoredResult]) -> list[Outgoing]:
        """Return the states of clutches that are not as they were told, unless all are held. Reads the store.

        Both hold the order for the vehicle, so a result of one clutch, or new fluid, may change what the other is told.
        """
        if self._state.holds_states:
            self._are_states_held = True
            return []
        made_by = {(result.algorithm_version, result.calibration_version) for _, result in self._newest.values()}
        if len(made_by | {(row.key.algorithm_version, row.key.calibration_version) for row in rows}) > 1:
            self._newest, rows = {}, self._state.store.ends(self._state.vehicle)  # none but those made like the last
        now = iso_utc(datetime.now(UTC))
        today_ns, fluid = nanoseconds(now), self._state.store.fluid_at(self._state.vehicle, now)
        last = {(row.key.stream, row.clutch): row for row in sorted(rows, key=lambda result: result.position)}
        results = {row.position: parse_shift(row.text) for row in last.values()} | dict(self._newest.values())
        positions = {id(result): position for position, result in results.items()}
        for result in latest_of((results[position] for position in sorted(results)), today_ns):
            self._newest[result.estimate.clutch] = positions[id(result)], result
        known = [result for _, result in sorted(self._newest.values(), key=itemgetter(0))]
        order = order_by(known, fluid, today_ns=today_ns)
        shifting = self._shifting_words(known)
        states = (
            clutch_record(shift_record(result), order, shifting) for result in of_present_fluid(known, fluid, today_ns)
        )
        news = [message for message in map(clutch_message, states) if self._told.get(message.topic) != message.payload]
        self._told.update({message.topic: message.payload for message in news})
        return news

    def _shifting_words(self, known: Sequence[ShiftResult]) -> str | None:
        """Return how the vehicle shifts, by its newest events; None where friction is told. Reads the store."""
        if not known or all(result.estimate.tier is Tier.FRICTION for result in known):
            return None
        newest = (parse_shift(row.text) for row in self._state.store.newest(self._state.vehicle, MOST_TOLD))
        untold = [result for result in newest if result.estimate.tier is not Tier.FRICTION]
        return f"{unknown_friction_words(shifting_of(untold), is_relative=is_relative(untold))}."

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()
