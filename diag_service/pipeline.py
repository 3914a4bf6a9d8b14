"""The order of the stages: the only file that knows it. ``live`` and ``recorded`` feed it."""

import logging
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from clutch_model.calibration import Calibration
from diag_service.condition import ConditionMemory, judge, no_verdict
from diag_service.errors import StoreFullError
from diag_service.estimation import ALGORITHM_VERSION, Belief, Estimator
from diag_service.estimation.estimator import without_friction
from diag_service.frames import FrameBatch
from diag_service.gear_tracking import tracker_for
from diag_service.indices import measure
from diag_service.mapping import Decoder, MessageCounts
from diag_service.notices import NOTICE
from diag_service.progress import Progress, Stage
from diag_service.publishers import Reporter
from diag_service.records import (
    ClutchVerdict,
    Reason,
    ShiftEstimate,
    ShiftEvent,
    ShiftIndices,
    ShiftResult,
    Signal,
    Status,
    Tier,
)
from diag_service.results import utc_from_bus_ns
from diag_service.shifts import ShiftFinder
from diag_service.store import ResultStore, VehicleState, Versions
from diag_service.summary import Capability, FrameCounts, ShiftTally, Summary, frames_line, summarise
from diag_service.tiers import missing_for_next, tier_of
from diag_service.trust import TrustBasis, assess, reasons_against

MAX_PENDING = 1000  # results in memory while the disk is full
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What the stages make of one shift, and the state after it."""

    estimate: ShiftEstimate
    verdict: ClutchVerdict
    belief: Belief
    memory: ConditionMemory


class Stages:
    """Frames in, diagnoses out: no clock, no socket, no file; the same results for any cutting of the stream."""

    def __init__(self, decoder: Decoder, calibration: Calibration, belief: Belief, memory: ConditionMemory) -> None:
        self._decoder = decoder
        self._finder = ShiftFinder(tracker_for(decoder.signals, decoder.gears))
        self.tier = tier_of(decoder.signals, knows_gears=knows_gears(decoder))
        self._estimator = Estimator(calibration)
        self._calibration = calibration
        self._basis = TrustBasis(
            mandatory_messages=decoder.mandatory_messages,
            limits=decoder.limits,
            calibration_date=calibration.made_on,
        )
        self._belief = belief
        self._memory = memory

    def feed(self, batch: FrameBatch) -> list[Diagnosis]:
        """Return the diagnoses of the shifts that these frames complete."""
        return [self.conclude(event) for event in self.segment(batch)]

    def segment(self, batch: FrameBatch) -> list[ShiftEvent]:
        """Return the shifts that these frames complete; quick."""
        return [event for columns in self._decoder.feed(batch) for event in self._finder.feed(columns)]

    @property
    def is_expecting(self) -> bool:
        """Whether a shift has begun that was not returned yet: every frame may be the last that it needs."""
        return self._finder.is_expecting

    def flush(self) -> list[ShiftEvent]:
        """End the segment: return what is still open; frames that come later begin another one."""
        self._decoder.interrupt()
        return self._finder.flush()

    def conclude(self, event: ShiftEvent) -> Diagnosis:
        """Estimate and judge the next shift; shifts must come in order. May take a moment.

        Below the first tier nothing is said of friction, and the running state stays as it is.
        """
        trust = assess(event, self._basis)
        belief, estimate = self._estimate(event)
        indices: ShiftIndices | None = measure(event, self._calibration)
        if estimate.status is not Status.REJECTED and (reasons := reasons_against(trust)):
            estimate = replace(estimate, status=Status.REJECTED, reasons=reasons, friction=None, scale_free=None)
            belief, indices = self._belief, None  # data that are not trusted leave no trace in the running state
        estimate = replace(estimate, trust=trust, tier=self.tier or Tier.KINEMATIC, indices=indices)
        if self.tier is Tier.FRICTION:
            memory = self._memory.with_shift(estimate, self._belief)
            self._memory, verdict = judge(memory, belief, estimate.clutch, self._calibration)
        else:
            verdict = no_verdict(estimate.clutch, missing_for_next(self._decoder.signals))
        self._belief = belief
        return Diagnosis(estimate=estimate, verdict=verdict, belief=self._belief, memory=self._memory)

    def _estimate(self, event: ShiftEvent) -> tuple[Belief, ShiftEstimate]:
        if self.tier is Tier.FRICTION:
            return self._estimator.estimate(event, self._belief)
        return self._belief, without_friction(event, Status.UNOBSERVED, Reason.SIGNAL_MISSING)

    def capability(self) -> Capability:
        """Return what the signals that came suffice for."""
        seen = self._decoder.seen
        has_gears = knows_gears(self._decoder)
        return Capability(
            profile=self._decoder.profile_name,
            tier=tier_of(seen, knows_gears=has_gears),
            missing=missing_for_next(seen, knows_gears=has_gears),
            unseen=tuple(signal.value for signal in Signal if signal in self._decoder.signals - seen),
        )

    @property
    def kernel_filters(self) -> tuple[tuple[int, int], ...]:
        """What a kernel need let through, as identifiers and masks."""
        return self._decoder.kernel_filters

    @property
    def messages(self) -> Mapping[str, MessageCounts]:
        """What became of the frames of each message, and its state."""
        return self._decoder.counts.messages

    @property
    def nominal_hz(self) -> Mapping[str, float]:
        """How often each cyclic message should come."""
        return self._decoder.nominal_hz

    @property
    def slow_messages(self) -> Mapping[str, tuple[int, int]]:
        """The messages that come plainly less often than they should: their own cycle and the database's [ns]."""
        return self._decoder.slow_messages

    def frame_counts(self) -> FrameCounts:
        """Return what the decoder counted; how the frames came here, their source adds."""
        counts = self._decoder.counts
        return FrameCounts(
            on_bus=counts.received,
            decoded=counts.decoded,
            ignored=counts.ignored,
            rejected={reason.name.lower(): count for reason, count in counts.rejected.items()},
            missing=counts.missing,
            invalid_values=counts.invalid_values,
        )


def knows_gears(decoder: Decoder) -> bool:
    """Return whether the gear can be told from the ratio of two speeds that the bus has."""
    return decoder.gears is not None and decoder.signals >= {Signal.ENGINE_SPEED, decoder.gears.over}


class Session:
    """The shifts of one run: each is estimated, stored, then told, in that order.

    Parameters
    ----------
    stream : str or None
        Name of a log's stream, in which the number of a shift is its key; None for the live stream of the store.
    utc_now :
        Clock of ``produced_at`` in a live stream.
    progress :
        Hears when a shift is estimated and stored.
    """

    def __init__(
        self,
        *,
        stages: Stages,
        store: ResultStore,
        reporter: Reporter,
        vehicle: str,
        versions: Versions,
        stream: str | None,
        utc_now: Callable[[], str],
        progress: Progress | None = None,
    ) -> None:
        self.stages = stages
        self.progress = progress or Progress()
        self._store = store
        self.reporter = reporter
        self._vehicle = vehicle
        self._versions = versions
        self._stream = stream
        self._utc_now = utc_now
        self._tally = ShiftTally()
        self._pending: deque[tuple[ShiftResult, VehicleState]] = deque()  # what a full disk did not take yet
        self._is_disk_full = False
        self.given_up_count = 0  # results that never found room on the disk

    def settle(self, event: ShiftEvent) -> None:
        """Estimate, store and tell one shift; one that is stored already is told again, and changes nothing.

        A live bus does not wait for a full disk: what cannot be stored now is told when it can be.
        """
        result = self._known(event)
        if result is not None:
            self._tell(result, is_new=False)
            return
        self._pending.append(self._diagnose(event))
        try:
            self._store_pending()
        except StoreFullError as exc:
            if self._stream is not None:
                raise
            self._note_full_disk(exc)

    def retry(self) -> bool:
        """Store and tell what a full disk has not taken yet; return whether anything was."""
        waiting_count = len(self._pending)
        with suppress(StoreFullError):
            self._store_pending()
        return len(self._pending) < waiting_count

    def _store_pending(self) -> None:
        """Store and tell what waits, in order; raises StoreFullError at the first that the disk does not take."""
        while self._pending:
            with self.progress.working(Stage.STORE):
                self._store.add(*self._pending[0])
            self._tell(self._pending.popleft()[0], is_new=True)
        if self._is_disk_full:
            self._is_disk_full = False
            _LOG.log(NOTICE, "the disk takes results again; %d were given up in between", self.given_up_count)

    def _note_full_disk(self, exc: StoreFullError) -> None:
        if not self._is_disk_full:
            self._is_disk_full = True
            _LOG.warning("%s; results wait in memory", exc)
        while len(self._pending) > MAX_PENDING:
            self._pending.popleft()
            self.given_up_count += 1

    def _tell(self, result: ShiftResult, *, is_new: bool) -> None:
        self._tally.add(result, is_new=is_new)
        self.reporter.report(result)

    @property
    def vehicle(self) -> str:
        """Vehicle id."""
        return self._vehicle

    @property
    def recent(self) -> tuple[ShiftResult, ...]:
        """The last shifts, oldest first."""
        return self._tally.recent

    def summary(self, frames: FrameCounts, unpublished_count: int | None) -> Summary:
        """Return the numbers of the run as they stand."""
        return summarise(self._vehicle, frames, self._tally, unpublished_count, self.stages.capability())

    def finish(self, frames: FrameCounts, unpublished_count: int | None) -> None:
        """Tell the numbers of the run.

        Raises
        ------
        StoreFullError
            If there are results for which the disk still has no room.
        """
        self._store_pending()
        if not frames.is_balanced:
            _LOG.error("frame counts do not add up: %s", frames_line(frames))
        self.reporter.finish(self.summary(frames, unpublished_count))

    def _known(self, event: ShiftEvent) -> ShiftResult | None:
        if self._stream is None:
            return None
        return self._store.find(self._vehicle, self._stream, event.number, self._versions)

    def _next_seq(self) -> int:
        return self._pending[-1][0].seq + 1 if self._pending else self._store.next_seq()

    def _diagnose(self, event: ShiftEvent) -> tuple[ShiftResult, VehicleState]:
        with self.progress.working(Stage.ESTIMATE):
            diagnosis = self.stages.conclude(event)
        is_live = self._stream is None
        result = ShiftResult(
            vehicle=self._vehicle,
            stream=self._stream or self._store.stream,
            seq=self._next_seq() if is_live else event.number,
            estimate=diagnosis.estimate,
            verdict=diagnosis.verdict,
            algorithm_version=self._versions.algorithm,
            calibration_version=self._versions.calibration,
            produced_at=self._utc_now() if is_live else utc_from_bus_ns(event.end_ns),
        )
        state = VehicleState(
            belief=diagnosis.belief.to_json(), condition=diagnosis.memory.to_json(), versions=self._versions
        )
        return result, state


def versions_for(calibration: Calibration, digest: str) -> Versions:
    """Return the versions that results of this program and calibration carry; ``digest`` tells edited copies apart."""
    return Versions(algorithm=ALGORITHM_VERSION, calibration=f"{calibration.version}+{digest}")


def resume(
    store: ResultStore, vehicle: str, versions: Versions, calibration: Calibration
) -> tuple[Belief, ConditionMemory]:
    """Return the running state of a vehicle, or a fresh one if what is stored was made in another way."""
    fresh = Belief.fresh(calibration), ConditionMemory.fresh()
    state = store.state(vehicle)
    if state is None:
        return fresh
    if state.versions != versions:
        _LOG.warning(
            "the running state of %s was made by algorithm %s with calibration %s; starting afresh with a new "
            "baseline, results stay",
            vehicle,
            state.versions.algorithm,
            state.versions.calibration,
        )
        return fresh
    try:
        return Belief.from_json(state.belief, calibration), ConditionMemory.from_json(state.condition)
    except ValueError as exc:
        _LOG.warning(
            "the running state of %s cannot be used (%s); starting afresh with a new baseline, results stay",
            vehicle,
            exc,
        )
        return fresh
