"""Quotas of each vehicle for a day (UTC): messages beyond them are neither stored nor acknowledged.

A vehicle keeps results without a receipt and sends them again: none is lost, and no flood fills the database. Workers
add their counts every second.
"""

import asyncio
import logging
from collections.abc import Sequence
from dataclasses import replace
from datetime import date, datetime
from operator import add
from typing import Final

from sqlalchemy import Engine, case
from sqlalchemy.dialects import postgresql, sqlite

from fleet_backend.choices import Quotas
from fleet_backend.database import transaction
from fleet_backend.errors import DatabaseError
from fleet_backend.intake import MessageKind, Received
from fleet_backend.office_tables import INTAKE

SHARE_S: Final = 1.0
_COUNTS: Final = ("result_count", "quarantined_count", "byte_count", "withheld_count")
_ZERO: Final = (0,) * len(_COUNTS)
_MOST_KNOWN: Final = 100_000  # vehicles whose counts a worker remembers
_LOG: Final = logging.getLogger(__name__)

Counts = dict[str, list[int]]  # of vehicles, in the order of the names above


class QuotaGate:
    """Withholds messages beyond the quotas of their vehicle."""

    def __init__(self, engine: Engine, quotas: Quotas) -> None:
        self._engine = engine
        self._limits = (quotas.results, quotas.quarantined, quotas.size_bytes, 0)
        self._day = date.min
        self._known: Counts = {}  # of this day, those of other workers as of the last sharing
        self._news: Counts = {}  # the part of them that is not yet shared
        make = postgresql.insert if engine.dialect.name == "postgresql" else sqlite.insert
        insert, known = make(INTAKE), INTAKE.c
        added, is_new = insert.excluded, insert.excluded.day > known.day
        sums = {name: case((is_new, added[name]), else_=known[name] + added[name]) for name in _COUNTS}
        later = case((is_new, added.day), else_=known.day)
        self._add = insert.on_conflict_do_update(index_elements=["vehicle"], set_={**sums, "day": later}).returning(
            known.vehicle, *(known[name] for name in _COUNTS)
        )

    def judge(self, received: Sequence[Received], at: datetime) -> list[Received]:
        """Return messages as they came, those beyond a quota as withheld."""
        if at.date() != self._day or len(self._known) > _MOST_KNOWN:
            self._day, self._known = at.date(), {}
        return [self._judged(item) for item in received]

    def _judged(self, item: Received) -> Received:
        vehicle = str(item.row["vehicle"] or "")
        known, news = (counts.setdefault(vehicle, list(_ZERO)) for counts in (self._known, self._news))
        kinds = (MessageKind.SHIFT, MessageKind.POISON)
        more = [*(int(item.kind is kind) for kind in kinds), item.message.size_bytes, 0]
        counts_of = zip(self._limits, known, more, strict=True)
        if any(limit and count and before + count > limit for limit, before, count in counts_of):
            if not known[-1]:
                _LOG.warning("%s is beyond its quota of today: it keeps what is not taken", vehicle or "somebody")
            more = [0, 0, 0, 1]
            item = replace(item, kind=MessageKind.WITHHELD, fills=(), calibrations=(), revisions=(), receipt=None)
        for counts in (known, news):
            counts[:] = map(add, counts, more)
        return item

    async def share(self) -> None:
        """Add up with all workers every second, for ever."""
        while True:
            await asyncio.sleep(SHARE_S)
            await self.add_up()

    async def add_up(self) -> None:
        """Add this worker's new counts to those of all; if the database is away, they wait for the next time."""
        news, self._news = self._news, {}
        try:
            totals = await asyncio.to_thread(self._shared, self._day, news)
        except DatabaseError:  # logged where results are stored
            totals, self._news = {}, _added(news, self._news)
        self._known |= _added(totals, {name: self._news[name] for name in totals.keys() & self._news.keys()})

    def _shared(self, day: date, news: Counts) -> Counts:
        rows = [{"vehicle": name, "day": day, **dict(zip(_COUNTS, news[name], strict=True))} for name in sorted(news)]
        if not rows:
            return {}
        with transaction(self._engine) as connection:
            if self._engine.dialect.name == "postgresql":  # nothing waits for a disk: a lost second is none
                connection.exec_driver_sql("SET LOCAL synchronous_commit = off")
            return {name: list(counts) for name, *counts in connection.execute(self._add, rows)}


def _added(counts: Counts, more: Counts) -> Counts:
    """Return the sums of counts by vehicle."""
    return counts | {name: list(map(add, counts.get(name, _ZERO), more[name])) for name in more}
