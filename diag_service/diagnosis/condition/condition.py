"""The verdict on a clutch and its fluid; docs/verdict.md justifies its rules."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import hypot, log, prod
from statistics import NormalDist
from typing import ClassVar, Final, Protocol, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, TorqueSource, both_clutches, clutch_of_gear, with_clutch
from clutch_results.curves import CALIBRATED_RATIO
from clutch_results.event_kinds import EventKind, Shudder
from clutch_results.records import (
    Causes,
    ClutchVerdict,
    Condition,
    FrictionEstimate,
    FrictionSlope,
    FrictionTrend,
    LiningChange,
    Reason,
    ScaleFreeFriction,
    ShiftEstimate,
    Status,
    from_plain,
    to_plain,
)
from diag_service.diagnosis.condition.thresholds import FIT_WINDOW, THRESHOLDS, Cause, Silence, Situation
from diag_service.diagnosis.condition.verdict import (
    SHIFTS,
    SLIP_MINUTES,
    ClutchCourse,
    Finding,
    KnownFriction,
    KnownLevel,
    KnownUpToScale,
    Launches,
    RunningScatter,
    advice,
    decide,
    nothing,
)
from diag_service.diagnosis.friction.evidence import PARAMETER_COUNT, Evidence, Knowledge
from diag_service.diagnosis.friction.posterior import (
    Posterior,
    both_frictions,
    calibration_ratio,
    clutch_ratio,
    common_margin,
    common_scale_std_ratio,
    scale_free,
    trend,
)
from diag_service.diagnosis.lockup.state import LockupState
from fleet_contract import JsonObject


@dataclass(frozen=True, slots=True, kw_only=True)
class LiningBaseline:
    """Scale-free friction of one clutch at the baseline of its first fluid; the deviations have no common scale."""

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    shift_count: int

    @classmethod
    def of(cls, free: ScaleFreeFriction, since: FrictionTrend) -> Self:
        """Return the baseline from the friction at the end of the first fluid, and its change until then."""
        ratio_c, ratio_s = 1.0 + since.change_mu_c_ratio, 1.0 + since.change_mu_s_ratio
        return cls(
            mu_c=free.mu_c / ratio_c,
            mu_s=free.mu_s / ratio_s,
            std_mu_c=free.std_mu_c / ratio_c,
            std_mu_s=free.std_mu_s / ratio_s,
            shift_count=since.baseline_shift_count,
        )

    @property
    def is_possible(self) -> bool:
        """Whether a store can have kept such numbers."""
        return min(self.mu_c, self.mu_s) > 0.0 and min(self.std_mu_c, self.std_mu_s) >= 0.0

    def change(self, free: ScaleFreeFriction) -> LiningChange:
        """Return how friction with today's fluid differs.

        The errors of both count as independent: those that they share make the stated deviation too large, not too
        small.
        """
        return LiningChange(
            change_mu_c_ratio=free.mu_c / self.mu_c - 1.0,
            change_mu_s_ratio=free.mu_s / self.mu_s - 1.0,
            std_change_mu_c_ratio=hypot(free.std_mu_c, free.mu_c / self.mu_c * self.std_mu_c) / self.mu_c,
            std_change_mu_s_ratio=hypot(free.std_mu_s, free.mu_s / self.mu_s * self.std_mu_s) / self.mu_s,
            baseline_shift_count=self.shift_count,
        )


MEMORY_FORMAT = 2  # of what is stored
_MISFITS = frozenset({Reason.MISFIT, Reason.ZERO_JUMPED})
CONTRADICTIONS: Final = frozenset({
    *(Reason.PRESSURE_OFF_COMMAND, Reason.SPEEDS_DISAGREE, Reason.SENSOR_FROZEN, Reason.SATURATED, Reason.IMPLAUSIBLE),
})  # fmt: skip
COLD_K: Final = THRESHOLDS[Situation.COLD, Situation.BEGINNING].value  # of a pack
REFUSED_COUNT: Final = int(THRESHOLDS[Silence.DATA_CONTRADICT, Situation.ALWAYS].value)  # events of a clutch, in a row
MAX_MISFIT_SHARE: Final = THRESHOLDS[Silence.CALIBRATION_MISFIT, Situation.ALWAYS].value
MIN_MISFIT_COUNT: Final = THRESHOLDS[Silence.CALIBRATION_MISFIT, Situation.BEGINNING].value
NEW_FLUID_CONTRADICTIONS: Final = THRESHOLDS[Silence.CALIBRATION_MISFIT, Situation.FLUID_IS_NEW].value


class Fit(StrEnum):
    """What a shift says of the calibration that it was estimated with; stored states hold these words."""

    AGREES = "AGREES"
    CONTRADICTS = "SURPRISES"  # it contradicts the running state: the clutch has changed, or the calibration is wrong
    MISFITS = "MISFITS"  # it contradicts the calibration


WARM_K: Final = 343.15  # of a pack: below it parameters move with the oil, by laws that differ from car to car
BEGIN_COUNT: Final = 40  # events of the first stretch: a few drives
LEAST_COUNT: Final = 6.0  # of the last one, before anything is said of causes: of fewer most is wrong
LEAST_FRICTION_COUNT: Final = 1.0  # of them that told a friction, by their weights
FILLED_COUNT: Final = 15.0  # of the first ones after a fill
FORGETTING: Final = 0.97  # weight of an event after each later one: some thirty count
JUDGED_EVERY: Final = 10  # events: a judgement takes as long as an event, a sensor that drifts is soon refused
SENSORS: Final = frozenset({"torque-sensor", "pressure-sensor"})
SENSOR_SHARE: Final = THRESHOLDS[Silence.SENSOR_DRIFTED, Situation.ALWAYS].value  # that a sensor drifts
MEASURED: Final = ("pressure_lag_s", "pressure_reach_ratio", "pressure_short_pa", "fill_time_s", "believed_touch_pa")
LOWER: Final = np.tril_indices(PARAMETER_COUNT)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """What some events said, older ones faded."""

    count: float = 0.0  # events, by their weights
    lower: FloatArray = field(default_factory=lambda: np.zeros(len(LOWER[0])))  # half of the information
    vector: FloatArray = field(default_factory=lambda: np.zeros(PARAMETER_COUNT))
    sums: FloatArray = field(default_factory=lambda: np.zeros((2, len(MEASURED) + 1, 3)))  # weight, value, square

    def with_event(self, estimate: ShiftEstimate, evidence: Evidence | None, forgetting: float) -> Self:
        """Return it after an event; ``evidence`` is None if nothing is said of the parameters."""
        sums, quality, alone = forgetting * self.sums, estimate.shift_quality, estimate.scale_free
        if quality is not None:
            measured = [getattr(quality.control, name) for name in MEASURED]
            sums[clutch_of_gear(estimate.to_gear) - 1, :-1] += [
                (0.0, 0.0, 0.0) if value is None else (1.0, value, value * value) for value in measured
            ]
        if alone is not None:
            value = log(max(alone.mu_c, 1e-3))
            sums[estimate.clutch - 1, -1] += (1.0, value, value * value)
        lower, vector = forgetting * self.lower, forgetting * self.vector
        if evidence is not None:
            lower += evidence.matrix[LOWER]
            vector += evidence.vector
        return type(self)(count=forgetting * self.count + 1.0, lower=lower, vector=vector, sums=sums)

    @property
    def friction_count(self) -> float:
        """Events by their weights that told a friction."""
        return float(self.sums[:, -1, 0].sum())

    @property
    def is_possible(self) -> bool:
        """Whether a store can have kept such numbers."""
        blank, arrays = Stretch(), (self.lower, self.vector, self.sums)
        is_shaped = all(
            array.shape == other.shape
            for array, other in zip(arrays, (blank.lower, blank.vector, blank.sums), strict=True)
        )
        return is_shaped and bool(np.isfinite(np.concatenate(arrays, axis=None)).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleCourse:
    """How a vehicle went: its first events, its last, those after the last fill, and what was found."""

    begun: Stretch = field(default_factory=Stretch)
    now: Stretch = field(default_factory=Stretch)
    filled: Stretch | None = None  # the first events with another fluid than the first; None: there is none
    event_count: int = 0
    found: Causes | None = None

    def with_event(self, estimate: ShiftEstimate, before: Posterior, after: Posterior) -> Self:
        """Return it after an event, by what was known before it and what is after it; cool ones do not count."""
        if after.packs is not None and after.packs.clutch_k[estimate.clutch - 1] < WARM_K:
            return self
        newest, count = after.recent[-1] if after.recent else None, self.event_count + 1
        is_new = newest is not None and not (before.recent and newest is before.recent[-1])
        evidence = newest.evidence if newest is not None and is_new else None
        if self.begun.count < BEGIN_COUNT:
            return replace(self, begun=self.begun.with_event(estimate, evidence, 1.0), event_count=count)
        filled = self.filled
        if filled is not None and filled.count < FILLED_COUNT:
            filled = filled.with_event(estimate, evidence, 1.0)
        return replace(self, now=self.now.with_event(estimate, evidence, FORGETTING), filled=filled, event_count=count)

    @property
    def is_due(self) -> bool:
        """Whether causes are to be told anew: first as soon as they can be, then now and again.

        Events without friction are not enough: nothing would seem to have moved.
        """
        is_enough = self.now.count >= LEAST_COUNT and self.now.friction_count >= LEAST_FRICTION_COUNT
        return is_enough and (self.found is None or self.event_count % JUDGED_EVERY == 0)

    def with_new_fluid(self) -> Self:
        """Return it after a fill: what was last is of the fluid before."""
        if self.begun.count < BEGIN_COUNT:
            return type(self)()
        return replace(self, now=Stretch(), filled=Stretch(), found=None)

    def with_changed_friction(self) -> Self:
        """Return it after friction has changed at once: a mean over both kinds of friction would be of neither.

        What was found before is forgotten, but for a sensor that has drifted: by that friction seems to change as well.
        """
        if self.begun.count < BEGIN_COUNT:
            return type(self)()
        is_by_sensor = max(self.sensor_share(1), self.sensor_share(2)) >= SENSOR_SHARE
        return replace(self, now=Stretch(), found=self.found if is_by_sensor else None)

    @property
    def is_possible(self) -> bool:
        """Whether a store can have kept it."""
        return all(stretch.is_possible for stretch in (self.begun, self.now, self.filled or self.now))

    def sensor_share(self, clutch: int) -> float:
        """Return how likely it is that a sensor by which a clutch is judged has drifted."""
        causes = () if self.found is None else self.found.likely
        of_it = [cause for cause in causes if cause.cause in SENSORS and cause.clutch in {None, clutch}]
        return 1.0 - prod(1.0 - cause.probability for cause in of_it)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionMemory:
    """The last verdict on each clutch, at which hysteresis looks back, and the scatter of its single shifts."""

    conditions: tuple[Condition, Condition] = (Condition.NO_VERDICT, Condition.NO_VERDICT)
    grounds: tuple[Cause | None, Cause | None] = (None, None)  # of bad ones
    scatters: tuple[RunningScatter | None, RunningScatter | None] = (None, None)
    fits: tuple[Fit, ...] = ()  # of the last shifts, the oldest first
    fluid_since: str | None = None  # fill of the fluid that was last judged, ISO 8601 UTC; None: not known
    linings: tuple[LiningBaseline | None, LiningBaseline | None] = (None, None)  # of the first fluid, over all others
    launches: tuple[Launches, Launches] = (Launches(), Launches())  # with this fluid
    course: VehicleCourse = field(default_factory=VehicleCourse)  # of all that causes are told by
    refused: tuple[int, int] = (0, 0)  # of each clutch, since one could be used: sensors contradicted each other

    @property
    def causes(self) -> Causes | None:
        """What is told of causes: of a clutch whose data contradict each other only that a sensor drifts."""
        contradicting = [clutch for clutch, count in enumerate(self.refused, start=1) if count >= REFUSED_COUNT]
        is_told = all(self.course.sensor_share(clutch) >= SENSOR_SHARE for clutch in contradicting)
        return self.course.found if is_told else None

    def with_new_fluid(self, filled_at: str, old: Posterior | None = None) -> Self:
        """Return the memory after a fluid fill: no verdict yet, and what contradicted the old fluid is forgotten.

        Of the first fluid that had a baseline the friction is kept, of a pair whose ``old`` state is known: the
        lining's, whatever the fluid.
        """
        fits = tuple(fit for fit in self.fits if fit is not Fit.CONTRADICTS)
        linings = both_clutches(
            lining or (None if old is None else _lining(old, clutch))
            for clutch, lining in enumerate(self.linings, start=1)
        )
        return replace(
            self,
            conditions=(Condition.NO_VERDICT, Condition.NO_VERDICT),
            fits=fits,
            fluid_since=filled_at,
            linings=linings,
            launches=(Launches(), Launches()),
            course=self.course.with_new_fluid(),
        )

    def with_fit(self, estimate: ShiftEstimate) -> Self:
        """Return the memory after a shift that was held against the calibration, or whose data were refused."""
        refused, index = self.refused, estimate.clutch - 1
        if estimate.status is Status.VALID:
            refused = with_clutch(refused, estimate.clutch, 0) if refused[index] else refused
        elif not CONTRADICTIONS.isdisjoint(estimate.reasons):
            refused = with_clutch(refused, estimate.clutch, refused[index] + 1)
        if not _MISFITS.isdisjoint(estimate.reasons):
            fit = Fit.MISFITS
        elif estimate.status is not Status.VALID:
            return self if refused is self.refused else replace(self, refused=refused)
        else:
            fit = Fit.CONTRADICTS if Reason.NOT_UPDATED in estimate.reasons else Fit.AGREES
        return replace(self, fits=(*self.fits, fit)[-FIT_WINDOW:], refused=refused)

    def with_launch(self, estimate: ShiftEstimate, course: VehicleCourse | None = None) -> Self:
        """Return the memory after an event, which is of interest if it was a launch, and with the course after it."""
        launches = self.launches
        if estimate.kind is EventKind.LAUNCH:
            launches = with_clutch(launches, estimate.clutch, launches[estimate.clutch - 1].with_event(estimate))
        return replace(self, launches=launches, course=course or self.course)

    def with_shudder(self, shudder: Shudder | None) -> Self:
        """Return the memory after a stretch of slip, which is a witness if swings would have shown in it."""
        if shudder is None:
            return self
        return replace(self, launches=with_clutch(self.launches, 1, self.launches[0].with_swings(shudder)))

    def with_changed_friction(self, clutch: int) -> Self:
        """Return the memory after the friction of a clutch has changed: what it did before is no witness of it now."""
        launches = with_clutch(self.launches, clutch, Launches())
        return replace(self, launches=launches, course=self.course.with_changed_friction())

    @property
    def misfit_text(self) -> str:
        """Why no verdict rests on this calibration; empty if one may."""
        misfits, contradictions = self.fits.count(Fit.MISFITS), self.fits.count(Fit.CONTRADICTS)
        count = misfits + contradictions
        if count < MIN_MISFIT_COUNT or count < MAX_MISFIT_SHARE * len(self.fits):
            return ""
        if not misfits and contradictions <= NEW_FLUID_CONTRADICTIONS:
            return ""
        return f"calibration does not fit: {count} of the last {len(self.fits)} shifts contradict it"

    def with_shift(self, estimate: ShiftEstimate, before: Posterior) -> Self:
        """Return the memory after a shift, of which the running state stood at ``before``.

        Only a shift that entered the running state counts, and only if there was one before it.
        """
        index, alone = estimate.clutch - 1, estimate.friction
        if alone is None or estimate.status is not Status.VALID or Reason.NOT_UPDATED in estimate.reasons:
            return self
        if not before.shift_counts[index]:
            return self
        known = self.scatters[index] or RunningScatter.begun(alone)
        scatter = known.with_shift(alone, both_frictions(before, estimate.clutch, before.stated)[0])
        return replace(self, scatters=with_clutch(self.scatters, estimate.clutch, scatter))

    def with_finding(self, clutch: int, finding: Finding) -> Self:
        """Return the memory after a verdict; most are as the last was."""
        cause = finding.ground if isinstance(finding.ground, Cause) else None
        if (self.conditions[clutch - 1], self.grounds[clutch - 1]) == (finding.condition, cause):
            return self
        conditions = with_clutch(self.conditions, clutch, finding.condition)
        return replace(self, conditions=conditions, grounds=with_clutch(self.grounds, clutch, cause))

    def to_json(self) -> JsonObject:
        """Return the memory as JSON-ready values; floats survive the round trip bit by bit."""
        names = {"conditions": [condition.name for condition in self.conditions]}
        plain = to_plain(self)
        if self.fluid_since is None:  # a vehicle without a fill is kept as by programs that know none
            del plain["fluid_since"], plain["linings"]
        if not self.course.event_count:
            del plain["course"]
        for name, blank in {"launches": (Launches(), Launches()), "grounds": (None, None), "refused": (0, 0)}.items():
            if getattr(self, name) == blank:
                del plain[name]
        return {"format": MEMORY_FORMAT} | plain | names

    @classmethod
    def from_json(cls, table: Mapping[str, object]) -> Self:
        """Rebuild a memory saved by `to_json`; stores of earlier versions know of no fits.

        Raises ValueError if the table is not such a memory.
        """
        if table.get("format") != MEMORY_FORMAT:
            raise ValueError(f"condition memory of format {table.get('format')!r}, expected {MEMORY_FORMAT}")
        try:
            names, scatters = table["conditions"], table["scatters"]
            conditions = [Condition[name] for name in names] if isinstance(names, list) else names
            memory = from_plain({**table, "conditions": conditions, "scatters": scatters}, cls)
        except (KeyError, TypeError, ValueError) as exc:
            raise ValueError(f"not a condition memory: {exc}") from exc
        if not memory.course.is_possible:
            raise ValueError("impossible course")
        for lining in memory.linings:
            if lining is not None and not lining.is_possible:
                raise ValueError(f"impossible lining {lining!r}")
        for scatter in memory.scatters:
            if scatter is not None and not scatter.is_possible:
                raise ValueError(f"impossible scatter {scatter!r}")
        return memory


class JudgedClutch(Protocol):
    """A clutch with all that is known of it after an event."""

    @property
    def clutch(self) -> int:
        """1 or 2."""

    @property
    def misfit(self) -> tuple[Silence, str]:
        """What is said where the calibration does not fit, and what to do."""

    def case(self, memory: ConditionMemory) -> KnownFriction:
        """Return what its verdict is decided by."""

    def noted(self, finding: Finding) -> Finding:
        """Return a finding with what limits it."""

    def verdict(self, memory: ConditionMemory, finding: Finding) -> ClutchVerdict:
        """Return a finding as it is reported."""


def judge(memory: ConditionMemory, judged: JudgedClutch) -> tuple[ConditionMemory, ClutchVerdict]:
    """Return the verdict on a clutch, and the memory with it.

    Each cause (negative slope, low friction, lost friction, thin margin) has a probability. A verdict is given when the
    probability of a cause reaches its threshold and kept until that has fallen below the one to call it off.
    """
    finding = _silenced(memory, judged) or judged.noted(decide(judged.case(memory)))
    return memory.with_finding(judged.clutch, finding), judged.verdict(memory, finding)


def _silenced(memory: ConditionMemory, judged: JudgedClutch) -> Finding | None:
    """Return why its events are no ground for a verdict; None: they are."""
    if memory.misfit_text:
        silence, what_to_do = judged.misfit
        return nothing(silence, memory.misfit_text + what_to_do)
    if (count := memory.refused[judged.clutch - 1]) >= REFUSED_COUNT:
        return nothing(Silence.DATA_CONTRADICT, f"{Silence.DATA_CONTRADICT} ({count} events)")
    if memory.course.found is not None and (share := memory.course.sensor_share(judged.clutch)) >= SENSOR_SHARE:
        return nothing(Silence.SENSOR_DRIFTED, f"{Silence.SENSOR_DRIFTED} ({100.0 * share:.0f} % likely)")
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class PairClutch:
    """A clutch of a pair; `of` makes one."""

    clutch: int
    misfit: ClassVar[tuple[Silence, str]] = (
        Silence.CALIBRATION_MISFIT, "; diag-service calibrate makes one for this vehicle",
    )  # fmt: skip
    state: Posterior
    calibration: Calibration
    stated: Knowledge
    friction: FrictionEstimate
    free: ScaleFreeFriction
    since: FrictionTrend | None
    slope: FrictionSlope | None  # where no level is known
    shift_counts: tuple[int, int]  # of both clutches
    progress: float  # 0 to 1: how far the vehicle has calibrated itself

    @classmethod
    def of(cls, state: Posterior, clutch: int, calibration: Calibration) -> Self:
        """Return clutch 1 or 2 with what its running state says."""
        stated, shift_counts = state.stated, state.shift_counts
        friction, free = both_frictions(state, clutch, stated)
        return cls(
            clutch=clutch,
            state=state,
            calibration=calibration,
            stated=stated,
            friction=friction,
            free=free,
            since=trend(state, clutch) if shift_counts[clutch - 1] else None,
            slope=None if state.torque is TorqueSource.MEASURED else FrictionSlope.of(free, state.torque),
            shift_counts=shift_counts,
            progress=calibration_ratio(state, calibration),
        )

    def case(self, memory: ConditionMemory) -> KnownFriction:
        index = self.clutch - 1
        reference = self.calibration.clutches[index].friction
        course = ClutchCourse(
            counted=SHIFTS,
            shift_count=self.shift_counts[index],
            since=self.since,
            launches=memory.launches[index],
            previous=memory.conditions[index],
            previous_cause=memory.grounds[index],
            situations=self._situations(),
        )
        if self.slope is not None:
            return KnownUpToScale.of(self.slope, reference, course)
        first, second = [clutch.friction for clutch in self.calibration.clutches]
        common = common_margin(self.state, self.stated, (first.mu_c - first.mu_s, second.mu_c - second.mu_s))
        return KnownLevel.of(self.friction, reference, common, course)

    def _situations(self) -> tuple[Situation, ...]:
        packs = self.state.packs
        is_cold = packs is not None and packs.clutch_k[self.clutch - 1] < COLD_K
        if not is_cold and self.progress >= CALIBRATED_RATIO:
            return ()
        if self.slope is not None:
            return (Situation.UNSURE_UP_TO_SCALE,)
        return (Situation.COLD if is_cold else Situation.CALIBRATING,)

    def noted(self, finding: Finding) -> Finding:
        if not self.shift_counts[self.clutch - 1] or self.progress >= CALIBRATED_RATIO:
            return finding
        return replace(finding, reason=f"{finding.reason}, calibrating: {100.0 * self.progress:.0f} %")

    def verdict(self, memory: ConditionMemory, finding: Finding) -> ClutchVerdict:
        index, known = self.clutch - 1, bool(self.shift_counts[self.clutch - 1])
        scatter, lining, tells_level = memory.scatters[index], memory.linings[index], known and self.slope is None
        new_mu_c = self.calibration.clutches[index].friction.mu_c
        return ClutchVerdict(
            clutch=self.clutch,
            condition=finding.condition,
            reason=finding.reason,
            level_ratio=self.friction.mu_c / new_mu_c if tells_level else None,
            friction=self.friction if tells_level else None,
            shift_count=self.shift_counts[index],
            scale_free=self.free if known else None,
            common_scale_std_ratio=common_scale_std_ratio(self.state, self.clutch) if tells_level else None,
            shift_scatter=None if scatter is None else scatter.reported,
            trend=self.since,
            clutch_ratio=clutch_ratio(self.stated) if all(self.shift_counts) else None,
            lining=lining.change(self.free) if lining is not None and known else None,
            stick_slip=memory.launches[index].reported,
            calibration_ratio=self.progress,
            advice=advice(self.clutch, finding.ground, finding.probability),
            slope=self.slope if known else None,
            causes=memory.causes,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConverterClutch:
    """The lock-up clutch of a converter; stretches in which its slip swung are a witness as launches are."""

    clutch: ClassVar[int] = 1
    misfit: ClassVar[tuple[Silence, str]] = (Silence.CONVERTER_MISFIT, "")
    state: LockupState
    calibration: Calibration
    friction: FrictionEstimate
    since: FrictionTrend | None
    shudder: Shudder | None

    @classmethod
    def of(cls, state: LockupState, calibration: Calibration, shudder: Shudder | None) -> Self:
        """Return it with what its running state says; ``shudder`` is what its last stretch of slip showed."""
        friction, since = state.friction(), state.trend()
        return cls(state=state, calibration=calibration, friction=friction, since=since, shudder=shudder)

    def case(self, memory: ConditionMemory) -> KnownFriction:
        reference, now = self.calibration.clutches[0].friction, self.friction
        left = NormalDist(now.mu_c - now.mu_s, now.std_slope_s_rad * reference.stribeck_speed_rad_s)
        course = ClutchCourse(
            counted=SLIP_MINUTES,
            shift_count=self.state.shift_count,
            since=self.since,
            launches=memory.launches[0],
            previous=memory.conditions[0],
            previous_cause=memory.grounds[0],
            situations=(Situation.LOCKUP,),
        )
        return KnownLevel.of(now, reference, left / (reference.mu_c - reference.mu_s), course)

    def noted(self, finding: Finding) -> Finding:
        """Return the finding: it does not wait for a calibration."""
        return finding

    def verdict(self, memory: ConditionMemory, finding: Finding) -> ClutchVerdict:  # noqa: ARG002 - no more of it
        state, element, known = self.state, self.calibration.elements[0], bool(self.state.shift_count)
        return ClutchVerdict(
            clutch=1,
            condition=finding.condition,
            reason=finding.reason,
            level_ratio=self.friction.mu_c / self.calibration.clutches[0].friction.mu_c if known else None,
            friction=self.friction if known else None,
            shift_count=state.shift_count,
            scale_free=state.scale_free() if known else None,
            common_scale_std_ratio=state.scale_ratio() if known else None,
            trend=self.since,
            advice=advice(1, finding.ground, finding.probability, element),
            micro_slip=state.micro_slip(self.shudder) if known else None,
            element=element,
        )


def _lining(state: Posterior, clutch: int) -> LiningBaseline | None:
    since = trend(state, clutch)
    return None if since is None else LiningBaseline.of(scale_free(state, clutch), since)


def no_verdict(clutch: int, missing: str, silence: Silence = Silence.SIGNALS_MISSING) -> ClutchVerdict:
    """Return what is said of a clutch whose friction cannot be known: nothing, and what is missing for more."""
    return ClutchVerdict(
        clutch=clutch,
        condition=Condition.NO_VERDICT,
        reason=f"friction cannot be estimated from these signals: {missing}",
        level_ratio=None,
        friction=None,
        shift_count=0,
        advice=advice(clutch, silence),
    )


def failed_verdict(clutch: int) -> ClutchVerdict:
    """Return what is said of a clutch of which nothing is known but an event over which the program failed."""
    verdict = no_verdict(clutch, "", Silence.INTERNAL_ERROR)
    return replace(verdict, reason="the program failed over its event")
