"""The watch: checks the fleet by the rules of alarms, writes what they raise and clear, and delivers messages."""

import asyncio
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Container, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Final, Protocol

from apprise import Apprise, AppriseAsset, NotifyFormat, NotifyType
from prometheus_client.core import Metric
from sqlalchemy import Engine, func, select

from clutch_results.prognosis import Population
from clutch_results.shift_course import fall_of
from clutchdiag_io.metrics import gauge
from fleet_backend import queries
from fleet_backend.ageing.calibrations import reference_of
from fleet_backend.ageing.peers import latest_population
from fleet_backend.ageing.prognosis import chance_of, foretold, outlook_text, read_past
from fleet_backend.ageing.records import ClutchNow, Severity
from fleet_backend.ageing.results import fills_of
from fleet_backend.alarms import book, rules
from fleet_backend.alarms.book import Letter
from fleet_backend.alarms.rules import AlarmEvent
from fleet_backend.config import ServerAddress
from fleet_backend.database import transaction
from fleet_backend.errors import BackendConfigError, CarrierError, DatabaseError
from fleet_backend.months import month_of, partitions
from fleet_backend.office_tables import ALARM_MESSAGE, INTAKE
from fleet_backend.page.fleet import Keeper, fleet_families
from fleet_backend.page.queries import (
    DatabaseSource,
    arrivals_of,
    keep_dues,
    marks_of_judged,
)
from fleet_backend.programs import metrics_served, until_stopped
from fleet_backend.queries import Row, is_alarming_since
from fleet_backend.schema import QUARANTINE
from fleet_contract.orders import name_of
from fleet_link import AddressError, read_secret

_LONGEST_WAIT_S: Final = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AppriseCarrier:
    """Hands messages to one address of apprise."""

    name: str
    apprise: Apprise = field(repr=False)

    def deliver(self, letter: Letter) -> None:
        """Deliver a message; raises CarrierError if it was not taken."""
        alarm, is_over = letter.payload, letter.payload["event"] == AlarmEvent.CLEARED
        whose = alarm["vehicle"] + (f", {name_of(alarm['clutch'], alarm['element'])}" if alarm["clutch"] else "")
        is_taken = self.apprise.notify(
            title=f"{'Alarm over' if is_over else 'Alarm'}: {whose}: {alarm['rule']}",
            body=f"{alarm['reason']}\n\n{alarm['at']}\n{letter.key}",
            body_format=NotifyFormat.TEXT,
            notify_type=NotifyType.SUCCESS if is_over else NotifyType.WARNING,
        )
        if not is_taken:
            raise CarrierError(f"{self.name}: not delivered")  # apprise has logged why


def read_carrier(path: Path) -> AppriseCarrier:
    """Return the carrier whose address is in a file, called like the file.

    Raises ConfigError, without the address: it may hold a secret.
    """
    try:
        address = read_secret(path)
    except AddressError as exc:
        raise BackendConfigError(str(exc)) from exc
    apprise = Apprise(asset=AppriseAsset(http_redirects=False, service_timeout=_LONGEST_WAIT_S))
    if not apprise.add(address) or len(apprise) != 1:
        raise BackendConfigError(f"{path} must hold one address that apprise knows")
    return AppriseCarrier(name=path.stem, apprise=apprise)


ROUND_S: Final = 10.0
JUDGING_S: Final = 5.0  # of a round, for prognoses; what is left over is judged in the next
ONCE_S: Final = 60.0  # the same where nothing waits for the round; what was found is delivered after each
DELIVERY_S: Final = 2.0
TURN_S: Final = 15.0  # of a carrier, for what waits for it
_LOG: Final = logging.getLogger(__name__)
Arrivals = tuple[datetime, int]  # when a result of a vehicle was stored last, and how many are
KnownVehicle = tuple[tuple[ClutchNow, ...], Arrivals | None]


class Carrier(Protocol):
    """Delivers messages of alarms."""

    @property
    def name(self) -> str:
        """Name under which deliveries are stored."""

    def deliver(self, letter: Letter) -> None:
        """Deliver a message; raises CarrierError if that did not work now."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Orders:
    """Carriers, limits and service distance of a watch."""

    carriers: Sequence[Carrier] = ()
    limits: rules.Limits = field(default_factory=rules.Limits)
    service_distance_m: float = 1.5e7


class Watch:
    """Judges the vehicles with news, in rounds; those that a round did not reach come in the next."""

    def __init__(
        self, engine: Engine, orders: Orders, now: Callable[[], datetime], *, shared: Keeper | None = None
    ) -> None:
        self._engine = engine
        self._orders = orders
        self._now = now
        self._is_sharing = shared is not None  # then others keep it fresh
        self._keeper = shared or Keeper(DatabaseSource(engine))
        self.is_over = False  # then no other message is taken
        self.waiting_count = 0  # vehicles with news that the last round did not get to
        self._metrics: tuple[Metric, ...] = ()  # of the last round
        self._judged: dict[str, KnownVehicle] = {}  # as they were then, those of the longest ago first
        self._is_reminded = False  # of what other processes have judged

    @property
    def has_judged_all(self) -> bool:
        """Whether the past of each vehicle was judged at least once."""
        return self._judged.keys() >= self._keeper.snapshot.vehicles.keys()

    def round(self, judging_s: float = JUDGING_S) -> list[rules.Transition]:
        """Judge the fleet once; return the alarms that were raised and cleared.

        Raises DatabaseError if the database does not answer; what is written stays, the rest follows in the next round.

        Parameters
        ----------
        judging_s :
            How long pasts are judged; then one vehicle is done with, and the others wait.
        """
        began_s = time.monotonic()
        if not self._is_sharing:
            self._keeper.refresh()
        now = self._now()
        names = [carrier.name for carrier in self._orders.carriers]
        open_subjects = book.open_alarms(self._engine)
        quotas = rules.quota_findings(self._withheld(now), open_subjects)
        retired = rules.retired_findings(open_subjects)
        arrivals, dues = arrivals_of(self._engine), dict[str, list[Row]]()
        known = {name: (clutches, arrivals.get(name)) for name, clutches in self._keeper.snapshot.vehicles.items()}
        pasts = self._pasts(known, judging_s, dues)
        findings = chain(quotas, retired, self._findings(now, open_subjects, arrivals), pasts)
        steps = list(rules.transitions(findings, open_subjects, now))
        written = book.write(self._engine, steps, names)
        keep_dues(self._engine, dues, self._now())  # only now: what is marked as judged is not judged again
        for name in dues:
            self._judged.pop(name, None)
            self._judged[name] = known[name]
        for step in written:
            _LOG.info("%s: %s of %s", step.event, step.subject.rule, step.subject)
        self._metrics = tuple(self._round_families(now, arrivals, began_s))
        return written

    def families(self) -> Iterator[Metric]:
        """Yield what the last round found, none before the first, and how large the fleet is."""
        yield from fleet_families(self._keeper)
        yield from self._metrics

    def _round_families(self, now: datetime, arrivals: Mapping[str, Arrivals], began_s: float) -> Iterator[Metric]:
        open_counts = dict.fromkeys((rule.value for rule in rules.AlarmRule), 0)
        open_counts |= Counter(subject.rule.value for subject in book.open_alarms(self._engine))
        yield gauge("fleet_open_alarms", "Alarms that are not cleared, by their rule.", open_counts, "rule")
        is_ours = ALARM_MESSAGE.c.carrier.in_([carrier.name for carrier in self._orders.carriers])  # no former ones
        waiting = select(func.count()).select_from(ALARM_MESSAGE).where(ALARM_MESSAGE.c.delivered_at.is_(None), is_ours)
        reason = QUARANTINE.c.reason
        aside = select(reason, func.count()).where(QUARANTINE.c.acknowledged_at.is_(None)).group_by(reason)
        with transaction(self._engine) as connection:
            waiting_count = connection.execute(waiting).scalar_one()
            aside_counts = {str(key): count for key, count in connection.execute(aside)}
        yield gauge("watch_undelivered_messages", "Messages of alarms that wait for a carrier.", waiting_count)
        yield gauge("fleet_quarantined_messages", "Messages kept aside, not acknowledged.", aside_counts, "reason")
        if arrivals:
            at, _ = max(arrivals.values())
            yield gauge("fleet_last_result_timestamp_seconds", "When a result was stored last.", at.timestamp())
        parts = partitions(self._engine)
        if months := [part.month for part in parts if part.month is not None]:
            ahead = sum(month > month_of(now) for month in months)
            yield gauge("fleet_months_ahead", "Months after this one that have a partition.", ahead)
            late = parts[-1].row_estimate or 0
            yield gauge("fleet_last_partition_rows", "Results later than all months, estimated.", late)
        at_s, took_s = self._now().timestamp(), time.monotonic() - began_s
        yield gauge("watch_round_timestamp_seconds", "When a round of the watch ended last.", at_s)
        yield gauge("watch_round_seconds", "How long it took.", took_s)
        yield gauge("watch_waiting_vehicles", "Vehicles with news that it did not get to.", self.waiting_count)

    def deliver(self, turn_s: float = TURN_S) -> int:
        """Deliver what waits, each carrier for a turn, so that none waits for one that hangs; return how many came.

        What was delivered and not settled, because the process died between both, is delivered again under its key.
        """
        count = 0
        for carrier in self._orders.carriers:
            end_s = time.monotonic() + turn_s
            while (
                not self.is_over and (letter := book.claim_letter(self._engine, carrier.name, self._now())) is not None
            ):
                complaint = None
                try:
                    carrier.deliver(letter)
                    count += 1
                except CarrierError as exc:
                    complaint = str(exc)
                    _LOG.warning("%s; trying again (%s)", complaint, letter.key)
                book.note_attempt(self._engine, letter, self._now(), complaint)
                if time.monotonic() >= end_s:
                    break
        return count

    def _withheld(self, now: datetime) -> dict[str, int]:
        """Return how many messages of today were not taken of each vehicle."""
        withheld = select(INTAKE.c.vehicle, INTAKE.c.withheld_count)
        withheld = withheld.where(INTAKE.c.day == now.date(), INTAKE.c.withheld_count > 0)
        with transaction(self._engine) as connection:
            return {str(vehicle): count for vehicle, count in connection.execute(withheld)}

    def _findings(
        self, now: datetime, open_subjects: Container[rules.Subject], arrivals: Mapping[str, Arrivals]
    ) -> Iterator[rules.RuleFinding]:
        for clutch in self._keeper.snapshot.clutches:
            subject = rules.Subject(vehicle=clutch.vehicle, clutch=clutch.clutch, rule=rules.AlarmRule.VERDICT)
            is_old = subject in open_subjects and self._is_alarm_of_old_fluid(clutch)
            yield rules.verdict_finding(clutch, is_old_fluid=is_old)
        for record in queries.last_seen(self._engine):
            vehicle = record["vehicle"]
            arrived_at, _ = arrivals.get(vehicle, (None, 0))
            heard_at = rules.heard_last((record["last_result_at"] or record["connected_at"], arrived_at), now)
            if heard_at is not None:
                yield rules.silence_finding(vehicle, heard_at, now, self._orders.limits)

    def _pasts(
        self, known: Mapping[str, KnownVehicle], judging_s: float, dues: dict[str, list[Row]]
    ) -> Iterator[rules.RuleFinding]:
        """Judge vehicles with news: those that never were, the worst first, then those of the longest ago.

        Thus the worst, which may have news in each round, keep none of the others waiting for ever. When the fluids of
        who was judged are due is added to ``dues``.
        """
        population, end_s = latest_population(self._engine), time.monotonic() + judging_s
        if not self._is_reminded:
            marks = marks_of_judged(self._engine).items()
            same = (name for name, mark in marks if name in known and mark == self._mark(known[name], population))
            self._judged, self._is_reminded = {name: known[name] for name in same}, True
        worst = dict.fromkeys(clutch.vehicle for clutch in self._keeper.snapshot.clutches)
        never = (name for name in worst if name in known and name not in self._judged)
        again = (name for name, judged in self._judged.items() if known.get(name, judged) != judged)
        names = deque((*never, *again))
        while names:
            vehicle = names.popleft()
            mark = self._mark(known[vehicle], population)
            rows = yield from self._judge(vehicle, known[vehicle][0], population)
            dues[vehicle] = [{**row, "mark": mark} for row in rows]
            if time.monotonic() >= end_s:
                break
        self.waiting_count = len(names)

    def _mark(self, vehicle: KnownVehicle, population: Population | None) -> str:
        """Return what differs once a vehicle is to be judged again: by other results, calibrations or orders."""
        new = [reference_of(now.vehicle, now.calibration_version, now.clutch) for now in vehicle[0]]
        orders = (
            self._orders.limits,
            self._orders.service_distance_m,
            population and population.version,
            version("clutchdiag"),
        )
        return sha256(repr((vehicle, new, orders)).encode()).hexdigest()

    def _is_alarm_of_old_fluid(self, now: ClutchNow) -> bool:
        """Return whether a clutch has no verdict, and no alarming one since its fluid was changed."""
        if now.condition != Severity.NO_VERDICT or now.fluid_since is None:
            return False
        with transaction(self._engine) as connection:
            return not is_alarming_since(connection, now.vehicle, now.clutch, now.fluid_since)

    def _judge(
        self, vehicle: str, clutches: Sequence[ClutchNow], population: Population | None
    ) -> Generator[rules.RuleFinding, None, list[Row]]:
        """Yield what the past of a vehicle says; return when its fluids are due, a row per clutch."""
        limits, fills, pasts = self._orders.limits, fills_of(self._engine, vehicle), []
        for now in clutches:
            past = read_past(self._engine, now, fills, self._orders.service_distance_m, population)
            pasts.append(past)
            last = past.rows[-limits.unused_events :]
            unused_count = sum(row["status"] == "rejected" for row in last)
            yield rules.quality_finding(now, unused_count, len(last), limits)
            yield rules.score_finding(now, fall_of(past.estimates), limits)
            readings_m = [row["odometer_m"] for row in last if row["odometer_m"] is not None]
            yield rules.odometer_finding(now, readings_m, limits)
        yield rules.cause_finding(clutches[0])
        text = f"{clutches[0].order} {outlook_text((past.prognosis for past in pasts), clutches[0])}"
        for now, past in zip(clutches, pasts, strict=True):
            if past.prognosis is not None:
                yield rules.due_finding(now, chance_of(past.prognosis), text, limits)
        return foretold(clutches, pasts)


def run_watch(
    engine: Engine,
    orders: Orders,
    metrics: ServerAddress | None = None,
    *,
    is_once: bool = False,
    judging_s: float = ONCE_S,  # of a round of those that judge each vehicle once
) -> None:
    """Watch until SIGINT or SIGTERM, or until each vehicle was judged once."""
    if is_once:
        watch = Watch(engine, orders, partial(datetime.now, UTC))
        is_over = False
        while not is_over:
            watch.round(judging_s)
            is_over = watch.has_judged_all
            while watch.deliver():  # of what a turn left over, until none arrives any more
                pass
            if watch.waiting_count:
                _LOG.info("%d vehicles are yet to be judged", watch.waiting_count)
        return
    asyncio.run(until_stopped(watch_for_ever(engine, orders, metrics)))


async def watch_for_ever(
    engine: Engine, orders: Orders, metrics: ServerAddress | None = None, shared: Keeper | None = None
) -> None:
    """Judge and deliver until cancelled."""
    watch = Watch(engine, orders, partial(datetime.now, UTC), shared=shared)
    with metrics_served(metrics, watch.families):
        _LOG.info("watching")
        try:
            await asyncio.gather(_repeat(watch.round, ROUND_S), _repeat(watch.deliver, DELIVERY_S))
        finally:
            watch.is_over = True  # the thread that delivers is waited for


async def _repeat(step: Callable[[], object], pause_s: float) -> None:
    """Run a step again and again; while the database is away the step fails and is tried again."""
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
