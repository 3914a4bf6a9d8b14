"""What a verdict rests on: thresholds, launches, scatter, and the probability of each cause; docs/verdict.md says why.

`Launches` are a witness for the sign of the slope that needs no torque: friction that falls with the slip lets a soft
driveline swing as a clutch sticks. A launch without it says nothing: with little load worn fluid does not swing either.
`RunningScatter` is measured, not stated: how far single shifts of a clutch lie from the running estimate. `advice` is
one plain sentence for a workshop. It holds no order: both clutches slip in one oil, so `fleet_contract.orders` makes
one order of what both of them say.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import itemgetter
from statistics import NormalDist
from typing import Final, NamedTuple, Protocol, Self

from clutch_model.calibration import FrictionCurve
from clutch_results.event_kinds import EndReason, EventKind, Shudder
from clutch_results.records import (
    Condition,
    FrictionEstimate,
    FrictionSlope,
    FrictionTrend,
    ShiftEstimate,
    ShiftScatter,
    StickSlip,
)
from clutchdiag_io.people import plus_minus
from diag_service.diagnosis.condition.thresholds import (
    MIN_SHIFT_COUNT,
    THRESHOLDS,
    Cause,
    Silence,
    Situation,
    given_at,
)
from fleet_contract.orders import title_of

MAX_MARGIN_STD_RATIO: Final = THRESHOLDS[Silence.MARGIN_UNSURE, Situation.ALWAYS].value
SURE_MARGIN_STD_RATIO: Final = THRESHOLDS[Situation.UNSURE_BEFORE_GOOD, Situation.BEGINNING].value
MAX_SLOPE_STD_RATIO: Final = THRESHOLDS[Silence.MARGIN_UNSURE, Situation.UP_TO_SCALE].value
EARLY_MARGIN_STD_RATIO: Final = THRESHOLDS[Situation.EARLY, Situation.BEGINNING].value
LEAVE_PROBABILITY: Final = THRESHOLDS[Cause.SHUDDER, Situation.STANDING].value
WATCH_MARGIN_RATIO: Final = THRESHOLDS[Cause.MARGIN_THIN, Situation.MEANING].value
CHANGE_LEVEL_RATIO: Final = THRESHOLDS[Cause.LEVEL_LOW, Situation.MEANING].value
WATCH_LEVEL_RATIO: Final = THRESHOLDS[Cause.LEVEL_FALLING, Situation.MEANING].value
_PERCENT: Final = 100.0  # of a ratio
_NEARLY_SURE: Final = 0.995  # beyond it a rounded percentage would promise certainty
_STEP: Final = 0.001  # to which a reason says a probability
_WHAT: Final = {
    Cause.SHUDDER: "it can shudder",
    Cause.LEVEL_LOW: f"its friction is below {_PERCENT * CHANGE_LEVEL_RATIO:.0f} % of new",
    Cause.LOSS_LARGE: f"it has lost more than {_PERCENT * (1.0 - CHANGE_LEVEL_RATIO):.0f} % of its own friction",
    Cause.MARGIN_THIN: "more than half of its margin against shudder is gone",
    Cause.LEVEL_FALLING: f"its friction is below {_PERCENT * WATCH_LEVEL_RATIO:.0f} % of new",
    Cause.LOSS_BEGUN: f"it has lost more than {_PERCENT * (1.0 - WATCH_LEVEL_RATIO):.0f} % of its own friction",
}


def advice(clutch: int, ground: Cause | Silence | None, probability: float = 0.0, element: str | None = None) -> str:
    """Return the sentence on a clutch, by its name if it has one of its own.

    Parameters
    ----------
    ground :
        What the verdict rests on: a cause, or why there is none; None where nothing speaks against the fluid.
    probability :
        That the cause is there; of a good fluid, that none of them is.
    """
    title = title_of(clutch, element) if element else f"Clutch {clutch}"
    if isinstance(ground, Silence):
        return f"{title}: {ground}."
    if ground is None:
        return f"{title}: its friction is sound ({_percent(probability)} sure)."
    return f"{title}: {_WHAT[ground]} ({_until_called_off(probability, given_at()[ground])})."


def _until_called_off(probability: float, given_at: float) -> str:
    """Return how sure a cause is; of a verdict that merely stands also what to do and what calls it off."""
    if probability >= given_at:
        return f"{_percent(probability)} sure"
    return (
        f"{_percent(probability)} sure now, at least {_percent(given_at)} before: measure again on another drive; "
        f"the verdict stands until that falls below {_percent(LEAVE_PROBABILITY)}"
    )


def _percent(probability: float) -> str:
    return "over 99 %" if probability > _NEARLY_SURE else f"{_PERCENT * probability:.0f} %"


JUDDER_RAD_S: Final = THRESHOLDS[Silence.LAUNCHES_JUDDER, Situation.MEANING].value
LEAST_COUNT: Final = THRESHOLDS[Silence.LAUNCHES_JUDDER, Situation.ALWAYS].value
LEAST_SWUNG_SHARE: Final = THRESHOLDS[Silence.SLIP_SWINGS, Situation.MEANING].value
LEAST_SWUNG_COUNT: Final = THRESHOLDS[Silence.SLIP_SWINGS, Situation.BEGINNING].value
LAUNCH_WINDOW: Final = 20  # launches of a clutch that are remembered
EVIDENCE_RATIO: Final = 10.0  # for each beyond the first: half of the launches of aged fluid, none of 102 of others
MOST_EVIDENCE_RATIO: Final = 20.0  # drivelines differ: a witness that nobody has calibrated does not decide alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Launches:
    """Which of the last launches of one clutch juddered, the oldest first."""

    juddered: tuple[bool, ...] = ()

    def with_event(self, estimate: ShiftEstimate) -> Self:
        """Return what is remembered after an event: a launch to lock whose slip is known counts, nothing else."""
        indices = estimate.indices
        if estimate.kind is not EventKind.LAUNCH or estimate.end_reason is not EndReason.COMPLETE:
            return self
        if indices is None or indices.reslip_rad_s is None:
            return self
        return replace(self, juddered=(*self.juddered, indices.reslip_rad_s > JUDDER_RAD_S)[-LAUNCH_WINDOW:])

    def with_swings(self, shudder: Shudder) -> Self:
        """Return what is remembered after a stretch in which a clutch was let slip."""
        swung = shudder.seen_count >= max(LEAST_SWUNG_COUNT, LEAST_SWUNG_SHARE * shudder.window_count)
        return replace(self, juddered=(*self.juddered, swung)[-LAUNCH_WINDOW:])

    @property
    def reported(self) -> StickSlip | None:
        """What is said of them; None before there is one."""
        if not self.juddered:
            return None
        return StickSlip(launch_count=len(self.juddered), judder_count=sum(self.juddered))

    @property
    def speak(self) -> bool:
        """Whether enough of them juddered to say something of the slope."""
        return sum(self.juddered) >= LEAST_COUNT

    def text(self, swung: str) -> str:
        return f"{sum(self.juddered)} of {len(self.juddered)} {swung}"

    def probability_negative(self, by_friction: float) -> float:
        """Return the probability of a negative slope, given what friction alone says of it."""
        if not self.speak:
            return by_friction
        ratio = min(EVIDENCE_RATIO ** (sum(self.juddered) - 1), MOST_EVIDENCE_RATIO)
        return by_friction * ratio / (by_friction * ratio + 1.0 - by_friction)


LEAST_SHIFT_COUNT = 8  # the deviation is then known to a quarter of itself
MEMORY_SHIFT_COUNT = 50  # a few hours of driving
STATED_WEIGHT = 4.0  # shifts that the stated deviation of the first counts for: something to clip against
CLIP_STD = 3.0  # a shift farther away counts as if it were so far; takes 0.5 % from the variance of normal ones


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningScatter:
    """Running variances of single shifts about the running estimate, recursive and with outliers clipped."""

    variance_mu_c: float
    variance_mu_s: float
    shift_count: int

    @classmethod
    def begun(cls, alone: FrictionEstimate) -> Self:
        """Return the scatter to expect before any was seen: the random deviation that a shift states."""
        return cls(variance_mu_c=alone.random_std_mu_c**2, variance_mu_s=alone.random_std_mu_s**2, shift_count=0)

    def with_shift(self, alone: FrictionEstimate, running: FrictionEstimate) -> Self:
        """Return the scatter after another shift.

        Parameters
        ----------
        alone : FrictionEstimate
            Of the shift for itself.
        running : FrictionEstimate
            Of the clutch before the shift; its own random deviation is taken out.
        """
        count = self.shift_count + 1
        weight = 1.0 / (STATED_WEIGHT + min(count, MEMORY_SHIFT_COUNT))
        return type(self)(
            variance_mu_c=_next_variance(
                self.variance_mu_c, alone.mu_c - running.mu_c, (alone.random_std_mu_c, running.random_std_mu_c), weight
            ),
            variance_mu_s=_next_variance(
                self.variance_mu_s, alone.mu_s - running.mu_s, (alone.random_std_mu_s, running.random_std_mu_s), weight
            ),
            shift_count=count,
        )

    @property
    def is_possible(self) -> bool:
        """Whether shifts can scatter so; what was stored may be damaged."""
        return 0.0 < self.variance_mu_c < 1.0 and 0.0 < self.variance_mu_s < 1.0 and self.shift_count >= 0

    @property
    def reported(self) -> ShiftScatter | None:
        """What a result says of it; None before there were enough shifts."""
        if self.shift_count < LEAST_SHIFT_COUNT:
            return None
        return ShiftScatter(
            std_mu_c=self.variance_mu_c**0.5, std_mu_s=self.variance_mu_s**0.5, shift_count=self.shift_count
        )


def _next_variance(variance: float, distance: float, stds: tuple[float, float], weight: float) -> float:
    """Return the variance after a ``distance`` between two numbers with these deviations, of which the first counts."""
    alone_std, running_std = stds
    share = alone_std**2 / (alone_std**2 + running_std**2)
    return variance + weight * (min(share * distance**2, CLIP_STD**2 * variance) - variance)


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A verdict and what it rests on; the probability is that of the cause, of a good fluid that there is none."""

    condition: Condition
    reason: str
    ground: Cause | Silence | None
    probability: float = 0.0


def nothing(silence: Silence, reason: str) -> Finding:
    """Return that there is no verdict, and why."""
    return Finding(condition=Condition.NO_VERDICT, reason=reason, ground=silence)


class EventNames(NamedTuple):
    """What the events of a clutch are called, and those of them that are a witness of its slope."""

    some: str
    many: str
    few: Silence  # where there are too few
    swung: str  # witnesses that speak against the slope
    witnesses: str
    swings: Silence  # where they contradict friction


SHIFTS: Final = EventNames(
    "shift(s)", "shifts", Silence.FEW_SHIFTS, "launches juddered", "launches", Silence.LAUNCHES_JUDDER
)
SLIP_MINUTES: Final = EventNames(
    "minutes of slip", "minutes of slip", Silence.FEW_EVENTS, "minutes of slip shuddered", "minutes of slip",
    Silence.SLIP_SWINGS,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchCourse:
    """What is known of a clutch beside its friction."""

    counted: EventNames
    shift_count: int  # events that the running friction rests on
    since: FrictionTrend | None  # what became of it since the baseline; None: there is no baseline
    launches: Launches  # which of its launches juddered, or stretches of slip swung
    previous: Condition  # the last verdict, which stands until its cause has become unlikely
    previous_cause: Cause | None
    situations: tuple[Situation, ...]  # that hold, whatever its friction

    @property
    def told_by(self) -> str:
        """What friction is told by, and what launches say to it."""
        text = f"{self.shift_count} {self.counted.many}"
        return f"{text}, {self.launches.text(self.counted.swung)}" if self.launches.speak else text

    def lost(self, level_ratio: float) -> float:
        """Return the probability that mu_C has fallen below a share of the vehicle's own baseline."""
        if (since := self.since) is None:
            return 0.0
        return NormalDist(1.0 + since.change_mu_c_ratio, max(since.std_change_mu_c_ratio, 1e-9)).cdf(level_ratio)


class KnownFriction(Protocol):
    """Friction of a clutch as far as it is known, and what speaks for each verdict."""

    @property
    def course(self) -> ClutchCourse:
        """What is known beside it."""

    @property
    def facts(self) -> str:
        """All of it in words."""

    @property
    def situations(self) -> tuple[Situation, ...]:
        """What the clutch is judged in."""

    def change(self) -> Mapping[Cause, float]:
        """Return the probability of each cause to change the fluid."""

    def unknown(self) -> Finding | None:
        """Return why nothing more can be said; None: something can."""

    def watch(self) -> Mapping[Cause, float]:
        """Return the probability of each cause to watch the fluid."""

    def without_cause(self, watch: Mapping[Cause, float]) -> Finding:
        """Return what is said where no cause is likely enough to ``watch``."""


def decide(case: KnownFriction) -> Finding:
    """Return the verdict on a clutch: the rules of docs/verdict.md in their order."""
    count, counted = case.course.shift_count, case.course.counted
    if count < MIN_SHIFT_COUNT:
        return nothing(counted.few, f"{count} usable {counted.some}, {MIN_SHIFT_COUNT} needed")
    if (bad := _standing(Condition.CHANGE_FLUID, case.change(), case)) is not None:
        return bad
    if (unknown := case.unknown()) is not None:
        return unknown
    watch = case.watch()
    bad = _standing(Condition.WATCH, watch, case)
    return case.without_cause(watch) if bad is None else bad


def _standing(condition: Condition, causes: Mapping[Cause, float], case: KnownFriction) -> Finding | None:
    """Return a bad verdict by its likeliest cause, or by that for which it was given; None: no cause is likely."""
    course, give_at = case.course, given_at(*case.situations)
    given = [cause for cause, probability in causes.items() if probability >= give_at[cause]]
    likeliest = max(given or causes, key=causes.__getitem__)
    cause = likeliest if given or course.previous_cause is None else course.previous_cause
    probability = causes.get(cause, 0.0)
    if not given and (course.previous is not condition or probability < LEAVE_PROBABILITY):
        return None
    reason = f"{cause} ({likely(probability)}): {case.facts}"
    return Finding(condition=condition, reason=reason, ground=cause, probability=probability)


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownLevel:
    """A clutch whose level of friction is known, as torque is measured; `of` makes one."""

    course: ClutchCourse
    situations: tuple[Situation, ...]
    friction: FrictionEstimate
    level: NormalDist  # mu_C over that of new fluid
    margin: NormalDist  # mu_C - mu_S
    new_margin: float  # of new fluid
    common: NormalDist  # part of new fluid's margin that is left by both clutches together
    own_thin: float  # probability that less than half of the margin is left, by this clutch
    common_thin: float  # likewise by both together

    @classmethod
    def of(cls, friction: FrictionEstimate, reference: FrictionCurve, common: NormalDist, course: ClutchCourse) -> Self:
        """Return the case of running friction; ``common`` is the part of new fluid's margin left by both clutches."""
        new_margin = reference.mu_c - reference.mu_s
        margin = NormalDist(friction.mu_c - friction.mu_s, friction.std_slope_s_rad * reference.stribeck_speed_rad_s)
        level = NormalDist(friction.mu_c / reference.mu_c, friction.std_mu_c / reference.mu_c)
        is_early = margin.stdev > EARLY_MARGIN_STD_RATIO * new_margin
        return cls(
            course=course,
            situations=(*course.situations, Situation.EARLY) if is_early else course.situations,
            friction=friction,
            level=level,
            margin=margin,
            new_margin=new_margin,
            common=common,
            own_thin=margin.cdf(WATCH_MARGIN_RATIO * new_margin),
            common_thin=common.cdf(WATCH_MARGIN_RATIO),
        )

    @property
    def facts(self) -> str:
        negative, since = likely(self.friction.probability_negative_slope), self.course.since
        level = plus_minus(self.level.mean, self.level.stdev, "{:.0f}", scale=_PERCENT)
        changed = () if since is None else (_changed(since),)
        return ", ".join(
            (f"a negative mu-v slope is {negative}", f"mu_C {level} % of new", *changed, self.course.told_by)
        )

    def change(self) -> Mapping[Cause, float]:
        negative = self.friction.probability_negative_slope
        if Situation.EARLY in self.situations:  # one clutch may be misread
            negative = min(negative, self.common.cdf(0.0))
        return {
            Cause.SHUDDER: self.course.launches.probability_negative(negative),
            Cause.LEVEL_LOW: self.level.cdf(CHANGE_LEVEL_RATIO),
            Cause.LOSS_LARGE: self.course.lost(CHANGE_LEVEL_RATIO),
        }

    def unknown(self) -> Finding | None:
        if self.margin.stdev <= MAX_MARGIN_STD_RATIO * self.new_margin:
            return None
        return nothing(Silence.MARGIN_UNSURE, f"mu_C - mu_S known to {self.margin.stdev:.4f} only: {self.facts}")

    def watch(self) -> Mapping[Cause, float]:
        return {
            Cause.MARGIN_THIN: self._thin(),
            Cause.LEVEL_FALLING: self.level.cdf(WATCH_LEVEL_RATIO),
            Cause.LOSS_BEGUN: self.course.lost(WATCH_LEVEL_RATIO),
        }

    def without_cause(self, watch: Mapping[Cause, float]) -> Finding:
        if (doubt := self._doubt(watch)) is not None:
            return nothing(Silence.MARGIN_UNSURE, f"too early to say, {doubt[0]} ({likely(doubt[1])}): {self.facts}")
        if self.course.launches.speak:
            counted = self.course.counted
            return nothing(counted.swings, f"its {counted.witnesses} contradict its friction: {self.facts}")
        sound = 1.0 - max(watch.values())
        return Finding(condition=Condition.GOOD, reason=self.facts, ground=None, probability=sound)

    def _thin(self) -> float:
        """Return the probability of a thin margin by that of a clutch and of both: one may be misread, both rarely."""
        own, common, is_early = self.own_thin, self.common_thin, Situation.EARLY in self.situations
        if own > 0.5:  # then both together tell better
            return common if is_early else max(own, common)
        return min(own, common) if is_early else own

    def _doubt(self, watch: Mapping[Cause, float]) -> tuple[Cause, float] | None:
        """Return a cause that is too likely for a fluid to be called good, by its own clutch or by both together."""
        was_good = self.course.previous is Condition.GOOD
        own_most = THRESHOLDS[Cause.MARGIN_THIN, Situation.STILL_GOOD if was_good else Situation.UNSURE_BEFORE_GOOD]
        common_most = THRESHOLDS[Cause.MARGIN_THIN, Situation.BOTH_BEFORE_GOOD]
        may_be_thin = self.own_thin > own_most.value or (self.common_thin > common_most.value and not was_good)
        if may_be_thin and self.margin.stdev > SURE_MARGIN_STD_RATIO * self.new_margin:
            return Cause.MARGIN_THIN, max(self.own_thin, self.common_thin)
        likeliest = max(watch.items(), key=itemgetter(1))
        return likeliest if likeliest[1] >= THRESHOLDS[likeliest[0], Situation.BEFORE_GOOD].value else None


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownUpToScale:
    """A clutch whose level of friction is not known: slope and change are told without it, not that it is sound."""

    course: ClutchCourse
    situations: tuple[Situation, ...]
    slope: FrictionSlope
    new_margin_ratio: float  # of new fluid, over its mu_C
    std_ratio: float  # deviation of the margin over that of new fluid

    @classmethod
    def of(cls, slope: FrictionSlope, reference: FrictionCurve, course: ClutchCourse) -> Self:
        """Return the case of a slope that no scale moves."""
        std_ratio = slope.std_mu_s_ratio / (new_margin_ratio := 1.0 - reference.mu_s / reference.mu_c)
        return cls(
            course=course,
            situations=(*course.situations, *((Situation.EARLY,) if std_ratio > EARLY_MARGIN_STD_RATIO else ())),
            slope=slope,
            new_margin_ratio=new_margin_ratio,
            std_ratio=std_ratio,
        )

    @property
    def facts(self) -> str:
        negative, since = likely(self.slope.probability_negative), self.course.since
        mu_s = plus_minus(self.slope.mu_s_ratio, self.slope.std_mu_s_ratio, "{:.0f}", scale=_PERCENT)
        changed = () if since is None else (_changed(since),)
        return ", ".join(
            (f"a negative mu-v slope is {negative}", f"mu_S {mu_s} % of mu_C", *changed, self.course.told_by)
        )

    def change(self) -> Mapping[Cause, float]:
        falls = self.slope.probability_negative if self.std_ratio <= MAX_SLOPE_STD_RATIO else 0.0
        return {
            Cause.SHUDDER: self.course.launches.probability_negative(falls),
            Cause.LOSS_LARGE: self.course.lost(CHANGE_LEVEL_RATIO),
        }

    def unknown(self) -> Finding | None:
        """Return None: that friction is falling is told however badly the margin is known."""
        return None

    def watch(self) -> Mapping[Cause, float]:
        lost = {Cause.LOSS_BEGUN: self.course.lost(WATCH_LEVEL_RATIO)}
        if self.std_ratio > MAX_MARGIN_STD_RATIO:
            return lost
        margin = NormalDist(1.0 - self.slope.mu_s_ratio, self.slope.std_mu_s_ratio)
        return {**lost, Cause.MARGIN_THIN: margin.cdf(WATCH_MARGIN_RATIO * self.new_margin_ratio)}

    def without_cause(self, watch: Mapping[Cause, float]) -> Finding:  # noqa: ARG002 - nothing makes it good
        source = self.slope.torque.replace("_", " ")
        return nothing(Silence.LEVEL_UNKNOWN, f"engine torque is {source}, not measured: {self.facts}")


def _changed(since: FrictionTrend) -> str:
    change = plus_minus(since.change_mu_c_ratio, since.std_change_mu_c_ratio, "{:+.1f}", scale=100.0)
    return f"{change} % since the baseline"


def likely(probability: float) -> str:
    """Return how likely something is, for people; never certain, never impossible."""
    least, most = _STEP, 1.0 - _STEP
    bound = "under " if probability < 0.5 * least else "over " if probability > 1.0 - 0.5 * least else ""
    return f"{bound}{_PERCENT * min(max(probability, least), most):.1f} % likely"
