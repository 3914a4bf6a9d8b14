"""Frames in, diagnoses out: the order of the stages, and the only file that knows it."""

from dataclasses import dataclass, replace
from typing import Final

from canlog.frames import FrameBatch
from clutch_model.calibration import Calibration, TorqueSource
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.causes import CauseJudge
from diag_service.diagnosis.condition.condition import (
    ConditionMemory,
    judge,
    judge_lockup,
    no_verdict,
)
from diag_service.diagnosis.condition.shift_quality import ShiftScorer, measure
from diag_service.diagnosis.condition.verdict import Silence
from diag_service.diagnosis.events import DATED_NS, Event
from diag_service.diagnosis.friction import Estimator, Posterior
from diag_service.diagnosis.friction.estimator import without_friction
from diag_service.diagnosis.lockup.estimator import LockupEstimator, SlipFinder
from diag_service.diagnosis.lockup.state import LockupState
from diag_service.diagnosis.quality.data_quality import QualityBasis, gate, named_late
from diag_service.diagnosis.quality.plausibility import MeaningCheck
from diag_service.diagnosis.records import ClutchVerdict, Reason, ShiftEstimate, Status, Tier
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.diagnosis.summary import Capability
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.tiers import PRESSURES, missing_for_next, tier_of, why_no_friction

DRIVE_NS: Final = 3_600_000_000_000  # within an hour of another event nobody has changed the fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What the stages make of one shift, and the state after it."""

    estimate: ShiftEstimate
    verdict: ClutchVerdict
    state: Posterior
    memory: ConditionMemory
    slip: LockupState | None = None  # of a lock-up clutch, which has no other state

    @property
    def running(self) -> Posterior | LockupState:
        """What goes on from here, and is to be stored."""
        return self.state if self.slip is None else self.slip


class Stages:
    """Frames in, diagnoses out: no clock, no socket, no file; the same results for any cutting of the stream."""

    def __init__(
        self, decoder: Decoder, calibration: Calibration, state: Posterior | LockupState, memory: ConditionMemory
    ) -> None:
        self.decoder = decoder
        self._slip = state if isinstance(state, LockupState) else None
        self._lockup = None if calibration.converter is None else LockupEstimator(calibration, calibration.converter)
        self._finder = (
            DriveFinder(decoder.signals, calibration, decoder.gears)
            if self._lockup is None
            else SlipFinder(calibration)
        )
        unknown = {Signal.ENGINE_TORQUE} if calibration.torque is TorqueSource.UNKNOWN else frozenset[Signal]()
        # The gear can be told from the ratio of two speeds, where the bus has both.
        knows_gears = decoder.gears is not None and decoder.signals >= {Signal.ENGINE_SPEED, decoder.gears.over}
        self._tells = {"knows_gears": knows_gears, "has_converter": self._lockup is not None}
        self.tier = tier_of(decoder.signals - unknown, **self._tells)
        self._missing = why_no_friction(decoder.signals - unknown, calibration.torque, **self._tells)
        lacks_torque = calibration.torque is not TorqueSource.MEASURED or Signal.ENGINE_TORQUE not in decoder.signals
        tells_ratios = lacks_torque and decoder.signals >= PRESSURES | {Signal.ENGINE_SPEED}
        self.is_relative = self.tier is not Tier.FRICTION and tells_ratios  # friction is known up to a scale at best
        self._estimator = Estimator(calibration)
        self._scorer = ShiftScorer(calibration, decoder.gears)
        self._causes = CauseJudge(calibration)
        self._calibration = calibration
        self._basis = QualityBasis(
            mandatory_messages=decoder.mandatory_messages,
            scale_ends=decoder.limits,
            calibration_date=calibration.made_on,
            torque=calibration.torque,
        )
        self._state = state if isinstance(state, Posterior) else Posterior.fresh(calibration)
        self._memory = memory
        self.doubt = ""  # why signals that were asked for cannot be what the profile says
        self._meaning = MeaningCheck([one.friction.mu_c for one in calibration.clutches]) if decoder.asked else None

    def feed(self, batch: FrameBatch) -> list[Diagnosis]:
        """Return the diagnoses of the shifts that these frames complete."""
        return [self.conclude(event) for event in self.segment(batch)]

    def segment(self, batch: FrameBatch) -> list[Event]:
        """Return the shifts that these frames complete; quick."""
        found = (event for columns in self.decoder.stream(batch) for event in self._finder.feed(columns))
        return self.decoder.marked(found)

    @property
    def is_expecting(self) -> bool:
        """Whether a shift has begun that was not returned yet."""
        return self._finder.is_expecting

    @property
    def due_ns(self) -> int | None:
        """Bus time beyond which the next shift will be returned, if it has ended."""
        return self._finder.due_ns

    def flush(self) -> list[Event]:
        """End the segment: return what is still open; frames that come later begin another one."""
        events = [event for columns in self.decoder.drain() for event in self._finder.feed(columns)]
        self.decoder.interrupt()
        return self.decoder.marked(events + self._finder.flush())

    def conclude(self, event: Event) -> Diagnosis:
        """Judge the data of the next shift, estimate, judge its clutch; shifts must come in order. May take a moment.

        Below the first tier nothing is said of friction, and the running state stays as it is.
        """
        if self._slip is not None:
            return self._conclude_slip(event, self._slip)
        data = gate(event, self._basis, tells_friction=self.tier is Tier.FRICTION)
        state = self._state
        if data.samples is not None:
            state, estimate = self._estimator.estimate(event, data.samples, state, data.against)
            if self._meaning is not None:
                if not self._meaning.is_believed(estimate):
                    state, estimate = self._state, without_friction(event, Status.REJECTED, Reason.IMPLAUSIBLE)
                self.doubt = self._meaning.doubt
        elif data.against:
            estimate = without_friction(event, Status.REJECTED, *data.against)
        else:
            estimate = without_friction(event, Status.UNOBSERVED, Reason.SIGNAL_MISSING)
        is_believed = not data.against or estimate.reasons != data.against
        state, estimate = self._without_late(event, state, estimate)
        has_scale = self.tier is Tier.FRICTION and self._calibration.torque is TorqueSource.MEASURED
        known = state.fusion.knowledge if has_scale else None
        estimate = replace(
            estimate,
            data_quality=data.quality,
            tier=self.tier or Tier.KINEMATIC,
            indices=measure(event, self._calibration) if is_believed else None,
            shift_quality=self._scorer.score(event, known, self._state.packs) if is_believed else None,
        )
        if self.tier is Tier.FRICTION:
            for clutch in (1, 2):
                place = clutch - 1  # counts grow until the clutch has changed
                if state.folded_counts[place] < self._state.folded_counts[place]:
                    self._memory = self._memory.with_changed_friction(clutch)
            course = self._memory.course.with_event(estimate, self._state, state)
            if has_scale and course.is_due:
                course = replace(course, found=self._causes.judge(course))
            memory = self._memory.with_fit(estimate).with_shift(estimate, self._state).with_launch(estimate, course)
            self._memory, verdict = judge(memory, state, estimate.clutch, self._calibration)
        else:
            self._memory = self._memory.with_launch(estimate)  # a witness that needs no torque
            launches = self._memory.launches[estimate.clutch - 1]
            silence = Silence.LEVEL_UNKNOWN if self.is_relative else Silence.SIGNALS_MISSING
            verdict = replace(no_verdict(estimate.clutch, self._missing, silence), stick_slip=launches.reported)
        since_ns = self._memory.running_since_ns
        is_dated = (since_ns is None or since_ns < event.start_ns - DRIVE_NS) and any(state.shift_counts)
        verdict = self._dated(verdict, event, any(self._state.shift_counts)) if is_dated else verdict
        self._state = state
        return Diagnosis(estimate=estimate, verdict=verdict, state=self._state, memory=self._memory)

    def _without_late(self, event: Event, state: Posterior, estimate: ShiftEstimate) -> tuple[Posterior, ShiftEstimate]:
        """Return what is known after a shift, and its estimate; of one that lateness spoilt nothing else is said."""
        if estimate.status is not Status.REJECTED or named_late(event, estimate.reasons) == estimate.reasons:
            return state, estimate
        return self._state, without_friction(event, Status.REJECTED, Reason.TIME_UNSURE)

    def _dated(self, verdict: ClutchVerdict, event: Event, had_any: bool) -> ClutchVerdict:  # noqa: FBT001
        """Return a verdict with since when what it rests on is known, if that is longer than a drive."""
        if not had_any:
            self._memory = replace(self._memory, running_since_ns=event.start_ns)
        began_ns = self._memory.running_since_ns
        if began_ns is None or not DATED_NS <= began_ns < event.start_ns - DRIVE_NS:
            return verdict
        return replace(verdict, running_since_bus_ns=began_ns)

    def _conclude_slip(self, event: Event, state: LockupState) -> Diagnosis:
        """Judge the data of a stretch of slip, estimate, judge the lock-up clutch."""
        data = gate(event, self._basis, tells_friction=False)
        if self._lockup is None or self.tier is not Tier.FRICTION:
            raise ConfigError(f"a lock-up clutch cannot be estimated: {self._missing}")
        had_any = bool(state.shift_count)
        self._slip, estimate, swings = self._lockup.estimate(event, state, data.against)
        estimate = replace(estimate, data_quality=data.quality, tier=self.tier)
        is_believed = self._slip.contradiction_count < state.contradiction_count
        if is_believed and self._slip.shift_count <= state.shift_count:  # not by what was known: that begins afresh
            self._memory = self._memory.with_changed_friction(1)
        memory = self._memory.with_fit(estimate).with_shudder(swings)
        self._memory, verdict = judge_lockup(memory, self._slip, self._calibration, swings)
        if self._slip.shift_count:
            verdict = self._dated(verdict, event, had_any)
        return Diagnosis(estimate=estimate, verdict=verdict, state=self._state, memory=self._memory, slip=self._slip)

    def conclude_past(self, event: Event) -> Diagnosis:
        """Judge an event of a fluid before the present one by itself; what is known of the present one stays."""
        kept = self._state, self._slip, self._memory
        self.note_fluid("")  # of its friction nothing is known
        self._memory = ConditionMemory.fresh()
        found = self.conclude(event)
        self._state, self._slip, self._memory = kept
        return replace(found, state=self._state, slip=self._slip, memory=self._memory)

    def note_fluid(self, filled_at: str, *, is_new: bool = True) -> None:
        """Take note of the fluid that the vehicle has, by the moment of its fill.

        New fluid begins a new running friction with a new baseline. If it is not, all that is known is of it.
        """
        if is_new:
            self._memory = self._memory.with_new_fluid(filled_at, self._state)
            self._state = self._state.with_new_fluid()
            self._slip = self._slip and self._slip.with_new_fluid()
        self._memory = replace(self._memory, fluid_since=filled_at)

    def capability(self) -> Capability:
        """Return what the signals that came suffice for."""
        seen = self.decoder.seen
        expected = self.decoder.signals - self.decoder.optional_signals
        return Capability(
            profile=self.decoder.profile_name,
            tier=tier_of(seen, **self._tells),
            missing=missing_for_next(seen, **self._tells),
            elements=() if self._lockup is None else self._calibration.elements,
            torque=self._basis.torque if Signal.ENGINE_TORQUE in seen else TorqueSource.UNKNOWN,
            unseen=tuple(signal.value for signal in Signal if signal in expected - seen),
        )
