"""The shifts of one run: diagnosed, stored, reported. ``live`` and ``recorded`` feed it.

`Progress` says which stage holds work and gets nothing done: a loop that still turns says nothing of a hanging thread.
"""

import logging
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from canlog.errors import NOTICE
from clutch_model.calibration import Calibration
from clutch_model.fingerprint import fingerprint
from clutch_results.clocks import DatedOdometer, believed, nanoseconds
from clutch_results.event_kinds import DATED_NS
from clutch_results.loads import Load, borne
from clutch_results.records import (
    Reason,
    ShiftResult,
    ShiftStatistics,
    Status,
    Tier,
    iso_utc,
    parse_shift,
    utc_from_bus_ns,
)
from diag_service.delivery import Reporter
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.condition import failed_verdict
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.frame_counts import FrameCounts, frames_line
from diag_service.diagnosis.friction.estimator import without_friction
from diag_service.diagnosis.summary import NO_LOGS, Contributions, Gap, Summary, latest_of, of_present_fluid
from diag_service.errors import DiagServiceError, StoreFullError
from diag_service.mapping.decoder import Decoder
from diag_service.service.stages import Belief, Diagnosis, Stages, kind_of
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import KeptEvents, ResultStore, VehicleState, Versions
from fleet_contract.errors import ResultError

if TYPE_CHECKING:  # a live service has none
    from diag_service.service.drive_survey import DriveSurvey

STUCK_AFTER_S = 30.0  # a shift takes a fraction of a second, a slow disk a few


class Stage(StrEnum):
    """What is done with a shift beside the loop that reads the bus."""

    ESTIMATE = "estimate"
    STORE = "store"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stuck:
    """A stage that has been at one piece of work for too long."""

    stage: Stage
    for_s: float

    def __str__(self) -> str:
        return f"stuck in {self.stage} for {self.for_s:.0f} s"


class Progress:
    """Which stage is at work, one at a time, and since when; any thread may read it."""

    def __init__(self, *, limit_s: float = STUCK_AFTER_S, now_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s = limit_s
        self._now_s = now_s
        self._work: tuple[Stage, float] | None = None  # and since when [s]

    @contextmanager
    def working(self, stage: Stage) -> Iterator[None]:
        """Be at one piece of work while this is entered."""
        self._work = stage, self._now_s()
        try:
            yield
        finally:
            self._work = None

    @property
    def stuck(self) -> Stuck | None:
        """The stage that is at work, if it has been for too long."""
        work = self._work
        if work is None or (for_s := self._now_s() - work[1]) < self._limit_s:
            return None
        return Stuck(stage=work[0], for_s=for_s)


BY_COUNTER: Final = ("repeated", "wrong_sequence")  # two senders in step repeat each other's counters
ENOUGH_FRAMES: Final = 500  # judged by their counters; about a second of a bus
SUSPICIOUS_SHARE: Final = 0.2  # two senders in turn come to about a half, one on a bad bus to a few percent
_LOG = logging.getLogger(__name__)
MAX_PENDING_COUNT = 1000
MOST_UNTOLD: Final = 2000  # results without friction, some 2 kB each, that a summary is made of: some ten days of a car
FOREIGN_SHARE: Final = 0.99  # a message that is worth a profile is a percent of its bus at least
FOREIGN = (
    "only %d of %d frames are of messages of the profile: the database or profile is probably wrong for this vehicle"
)
NOTHING_KNOWN = (
    "no message of the profile was received; try 'diag-service signals LOG', with --dbc FILE for frames: it lists what "
    "a log holds and proposes a profile"
)


def utc_now() -> str:
    """Return the present moment as results carry it."""
    return iso_utc(datetime.now(UTC))


class Session:
    """The shifts of one run, from the state in the store on: each is estimated, stored, then reported."""

    def __init__(
        self,
        config: DiagnosisConfig,
        decoder: Decoder,
        store: ResultStore,
        stream: str | None,  # of a log, in which the number of a shift is its key; None: the live stream of the store
        reporter: Reporter,
        *,
        utc_now: Callable[[], str] = utc_now,  # the clock of a live stream
        max_pending_count: int = MAX_PENDING_COUNT,  # results in memory while the disk is full
        kept_events: KeptEvents | None = None,  # over which the program failed
        survey: "type[DriveSurvey] | None" = None,
    ) -> None:
        self.vehicle, self._versions = config.vehicle, versions_for(config.calibration)
        belief = resume(store, self.vehicle, self._versions, config.calibration)
        self.stages = Stages(decoder, config.calibration, belief)
        self.survey = None if survey is None else survey(self.stages)
        self.progress = Progress()
        self._store = store
        self.reporter = reporter
        self._stream = stream
        self._utc_now = utc_now
        self.statistics = ShiftStatistics()
        self._loads: Mapping[int, Load] = {}
        self._untold: deque[ShiftResult] = deque(maxlen=MOST_UNTOLD)
        self.fluid = store.fluid_at(self.vehicle, utc_now())  # that is in now, as far as its fill is known
        self._fluid_since = belief.memory.fluid_since  # of the fluid that the stages judge
        self._earlier = last_results(
            store, self.vehicle, self._versions, self._today_ns
        )  # until this run has later ones
        self._pending: deque[tuple[ShiftResult, VehicleState | None]] = deque()  # what a full disk did not take yet
        self._max_pending_count = max_pending_count
        self._kept_events = kept_events or KeptEvents(None)
        self._is_disk_full = False
        self._is_doubted = False  # whether that was logged
        self.given_up_count = 0  # results that never found room on the disk

    @property
    def _today_ns(self) -> int:
        return nanoseconds(self._utc_now())

    @property
    def latest(self) -> tuple[ShiftResult, ...]:
        """The last result of each clutch, clutch 1 first, of earlier runs too; no verdict where the fluid is newer."""
        known = {**self.statistics.latest, **self._earlier}
        return of_present_fluid((result for _, result in sorted(known.items())), self.fluid, self._today_ns)

    def process(self, event: Event) -> None:
        """Estimate, store and report one shift; one that is stored already is reported again, and changes nothing.

        A live bus does not wait for a full disk: what cannot be stored now is reported when it can be.
        """
        stream = self._stream
        if self.survey is not None:
            self.survey.add(event)
        known = None if stream is None else self._store.find(self.vehicle, stream, event.number, self._versions)
        if known is not None:
            self._report(known, is_new=False)
            return
        result, state = self._diagnose(event)
        self._pending.append((result, state))
        try:
            self._store_pending()
        except StoreFullError as exc:
            if self._stream is not None:
                raise
            if not self._is_disk_full:
                self._is_disk_full = True
                _LOG.warning("%s; results wait in memory", exc)
            while len(self._pending) > self._max_pending_count:
                self._pending.popleft()
                self.given_up_count += 1

    def retry(self) -> bool:
        """Store and report what a full disk has not taken yet, and look for new fluid; return whether there was any."""
        waiting_count, fluid = len(self._pending), self.fluid
        with suppress(StoreFullError):
            self._store_pending()
            self.fluid = self._store.fluid_at(self.vehicle, self._utc_now())
        return len(self._pending) < waiting_count or fluid != self.fluid

    def _store_pending(self) -> None:
        """Store and report what waits, in order; raises StoreFullError at the first that the disk does not take."""
        while self._pending:
            with self.progress.working(Stage.STORE):
                self._store.add(*self._pending[0])
            self._report(self._pending.popleft()[0], is_new=True)
        if self._is_disk_full:
            self._is_disk_full = False
            _LOG.log(NOTICE, "the disk takes results again; %d were given up in between", self.given_up_count)

    def _report(self, result: ShiftResult, *, is_new: bool) -> None:
        self.statistics = self.statistics.with_shift(result, is_new=is_new)
        clutch = result.estimate.clutch
        if (
            is_new
            and clutch in self._earlier
            and latest_of((self._earlier[clutch], result), self._today_ns) == (result,)
        ):
            self._earlier = {other: result for other, result in self._earlier.items() if other != clutch}
        self._loads = borne(self._loads, result.estimate)
        if result.estimate.tier is not Tier.FRICTION:
            self._untold.append(result)
        self.reporter.report(result)

    def summary(self, frames: FrameCounts, unpublished_count: int | None) -> Summary:
        """Return the numbers of the run as they stand."""
        return Summary(
            vehicle=self.vehicle,
            frames=frames,
            shifts=self.statistics,
            unpublished_count=unpublished_count,
            capability=self.stages.capability(),
            earlier=self._earlier,
            fluid=self.fluid,
            loads=self._loads,
            today_ns=self._today_ns,
            untold=tuple(self._untold),
        )

    def finish(
        self,
        frames: FrameCounts,
        unpublished_count: int | None,
        gaps: tuple[Gap, ...] = (),
        contributions: Contributions = NO_LOGS,
    ) -> Summary:
        """Report the numbers of the run, and return them.

        Raises StoreFullError if there are results for which the disk still has no room.
        """
        self._store_pending()
        self.fluid = self._store.fluid_at(self.vehicle, self._utc_now())
        if not frames.is_balanced:
            _LOG.error("frame counts do not add up: %s", frames_line(frames))
        summary = replace(self.summary(frames, unpublished_count), gaps=gaps, contributions=contributions)
        if self.survey is not None:
            summary = replace(
                summary,
                relative=self.survey.relative_frictions(),
                lockup=self.survey.slopes.slope(),
                lockup_slip=self.survey.slip(),
                held_run=self.survey.held_run,
            )
        self.reporter.report(summary)
        if frames.on_bus and not frames.decoded and not frames.rejected_count:
            _LOG.log(NOTICE, "%s", NOTHING_KNOWN)
        elif frames.on_bus >= ENOUGH_FRAMES and frames.ignored > FOREIGN_SHARE * frames.on_bus:
            _LOG.warning(FOREIGN, frames.on_bus - frames.ignored, frames.on_bus)
        return summary

    def _note_fluid(self, event: Event) -> bool:
        """Let the stages know which fluid the vehicle had at a shift; return whether it was one before theirs."""
        start_ns = event.start_ns if self._stream is None else self._believed_start_ns(event)
        began_at = utc_from_bus_ns(start_ns)
        fill, since = self._store.fluid_at(self.vehicle, began_at), self._fluid_since
        if fill is not None and self._stream is None:
            self.fluid = fill
        if fill is not None and (since is None or fill.filled_at > since):
            since = self._fluid_since = fill.filled_at
            is_new = not self._store.began_after(self.vehicle, since)
            self.stages.note_fluid(since, is_new=is_new)
            if is_new:
                _LOG.log(NOTICE, "new fluid since %s: a new baseline begins", since)
        return since is not None and start_ns >= DATED_NS and began_at < since

    def _believed_start_ns(self, event: Event) -> int:
        """Return when an event began: of a log whose clock was wrong, as the odometer tells it by the fills."""
        fills = self._store.fills(self.vehicle)
        series = event.columns.get(Signal.ODOMETER)
        if not fills or series is None or not len(series.value):
            return event.start_ns
        readings = [DatedOdometer(t_ns=event.start_ns, odometer_m=float(series.value.mean()), stream=self._stream)]
        readings += [DatedOdometer(t_ns=nanoseconds(fill.filled_at), odometer_m=fill.odometer_m) for fill in fills]
        return believed(readings, self._today_ns).t_ns[0]

    def _diagnose(self, event: Event) -> tuple[ShiftResult, VehicleState | None]:
        conclude = self.stages.conclude_of_earlier_fluid if self._note_fluid(event) else self.stages.conclude
        belief = self.stages.belief
        with self.progress.working(Stage.ESTIMATE):
            try:
                diagnosis = conclude(event)
            except DiagServiceError:
                raise  # it says what the user does next
            except Exception as exc:  # noqa: BLE001 - one event, whatever is wrong with it, must not end the others
                diagnosis = self._left_out(event, exc, belief)
        if (doubt := self.stages.belief.meaning.doubt) and not self._is_doubted:
            self._is_doubted = True
            _LOG.warning("nothing is estimated: %s", doubt)
        is_live, seq = self._stream is None, event.number
        if is_live:
            seq = self._pending[-1][0].seq + 1 if self._pending else self._store.next_seq()
        result = ShiftResult(
            vehicle=self.vehicle,
            stream=self._stream or self._store.stream,
            seq=seq,
            estimate=diagnosis.estimate,
            verdict=diagnosis.verdict,
            algorithm_version=self._versions.algorithm,
            calibration_version=self._versions.calibration,
            produced_at=self._utc_now() if is_live else utc_from_bus_ns(event.end_ns),
        )
        if not self._store.keeps_state:
            return result, None
        state, memory = diagnosis.belief.to_json()
        return result, VehicleState(filter_state=state, condition=memory, versions=self._versions)

    def _left_out(self, event: Event, fault: Exception, belief: Belief) -> Diagnosis:
        """Return the diagnosis of an event over which the program failed: it is put aside, and belief is as before."""
        path = self._kept_events.keep(event, "".join(traceback.format_exception(fault)))
        where = "" if path is None else f"; its signals are in {path}, for a report of the fault"
        _LOG.error("event %d is left out: unexpected %s: %s%s", event.number, type(fault).__name__, fault, where)
        self.stages.belief = belief
        estimate = without_friction(event, Status.REJECTED, Reason.INTERNAL_ERROR)
        known = {result.estimate.clutch: result.verdict for result in self.latest}
        verdict = known.get(estimate.clutch) or failed_verdict(estimate.clutch)
        return Diagnosis(estimate=estimate, verdict=verdict, belief=belief)


def versions_for(calibration: Calibration) -> Versions:
    """Return the versions that results of this program and calibration carry; its fingerprint tells copies apart."""
    version = f"{calibration.version}+{fingerprint(calibration)}"
    return Versions(algorithm=kind_of(calibration).algorithm_version, calibration=version)


def resume(store: ResultStore, vehicle: str, versions: Versions, calibration: Calibration) -> Belief:
    """Return what is believed of a vehicle, afresh if what is stored was made in another way."""
    state = store.state(vehicle)
    if state is None:
        return Belief.fresh(calibration)
    try:
        if state.versions == versions:
            return Belief.from_json(state.filter_state, state.condition, calibration)
        made_by = f"was made by algorithm {state.versions.algorithm} with calibration {state.versions.calibration}"
    except ValueError as exc:
        made_by = f"cannot be used ({exc})"
    _LOG.warning("the running state of %s %s; starting afresh with a new baseline, results stay", vehicle, made_by)
    return Belief.fresh(calibration)


def last_results(store: ResultStore, vehicle: str, versions: Versions, today_ns: int) -> dict[int, ShiftResult]:
    """Return the newest stored result of each clutch, by clutch, if it was made as results are made now."""
    results: list[ShiftResult] = []
    for row in store.ends(vehicle, versions):
        try:
            results.append(parse_shift(row.text))
        except ResultError as exc:
            _LOG.warning("the last result of clutch %d of %s is left out: %s", row.clutch, vehicle, exc)
    return {result.verdict.clutch: result for result in latest_of(results, today_ns)}


@dataclass(slots=True)
class SenderWatch:
    """Warns of counters of two senders, once for as long as the counts of a run show them."""

    _decoded: int = 0  # until the last judgement
    _rejected: int = 0
    _is_reported: bool = False

    def warn(self, frames: FrameCounts) -> None:
        if (text := self.look(frames)) is not None:
            _LOG.warning("%s", text)

    def look(self, frames: FrameCounts) -> str | None:
        """Return the warning about the frames since the last judgement, None if there is none."""
        rejected = sum(frames.rejected.get(reason, 0) for reason in BY_COUNTER)
        wrong, right = rejected - self._rejected, frames.decoded - self._decoded
        if wrong + right < ENOUGH_FRAMES:
            return None
        self._decoded, self._rejected = frames.decoded, rejected
        share = wrong / (wrong + right)
        was_reported, self._is_reported = self._is_reported, share >= SUSPICIOUS_SHARE
        if was_reported or not self._is_reported:
            return None
        return (
            f"{share:.0%} of {wrong + right} frames have a counter that does not follow the last: two senders use the "
            "same identifiers, such as two emulators on one bus, or frames come twice"
        )
