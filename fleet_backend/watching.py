"""The watch: what is known of the fleet is held against the rules; alarms are written down and delivered, for ever."""

import asyncio
import logging
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from sqlalchemy import Engine

from fleet_backend import queries
from fleet_backend.alarms import book
from fleet_backend.alarms.book import Letter
from fleet_backend.alarms.carriers import Carrier, deliver_all
from fleet_backend.alarms.rules import (
    Finding,
    Limits,
    Transition,
    due_finding,
    quality_finding,
    silence_finding,
    transitions,
    verdict_finding,
)
from fleet_backend.errors import DatabaseError
from fleet_backend.page import past
from fleet_backend.page.keeper import DatabaseSource, Keeper
from fleet_backend.page.outlook import outlook_of
from fleet_backend.page.populations import latest
from fleet_backend.page.records import ClutchNow
from fleet_backend.page.vehicle_state import fills_of

ROUND_S: Final = 10.0
JUDGING_S: Final = 5.0  # of a round, for prognoses; what is left over is judged in the next, the worst first
DELIVERY_S: Final = 2.0
_AGEING: Final = "ageing"  # the outlook with which a prognosis has a trend
_LOG: Final = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """What a watch is to do."""

    carriers: Sequence[Carrier] = ()
    limits: Limits = field(default_factory=Limits)
    service_distance_m: float = 1.5e7


class Watch:
    """Holds the fleet against the rules; what it did not get to is judged in the next round."""

    def __init__(self, engine: Engine, orders: Orders, now: Callable[[], datetime]) -> None:
        self._engine = engine
        self._orders = orders
        self._now = now
        self._keeper = Keeper(DatabaseSource(engine))
        self._judged: dict[tuple[str, int], tuple[str, int, str]] = {}

    def round(self, judging_s: float = JUDGING_S) -> list[Transition]:
        """Look at everything once; return what was raised and cleared.

        Raises
        ------
        DatabaseError
            If the database does not answer; what is written stays, the rest follows in the next round.
        """
        self._keeper.refresh()
        now = self._now()
        names = [carrier.name for carrier in self._orders.carriers]
        steps = list(transitions(self._findings(now, judging_s), book.open_alarms(self._engine), now))
        written = book.write(self._engine, steps, names)
        for step in written:
            subject = step.subject
            _LOG.info("%s: %s of %s, clutch %d", step.event, subject.rule, subject.vehicle, subject.clutch)
        return written

    def deliver(self) -> int:
        """Deliver what waits; return how many messages arrived."""

        def settle(letter: Letter, complaint: str | None) -> None:
            if complaint is not None:
                _LOG.warning("%s; trying again (%s)", complaint, letter.key)
            book.settle(self._engine, letter, self._now(), complaint)

        def take(name: str) -> Letter | None:
            return book.take(self._engine, name, self._now())

        return sum(deliver_all(take, settle, carrier, self._now()) for carrier in self._orders.carriers)

    def _findings(self, now: datetime, judging_s: float) -> Iterator[Finding]:
        for one in self._keeper.snapshot.clutches:
            yield verdict_finding(one.vehicle, one.clutch, one.condition, one.advice or one.condition_reason)
        for record in queries.last_seen(self._engine):
            heard_at = record["last_result_at"] or record["connected_at"]
            if isinstance(heard_at, datetime):
                yield silence_finding(str(record["vehicle"]), heard_at, now, self._orders.limits)
        end_s = time.monotonic() + judging_s
        for one in self._keeper.snapshot.clutches:
            state = (one.stream, one.seq, one.algorithm_version)
            if self._judged.get((one.vehicle, one.clutch)) != state:
                yield from self._judge(one)
                self._judged[one.vehicle, one.clutch] = state
                if time.monotonic() >= end_s:
                    return

    def _judge(self, one: ClutchNow) -> Iterator[Finding]:
        """Yield what the past of a clutch says."""
        limits = self._orders.limits
        rows = past.results_of(self._engine, one.vehicle, one.clutch)
        fills = fills_of(self._engine, one.vehicle)
        last = rows[-limits.unused_events :]
        unused = sum(row["status"] == "rejected" for row in last)
        yield quality_finding(one.vehicle, one.clutch, unused, len(last), limits)
        kept, service_distance_m = latest(self._engine), self._orders.service_distance_m
        found, _ = outlook_of(one.clutch, rows, fills, service_distance_m, kept) if rows else (None, None)
        if found is not None:
            is_ageing = found.outlook == _AGEING and found.change_fluid is not None
            chance = found.change_fluid.probability_before_service if is_ageing and found.change_fluid else None
            yield due_finding(one.vehicle, one.clutch, chance, found.sentence, limits)


def run_watch(engine: Engine, orders: Orders, *, is_once: bool = False) -> None:
    """Watch until SIGINT or SIGTERM, or for one round in which everything is judged."""
    watch = Watch(engine, orders, lambda: datetime.now(UTC))
    if is_once:
        watch.round(judging_s=float("inf"))
        watch.deliver()
        return
    asyncio.run(_watch_until_told(watch))


async def _watch_until_told(watch: Watch) -> None:
    async with asyncio.TaskGroup() as tasks:
        work = [
            tasks.create_task(_repeat(watch.round, ROUND_S), name="rules"),
            tasks.create_task(_repeat(watch.deliver, DELIVERY_S), name="delivery"),
        ]
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, lambda: [one.cancel() for one in work])
        _LOG.info("watching")
        for one in work:
            with suppress(asyncio.CancelledError):
                await one


async def _repeat(step: Callable[[], object], pause_s: float) -> None:
    """Do a step for ever; a database that is away costs time."""
    is_told = False
    while True:
        try:
            await asyncio.to_thread(step)
            is_told = False
        except DatabaseError as exc:
            if not is_told:
                _LOG.warning("%s; trying again", exc)
            is_told = True
        await asyncio.sleep(pause_s)
