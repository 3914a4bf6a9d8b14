"""Frames in, diagnoses out: the order of the stages, and the only file that knows it.

``batch -> Decoder -> Columns -> EventFinder -> Event -> gate -> Element.conclude(belief, event) -> Diagnosis``
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Protocol

from canlog.frames import FrameBatch
from clutch_model.calibration import Calibration, TorqueSource
from clutch_results.event_kinds import DATED_NS
from clutch_results.records import ClutchVerdict, Reason, ShiftEstimate, Status, Tier
from diag_service.diagnosis.capability import Capability
from diag_service.diagnosis.columns import ColumnBatch, GearRatios, Signal
from diag_service.diagnosis.condition.causes import CauseJudge
from diag_service.diagnosis.condition.condition import (
    ConditionMemory,
    ConverterClutch,
    PairClutch,
    VehicleCourse,
    judge,
    no_verdict,
)
from diag_service.diagnosis.condition.shift_indices import measure
from diag_service.diagnosis.condition.shift_quality import ShiftScorer
from diag_service.diagnosis.condition.thresholds import Silence
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import ALGORITHM_VERSION, Estimator, Posterior
from diag_service.diagnosis.friction.estimator import without_friction
from diag_service.diagnosis.lockup.estimator import LockupEstimator, SlipFinder
from diag_service.diagnosis.lockup.state import ALGORITHM_VERSION as LOCKUP_ALGORITHM_VERSION
from diag_service.diagnosis.lockup.state import LockupState
from diag_service.diagnosis.quality import Gate, QualityBasis, SignalMeaning, gate, named_late
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.diagnosis.shifts.tracking import EventFinder
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.liveness import LEAST_LIVE, Liveness
from diag_service.mapping.mapped_messages import PRESSURES, missing_for_next, tier_of, why_no_friction
from diag_service.service.needs import needs_of
from fleet_contract import JsonObject

DRIVE_NS: Final = 3_600_000_000_000  # within an hour of another event nobody has changed the fluid
_SINCE: Final = "running_since_ns"  # in the stored memory of the condition, as earlier programs wrote it


@dataclass(frozen=True, slots=True, kw_only=True)
class Belief:
    """All that is believed of a vehicle after its events so far; one record, which a store keeps."""

    state: Posterior | LockupState
    memory: ConditionMemory = field(default_factory=ConditionMemory)
    since_ns: int | None = None  # start of the first event that the state rests on; None: not known
    meaning: SignalMeaning = field(default_factory=SignalMeaning)  # of this run: no store keeps it

    @classmethod
    def fresh(cls, calibration: Calibration) -> "Belief":
        """Return what is believed before the first event."""
        return cls(state=kind_of(calibration).state_kind.fresh(calibration))

    @classmethod
    def from_json(cls, state: JsonObject, memory: JsonObject, calibration: Calibration) -> "Belief":
        """Rebuild what `to_json` wrote under the same calibration; raises ValueError if it is none."""
        since_ns = memory.get(_SINCE)
        if not isinstance(since_ns, int | None):
            raise ValueError(f"not the start of an event: {since_ns!r}")  # noqa: TRY004 - what is stored is a value
        return cls(
            state=kind_of(calibration).state_kind.from_json(state, calibration),
            memory=ConditionMemory.from_json(memory),
            since_ns=since_ns,
        )

    def to_json(self) -> tuple[JsonObject, JsonObject]:
        """Return the state and the memory of the condition as JSON-ready values."""
        since = {} if self.since_ns is None else {_SINCE: self.since_ns}
        return self.state.to_json(), self.memory.to_json() | since

    @property
    def posterior(self) -> Posterior:
        """The state of a pair of clutches."""
        if not isinstance(self.state, Posterior):
            raise ConfigError("a lock-up clutch has no joint state of two clutches")
        return self.state

    @property
    def lockup(self) -> LockupState:
        """The state of a lock-up clutch."""
        if not isinstance(self.state, LockupState):
            raise ConfigError("a pair of clutches has no lock-up clutch")
        return self.state


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """What an event says, what is said of its clutch, and what is believed after it."""

    estimate: ShiftEstimate
    verdict: ClutchVerdict
    belief: Belief

    @classmethod
    def of(
        cls, before: Belief, event: Event, estimate: ShiftEstimate, verdict: ClutchVerdict, after: Belief
    ) -> "Diagnosis":
        """Return it with since when what the verdict rests on is known, if that is longer than a drive."""
        since_ns, drive_ns = before.since_ns, event.start_ns - DRIVE_NS
        if (since_ns is None or since_ns < drive_ns) and after.state.shift_count:
            since_ns = since_ns if before.state.shift_count else event.start_ns
            after = replace(after, since_ns=since_ns)
            if since_ns is not None and DATED_NS <= since_ns < drive_ns:
                verdict = replace(verdict, running_since_bus_ns=since_ns)
        return cls(estimate=estimate, verdict=verdict, belief=after)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalReach:
    """What the signals of a profile suffice for, under a calibration."""

    tier: Tier | None  # None: not even shifts can be found
    missing: str  # what friction lacks
    is_relative: bool  # friction is known up to a scale at best
    asked: Mapping[str, bool]  # what the tiers are asked with

    @classmethod
    def of(cls, decoder: Decoder, calibration: Calibration) -> "SignalReach":
        return cls.of_signals(decoder.signals, decoder.gears, calibration)

    @classmethod
    def of_signals(
        cls, signals: AbstractSet[Signal], gears: GearRatios | None, calibration: Calibration
    ) -> "SignalReach":
        """Return what some signals suffice for; ``gears`` of the profile, where no signal tells them."""
        torque = calibration.torque
        known = signals - {Signal.ENGINE_TORQUE} if torque is TorqueSource.UNKNOWN else signals
        # The gear can be told from the ratio of two speeds, where the bus has both.
        knows_gears = gears is not None and signals >= {Signal.ENGINE_SPEED, gears.over}
        asked = {"knows_gears": knows_gears, "has_converter": calibration.converter is not None}
        tier, missing = tier_of(known, **asked), why_no_friction(known, torque, **asked)
        lacks_torque = torque is not TorqueSource.MEASURED or Signal.ENGINE_TORQUE not in signals
        tells_ratios = lacks_torque and signals >= PRESSURES | {Signal.ENGINE_SPEED}
        return cls(tier=tier, missing=missing, is_relative=tier is not Tier.FRICTION and tells_ratios, asked=asked)


class Element(Protocol):
    """What is diagnosed: a pair of clutches, or one lock-up clutch. It holds nothing that an event changes."""

    algorithm_version: ClassVar[str]
    state_kind: ClassVar[type[Posterior] | type[LockupState]]

    def finder(self) -> EventFinder:
        """Return what finds its events in columns."""

    def conclude(self, belief: Belief, event: Event) -> Diagnosis:
        """Judge the data of an event, estimate, judge its clutch; pure. Events must come in order."""

    def with_new_fluid(self, belief: Belief, filled_at: str) -> Belief:
        """Return what is believed after a fill: friction is unknown again, with a new baseline."""


class DualClutch:
    """A pair of clutches. Below the first tier nothing is said of its friction, and its state stays as it is."""

    algorithm_version: ClassVar[str] = ALGORITHM_VERSION
    state_kind: ClassVar[type[Posterior] | type[LockupState]] = Posterior

    def __init__(self, decoder: Decoder, calibration: Calibration, basis: QualityBasis, reach: SignalReach) -> None:
        self._signals, self._gears, self._asked = decoder.signals, decoder.gears, bool(decoder.asked)
        self._calibration, self._basis, self._reach = calibration, basis, reach
        self._tells_friction = reach.tier is Tier.FRICTION
        self._has_scale = self._tells_friction and calibration.torque is TorqueSource.MEASURED
        self._estimator, self._causes = Estimator(calibration), CauseJudge(calibration)
        self._scorer = ShiftScorer(calibration, decoder.gears)

    def finder(self) -> EventFinder:
        return DriveFinder(self._signals, self._calibration, self._gears)

    def conclude(self, belief: Belief, event: Event) -> Diagnosis:
        before, data = belief.posterior, gate(event, self._basis, tells_friction=self._tells_friction)
        state, estimate = self._estimated(event, data, before)
        meaning = belief.meaning
        if self._asked and data.samples is not None:
            meaning = meaning.with_estimate(estimate, self._calibration)
            if not meaning.believes(estimate):
                state, estimate = before, without_friction(event, Status.REJECTED, Reason.IMPLAUSIBLE)
        is_believed = not data.against or estimate.reasons != data.against
        if estimate.status is Status.REJECTED and named_late(event, estimate.reasons) != estimate.reasons:
            # Of what lateness spoilt nothing else is said.
            state, estimate = before, without_friction(event, Status.REJECTED, Reason.TIME_UNSURE)
        known = state.fusion.knowledge if self._has_scale else None
        estimate = replace(
            estimate,
            data_quality=data.quality,
            tier=self._reach.tier or Tier.KINEMATIC,
            indices=measure(event, self._calibration, self._gears) if is_believed else None,
            shift_quality=self._scorer.score(event, known, before.packs) if is_believed else None,
        )
        judged = self._judged if self._tells_friction else self._silent
        memory, verdict = judged(belief.memory, estimate, before, state)
        after = Belief(state=state, memory=memory, since_ns=belief.since_ns, meaning=meaning)
        return Diagnosis.of(belief, event, estimate, verdict, after)

    def _estimated(self, event: Event, data: Gate, before: Posterior) -> tuple[Posterior, ShiftEstimate]:
        if data.samples is not None:
            return self._estimator.estimate(event, data.samples, before, data.against)
        if data.against:
            return before, without_friction(event, Status.REJECTED, *data.against)
        return before, without_friction(event, Status.UNOBSERVED, Reason.SIGNAL_MISSING)

    def _judged(
        self, memory: ConditionMemory, estimate: ShiftEstimate, before: Posterior, state: Posterior
    ) -> tuple[ConditionMemory, ClutchVerdict]:
        for clutch in (1, 2):
            if state.folded_counts[clutch - 1] < before.folded_counts[clutch - 1]:  # they grow until it has changed
                memory = memory.with_changed_friction(clutch)
        course = VehicleCourse() if before.is_unlike_type else memory.course  # it begins again
        course = course.with_event(estimate, before, state)
        if self._has_scale and course.is_due:
            course = replace(course, found=self._causes.judge(course))
        memory = memory.with_fit(estimate).with_shift(estimate, before).with_launch(estimate, course)
        return judge(memory, PairClutch.of(state, estimate.clutch, self._calibration))

    def _silent(
        self, memory: ConditionMemory, estimate: ShiftEstimate, _before: Posterior, _state: Posterior
    ) -> tuple[ConditionMemory, ClutchVerdict]:
        """Return the verdict where nothing tells friction; a launch is a witness that needs no torque."""
        memory = memory.with_launch(estimate)
        silence = Silence.LEVEL_UNKNOWN if self._reach.is_relative else Silence.SIGNALS_MISSING
        verdict = no_verdict(estimate.clutch, self._reach.missing, silence)
        return memory, replace(verdict, stick_slip=memory.launches[estimate.clutch - 1].reported)

    def with_new_fluid(self, belief: Belief, filled_at: str) -> Belief:
        state = belief.posterior
        memory = belief.memory.with_new_fluid(filled_at, state)
        return replace(belief, state=state.with_new_fluid(), memory=memory)


class LockupClutch:
    """The lock-up clutch of a torque converter."""

    algorithm_version: ClassVar[str] = LOCKUP_ALGORITHM_VERSION
    state_kind: ClassVar[type[Posterior] | type[LockupState]] = LockupState

    def __init__(self, _decoder: Decoder, calibration: Calibration, basis: QualityBasis, reach: SignalReach) -> None:
        self._calibration, self._basis, self._reach = calibration, basis, reach
        self._estimator = LockupEstimator(calibration)

    def finder(self) -> EventFinder:
        return SlipFinder(self._calibration)

    def conclude(self, belief: Belief, event: Event) -> Diagnosis:
        before, data = belief.lockup, gate(event, self._basis, tells_friction=False)
        if self._reach.tier is not Tier.FRICTION:
            raise ConfigError(f"a lock-up clutch cannot be estimated: {self._reach.missing}")
        state, estimate, swings = self._estimator.estimate(event, before, data.against)
        estimate = replace(estimate, data_quality=data.quality, tier=self._reach.tier)
        memory, is_used = belief.memory, state.contradiction_count < before.contradiction_count
        if is_used and state.shift_count <= before.shift_count:  # not by what was known: that begins afresh
            memory = memory.with_changed_friction(1)
        memory = memory.with_fit(estimate).with_shudder(swings)
        memory, verdict = judge(memory, ConverterClutch.of(state, self._calibration, swings))
        return Diagnosis.of(belief, event, estimate, verdict, replace(belief, state=state, memory=memory))

    def with_new_fluid(self, belief: Belief, filled_at: str) -> Belief:
        memory = belief.memory.with_new_fluid(filled_at)
        return replace(belief, state=belief.lockup.with_new_fluid(), memory=memory)


def kind_of(calibration: Calibration) -> type[DualClutch] | type[LockupClutch]:
    """Return which element a calibration describes: the one place that asks."""
    return DualClutch if calibration.converter is None else LockupClutch


class Stages:
    """Frames in, diagnoses out: no clock, no socket, no file; the same results for any cutting of the stream."""

    def __init__(self, decoder: Decoder, calibration: Calibration, belief: Belief | None = None) -> None:
        self.decoder = decoder
        self._calibration = calibration
        self._basis = QualityBasis(
            mandatory_messages=decoder.mandatory_messages,
            scale_ends=decoder.limits,
            calibration_date=calibration.made_on,
            torque=calibration.torque,
        )
        self.reach, self.element = self._read()
        self._finder = self.element.finder()
        self.belief = belief or Belief.fresh(calibration)
        self._liveness: Liveness | None = None  # of a bus; of a log that was decided before
        self._tell: Callable[[str], None] = lambda _text: None
        self.absences: tuple[str, ...] = ()  # sentences on the signals that are taken as absent
        self.watch: Callable[[ColumnBatch], None] = lambda _columns: None  # called with all columns, before any event

    def _read(self) -> tuple[SignalReach, Element]:
        """Return what the signals suffice for that are not taken as absent, and the element that they are read for."""
        reach = SignalReach.of(self.decoder, self._calibration)
        return reach, kind_of(self._calibration)(self.decoder, self._calibration, self._basis, reach)

    def judge_liveness(self, tell: Callable[[str], None]) -> None:
        """From now on take signals as absent that stand still where physics demands motion, until they move.

        ``tell`` hears a sentence each time.
        """
        self._liveness, self._tell = Liveness.of(self.decoder.signals), tell

    def feed(self, batch: FrameBatch) -> list[Diagnosis]:
        """Return the diagnoses of the shifts that these frames complete."""
        return [self.conclude(event) for event in self.segment(batch)]

    def segment(self, batch: FrameBatch) -> list[Event]:
        """Return the shifts that these frames complete; quick."""
        return self.decoder.marked(self._events(self.decoder.stream(batch)))

    def _events(self, batches: Iterable[ColumnBatch]) -> Iterator[Event]:
        for columns in batches:
            self.watch(columns)
            yield from self._judged(columns)
            living = {signal: columns.columns[signal] for signal in columns.columns.keys() - self.decoder.absent}
            yield from self._finder.feed(replace(columns, columns=living) if self.decoder.absent else columns)

    def _judged(self, columns: ColumnBatch) -> list[Event]:
        """Take signals as absent, or as living again, by these columns; return the events that this ends."""
        before = self._liveness
        if before is None or (after := before.advanced(columns)) is before:
            return []
        self._liveness = after
        still = [found for found in after.still(LEAST_LIVE) if found.value is not None]
        absent = frozenset(found.signal for found in still)
        if absent == self.decoder.absent:
            return []
        places = {signal: source.place for signal, source in self.decoder.profile_sources.items()}
        texts = {found.signal: found.text(places.get(found.signal, "")) for found in still}
        self.absences = tuple(texts.values())
        for signal, text in texts.items():
            if signal not in self.decoder.absent:
                self._tell(text)
        for signal in sorted(self.decoder.absent - absent):
            self._tell(f"{places.get(signal, signal.value)} moves: it is read again")
        self.decoder.absent = absent
        events = self._finder.flush()
        self.reach, self.element = self._read()
        self._finder = self.element.finder().continuing(self._finder)
        return events

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
        events = list(self._events(self.decoder.drain()))
        self.decoder.interrupt()
        return self.decoder.marked(events + self._finder.flush())

    def conclude(self, event: Event) -> Diagnosis:
        """Diagnose the next shift, and go on from what is believed after it; may take a moment."""
        diagnosis = self.element.conclude(self.belief, event)
        self.belief = diagnosis.belief
        return diagnosis

    def conclude_of_earlier_fluid(self, event: Event) -> Diagnosis:
        """Diagnose an event of a fluid before the present one by itself; what is believed of the present one stays."""
        unknown = replace(self.element.with_new_fluid(self.belief, ""), memory=ConditionMemory())
        diagnosis = self.element.conclude(unknown, event)
        self.belief = replace(self.belief, meaning=diagnosis.belief.meaning)
        return replace(diagnosis, belief=self.belief)

    def note_fluid(self, filled_at: str, *, is_new: bool = True) -> None:
        """Take note of the fluid that the vehicle has, by the moment of its fill.

        New fluid begins a new running friction with a new baseline. If it is not, all that is known is of it.
        """
        belief = self.element.with_new_fluid(self.belief, filled_at) if is_new else self.belief
        self.belief = replace(belief, memory=replace(belief.memory, fluid_since=filled_at))

    def capability(self) -> Capability:
        """Return what the signals that came suffice for."""
        received = self.decoder.seen
        expected = self.decoder.signals - self.decoder.optional_signals
        return Capability(
            profile=self.decoder.profile_name,
            tier=tier_of(received, **self.reach.asked),
            missing=missing_for_next(received, **self.reach.asked),
            elements=self._calibration.elements if self.reach.asked["has_converter"] else (),
            torque=self._calibration.torque if Signal.ENGINE_TORQUE in received else TorqueSource.UNKNOWN,
            unseen=tuple(signal.value for signal in Signal if signal in expected - received),
            needs=needs_of(self.decoder, received, self._calibration.torque, **self.reach.asked),
            absent=self.absences,
        )
