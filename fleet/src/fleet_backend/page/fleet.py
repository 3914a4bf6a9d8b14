"""The snapshot of the fleet, in memory: it is refreshed every two seconds, and lists are answered from it alone."""

import asyncio
import contextlib
import logging
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime, timedelta
from itertools import chain
from types import MappingProxyType
from typing import Any, Final

import anyio.to_thread
from prometheus_client.core import Metric

from clutchdiag_io.metrics import gauge
from fleet_backend.ageing.calibrations import type_of
from fleet_backend.ageing.peers import latest_population
from fleet_backend.ageing.prognosis import days_of, foretold_now
from fleet_backend.ageing.records import ClutchNow, Severity
from fleet_backend.ageing.results import levels_of
from fleet_backend.ageing.shifting import NOT_YET, words_of
from fleet_backend.errors import DatabaseError
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.queries import PresentFluid, Row
from fleet_backend.schema import FRICTION_TIER
from fleet_contract.orders import Action

PERIOD_S: Final = 2.0
REST_RATIO: Final = 19.0  # of the time that reading takes: at most a twentieth of a processor
LONGEST_REST_S: Final = 30.0
OVERLAP: Final = timedelta(seconds=10)  # a transaction that was open at the last refresh may have ended since
WHOLE_AFTER: Final = timedelta(minutes=15)  # all is read anew, whatever the marks say
SOON: Final = timedelta(days=30)
SILENT_AFTER: Final = timedelta(days=14)
AHEAD_S: Final = 0.5  # at a time
SEVERITY: Final[Mapping[str, int]] = {severity: place for place, severity in enumerate(Severity)}  # 0: the worst
WEEKS: Final = 8  # of the calendar, besides what is due now
MOST_WANTED: Final = 200  # vehicles of which a reader waits for how they shift: four parts of a list
_NO_LEVEL: Final = 9.0  # of the view fleet_worst_first
ByVehicle = Mapping[str, tuple[ClutchNow, ...]]
_NEVER: Final = datetime.min.replace(tzinfo=UTC)
_LOG: Final = logging.getLogger(__name__)


def place_of(now: ClutchNow) -> tuple[int, int, float, float, str, int]:
    """Return where a clutch stands in the fleet, as in the view fleet_worst_first: the smaller the worse.

    Behind all that are judged are those that will be, then those whose signals do not suffice.
    """
    falling = now.probability_negative_slope or 0.0
    tier = FRICTION_TIER if now.condition != Severity.NO_VERDICT else now.tier or FRICTION_TIER
    return SEVERITY[now.condition], tier, -falling, now.level_ratio or _NO_LEVEL, now.vehicle, now.clutch


def vehicle_type(now: ClutchNow) -> str:
    return type_of(now.vehicle, now.calibration_version)


def worse_clutch(clutches: Sequence[ClutchNow]) -> ClutchNow:
    """Return a vehicle as its worse clutch; distance, fluid, last event and tier are the vehicle's."""
    worst, last = min(clutches, key=place_of), max(clutches, key=lambda now: now.end_at)
    furthest_m = max((now.odometer_m for now in clutches if now.odometer_m is not None), default=None)
    return replace(worst, odometer_m=furthest_m, fluid=last.fluid, end_at=last.end_at, tier=last.tier)


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSnapshot:
    """The fleet at one moment."""

    clutches: tuple[ClutchNow, ...] = ()  # the worst first
    worst: tuple[ClutchNow, ...] = ()  # the worse clutch of each vehicle, the worst first
    read_at: datetime = _NEVER
    number: int = 0  # grows whenever something became different
    vehicles: ByVehicle = field(default_factory=lambda: MappingProxyType({}))
    fluids: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    strips: Mapping[str, Mapping[str, int]] = field(default_factory=lambda: MappingProxyType({}))  # verdicts by type
    alarmed: frozenset[str] = frozenset()  # vehicles with an open alarm
    due: frozenset[str] = frozenset()  # those whose fluid is due within a month
    silent: frozenset[str] = frozenset()  # those of which no result came for long
    untold: frozenset[str] = frozenset()  # those whose signals do not suffice for friction
    drawn: dict[object, Any] = field(init=False, default_factory=dict)  # answers made of it, by what was asked


Calendar = tuple[Sequence[ClutchNow], Sequence[tuple[str, Sequence[int]]]]


class Keeper:
    """Keeps the last snapshot; read from any thread, refreshed by one task."""

    def __init__(self, source: DatabaseSource) -> None:
        self._source = source
        self.snapshot = FleetSnapshot()  # the fleet as it was read last
        self._fills_mark: tuple[object, ...] = ()
        self._fluids: Mapping[str, PresentFluid] = {}
        self._whole_at = self.snapshot.read_at
        self._dues: dict[tuple[str, int], Row] = {}  # as the watch foretold them, or we
        self._dues_at = _NEVER
        self.dues_number = 0  # grows whenever one became different
        self._calendar: tuple[tuple[object, ...], Calendar] = ((), ((), ()))  # and of what
        # Levels, and the result up to which they are.
        self._curves: dict[tuple[str, int], tuple[tuple[object, ...], tuple[float, ...]]] = {}
        self._shiftings: dict[str, tuple[tuple[ClutchNow, ...], str | None]] = {}  # how vehicles shift, and of what
        self._wanted: deque[str] = deque(maxlen=MOST_WANTED)  # that somebody looked for, the newest last
        self.words_number = 0  # grows whenever one became different
        self._done: tuple[int, datetime] | None = None  # snapshot and dues for which all was worked out ahead
        self.complaint: str | None = None  # why the snapshot is older than it should be

    def refresh(self) -> bool:
        """Read what is new; return whether something is.

        Raises
        ------
        DatabaseError
            If the database does not answer or cannot be used; the last snapshot stays.
        """
        now, mark, last = self._source.now(), self._source.fills_mark(), self.snapshot
        fluids = self._fluids if mark == self._fills_mark else self._source.fluids()
        is_whole = now - self._whole_at >= WHOLE_AFTER
        if is_whole:
            fresh = _by_vehicle(self._source.all_clutches())
            names = sorted(fresh.keys() | last.vehicles.keys())
            changed = {name for name in names if fresh.get(name) != last.vehicles.get(name)}
        else:
            news = {name for name, fluid in fluids.items() if self._fluids.get(name) != fluid}
            news |= self._fluids.keys() - fluids.keys()
            names = sorted(news.union(self._source.vehicles_with_news(last.read_at - OVERLAP)))
            fresh = _by_vehicle(self._source.clutches_of(names) if names else ())
            changed = {name for name, clutches in fresh.items() if clutches != last.vehicles.get(name)}
        for row in self._source.dues(self._dues_at):
            self._dues[row["vehicle"], row["clutch"]] = row
            self.dues_number += 1
            self._dues_at = max(self._dues_at, row["judged_at"])
        alarmed = self._source.alarmed()
        self._fills_mark, self._fluids, self._whole_at = mark, fluids, now if is_whole else self._whole_at
        if changed or is_whole:
            self.snapshot = self._changed(fresh, changed, is_whole=is_whole)
        self.snapshot = replace(
            self.snapshot,
            read_at=now,
            alarmed=frozenset(alarmed) & self.snapshot.vehicles.keys(),
            due=self._soon(now),
            silent=self._silent(now),
        )
        return bool(changed)

    def _silent(self, now: datetime) -> frozenset[str]:
        heard = {clutch.vehicle for clutch in self.snapshot.clutches if clutch.stored_at >= now - SILENT_AFTER}
        return frozenset(self.snapshot.vehicles.keys() - heard)

    def _changed(self, fresh: ByVehicle, changed: set[str], *, is_whole: bool) -> FleetSnapshot:
        """Return the fleet with what was read of it: of changed vehicles, or of all."""
        last = FleetSnapshot() if is_whole else self.snapshot
        read = [clutches for name, clutches in fresh.items() if is_whole or name in changed]
        read_clutches = list(chain.from_iterable(read))
        clutches = [now for now in last.clutches if now.vehicle not in changed] + read_clutches
        worst = [now for now in last.worst if now.vehicle not in changed] + list(map(worse_clutch, read))
        strips: dict[str, Counter[str]] = {}
        for now in worst:
            strips.setdefault(vehicle_type(now), Counter())[now.condition] += 1
        return replace(
            self.snapshot,
            clutches=tuple(sorted(clutches, key=place_of)),
            worst=tuple(sorted(worst, key=place_of)),
            number=self.snapshot.number + (1 if changed else 0),
            vehicles=MappingProxyType({**last.vehicles, **fresh}),
            # Those of which nothing is left go when all is read.
            fluids=tuple(sorted({*last.fluids, *(now.fluid for now in read_clutches if now.fluid is not None)})),
            types=tuple(sorted(strips)),
            strips=MappingProxyType(strips),
            untold=frozenset(now.vehicle for now in worst if not now.tells_friction),
        )

    def foretold(self, now: ClutchNow) -> Row | None:
        """Return when the fluid of a clutch is due; None if that is not foretold for its present order and fluid."""
        row = self._dues.get((now.vehicle, now.clutch))
        return row if row is not None and (row["action"], row["fluid_since"]) == (now.action, now.fluid_since) else None

    def calendar(self, today: date) -> Calendar:
        """Return the clutches by the day from which their fluid is due, and by type how many vehicles are due when.

        Overdue clutches are first, those without a day last. Vehicles are counted that are due now, in this week and
        the next ones, later and without a day; the largest type is first.
        """
        mark = (self.snapshot.number, self.dues_number, today)
        if self._calendar[0] != mark:
            self._calendar = mark, self._calendar_of(self.snapshot, today)
        return self._calendar[1]

    def _calendar_of(self, snapshot: FleetSnapshot, today: date) -> Calendar:
        days = {(now.vehicle, now.clutch): days_of(now, self.foretold(now), today) for now in snapshot.clutches}

        def place(now: ClutchNow) -> tuple[bool, date, int, str, int]:
            is_overdue, day = days[now.vehicle, now.clutch]
            return not is_overdue, day or date.max, SEVERITY[now.condition], now.vehicle, now.clutch

        monday, lanes = today - timedelta(days=today.weekday()), dict[str, list[int]]()
        for now in snapshot.worst:
            is_overdue, day = days[now.vehicle, now.clutch]
            week = WEEKS + 1 if day is None else min((day - monday).days // 7, WEEKS)
            column = 0 if is_overdue or (day is not None and day <= today) else 1 + week
            lanes.setdefault(vehicle_type(now), [0] * (WEEKS + 3))[column] += 1
        largest_first = sorted(lanes.items(), key=lambda lane: (-sum(lane[1]), lane[0]))
        return sorted(snapshot.clutches, key=place), largest_first

    def curve(self, now: ClutchNow) -> tuple[float, ...]:
        """Return levels of a clutch against new fluid, the latest last; empty: not read yet."""
        return self._curves.get((now.vehicle, now.clutch), ((), ()))[1]

    def with_shifting(self, now: ClutchNow) -> ClutchNow:
        """Return a vehicle with how it shifts, in a sentence, if it cannot tell friction."""
        if now.tells_friction:
            return now
        told = self._shiftings.get(now.vehicle, ((), None))[1]
        if told is None:
            self._wanted.append(now.vehicle)
        return replace(now, shifting=told or NOT_YET)

    @property
    def mark(self) -> int:
        """What differs once anything that lists show of vehicles became different."""
        return (self.snapshot.number << 24) + self.words_number

    def work_ahead(self, budget_s: float) -> None:
        """Foretell when fluids are due, where the watch has not, read levels, tell how vehicles shift: the worst first.

        What a reader was shown without how it shifts is told before all. It ends after ``budget_s``, with one vehicle
        at least. Later days of the watch replace those foretold here.
        """
        end_s, mark = time.monotonic() + budget_s, (self.snapshot.number, self._dues_at)
        if mark == self._done:
            return
        while self._wanted:
            if self._tell_shifting(self._wanted.pop()) and time.monotonic() >= end_s:
                return
        for worst in self.snapshot.worst:
            vehicle, clutches, last = worst.vehicle, self.snapshot.vehicles[worst.vehicle], (worst.stream, worst.seq)
            is_stale = any((row := self.foretold(now)) is None or row.get("of", now) != now for now in clutches)
            if is_stale:
                rows = foretold_now(self._source.engine, clutches, latest_population(self._source.engine))
                for now, row in zip(clutches, rows, strict=True):
                    self._dues[vehicle, now.clutch] = {**row, "of": now}
                self.dues_number += 1
            is_old = self._curves.get((vehicle, worst.clutch), ((), ()))[0] != last
            if is_old:
                self._curves[vehicle, worst.clutch] = last, levels_of(self._source.engine, vehicle, worst.clutch)
            is_told = not worst.tells_friction and self._tell_shifting(vehicle)
            if (is_stale or is_old or is_told) and time.monotonic() >= end_s:
                return
        self._done = mark

    def _tell_shifting(self, vehicle: str) -> bool:
        """Tell in a sentence how a vehicle shifts; return whether there was something new to tell."""
        clutches = self.snapshot.vehicles.get(vehicle, ())
        if not clutches or self._shiftings.get(vehicle, ((), None))[0] == clutches:
            return False
        self._shiftings[vehicle] = clutches, words_of(self._source.engine, clutches)
        self.words_number += 1
        return True

    def _soon(self, now: datetime) -> frozenset[str]:
        """Return the vehicles whose fluid is due within a month, more probably than not."""
        last_day = (now + SOON).date()

        def is_due(clutch: ClutchNow) -> bool:
            row = self.foretold(clutch)
            day = None if row is None else row["half_by"]
            return clutch.action == Action.CHANGE_NOW or (day is not None and day <= last_day)

        return frozenset(clutch.vehicle for clutch in self.snapshot.clutches if is_due(clutch))

    async def run(self, period_s: float = PERIOD_S) -> None:
        """Refresh for ever; the longer reading takes, the longer is the pause behind it."""
        pause_s = period_s
        while True:
            await asyncio.sleep(pause_s)
            began_s = time.monotonic()
            await self.look()
            pause_s = max(period_s, min(REST_RATIO * (time.monotonic() - began_s), LONGEST_REST_S))

    async def look(self) -> None:
        """Refresh once, in a thread; what goes wrong is kept to be shown."""
        try:
            await asyncio.to_thread(self.refresh)
        except DatabaseError as exc:
            if self.complaint is None:
                _LOG.warning("%s; trying again", exc)
            self.complaint = str(exc)
            return
        self.complaint = None

    async def work(self) -> None:
        """Work ahead for ever, a third of the time, while no reader waits for an answer."""
        readers = anyio.to_thread.current_default_thread_limiter()
        while True:
            if not readers.borrowed_tokens:
                with contextlib.suppress(DatabaseError):
                    await asyncio.to_thread(self.work_ahead, AHEAD_S)
            await asyncio.sleep(2.0 * AHEAD_S)


def fleet_families(keeper: Keeper) -> Iterator[Metric]:
    """Yield how large the fleet is and how old is what is known of it."""
    snapshot = keeper.snapshot
    conditions = Counter(now.condition for now in snapshot.clutches)
    counts = {severity.value: conditions[severity.value] for severity in Severity}
    yield gauge("fleet_vehicles", "Vehicles with results.", len(snapshot.vehicles))
    yield gauge("fleet_clutches", "Clutches by the verdict that holds.", counts, "verdict")
    yield gauge("fleet_read_timestamp_seconds", "When the fleet was read last.", snapshot.read_at.timestamp())


def _by_vehicle(clutches: Sequence[ClutchNow]) -> ByVehicle:
    by_vehicle: dict[str, list[ClutchNow]] = {}
    for now in clutches:
        by_vehicle.setdefault(now.vehicle, []).append(now)
    return {vehicle: tuple(sorted(rows, key=lambda now: now.clutch)) for vehicle, rows in by_vehicle.items()}
