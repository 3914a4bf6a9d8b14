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
from typing import Final, Self

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
SHIFTS: Final = "shifts"  # what friction of a clutch is told by, where its kind has no word of its own
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

    def text(self, counted: str) -> str:
        what = "launches juddered" if counted == SHIFTS else f"{counted} shuddered"
        return f"{sum(self.juddered)} of {len(self.juddered)} {what}"

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
                self.variance_mu_c, alone.mu_c - running.mu_c, alone.random_std_mu_c, running.random_std_mu_c, weight
            ),
            variance_mu_s=_next_variance(
                self.variance_mu_s, alone.mu_s - running.mu_s, alone.random_std_mu_s, running.random_std_mu_s, weight
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


def _next_variance(variance: float, distance: float, alone_std: float, running_std: float, weight: float) -> float:
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


def decide(  # noqa: PLR0911 - each rule may end it
    friction: FrictionEstimate,
    since: FrictionTrend | None,
    reference: FrictionCurve,
    shift_count: int,
    previous: Condition,
    previous_cause: Cause | None,
    launches: Launches,
    common: NormalDist,
    situations: tuple[Situation, ...],
    *,
    counted: str = SHIFTS,
) -> Finding:
    """Return the verdict on a clutch.

    Parameters
    ----------
    friction, since
        Its running friction, and what became of it since the baseline; None: there is no baseline.
    reference
        The calibration's.
    shift_count
        Events that the running friction rests on.
    previous, previous_cause
        The last verdict, which stands until its cause has become unlikely.
    launches
        Which of its launches juddered.
    common
        Which part of the new fluid's margin is left by both clutches together.
    situations
        What the clutch is judged in, but for a margin that is hardly known.
    counted
        What the events are, in many; launches are then such events, too.
    """
    if shift_count < MIN_SHIFT_COUNT:
        few, some = (Silence.FEW_SHIFTS, "shift(s)") if counted == SHIFTS else (Silence.FEW_EVENTS, counted)
        return nothing(few, f"{shift_count} usable {some}, {MIN_SHIFT_COUNT} needed")
    reference_margin = reference.mu_c - reference.mu_s
    margin = NormalDist(friction.mu_c - friction.mu_s, friction.std_slope_s_rad * reference.stribeck_speed_rad_s)
    level = NormalDist(friction.mu_c / reference.mu_c, friction.std_mu_c / reference.mu_c)
    own_thin, common_thin = margin.cdf(WATCH_MARGIN_RATIO * reference_margin), common.cdf(WATCH_MARGIN_RATIO)
    is_early = margin.stdev > EARLY_MARGIN_STD_RATIO * reference_margin
    negative, thin = friction.probability_negative_slope, _thin(own_thin, common_thin, is_early=is_early)
    if is_early and counted == SHIFTS:
        negative, situations = min(negative, common.cdf(0.0)), (*situations, Situation.EARLY)
    give_at = given_at(*situations)
    facts = _facts(friction, level, since, f"{shift_count} {counted}")
    facts += f", {launches.text(counted)}" if launches.speak else ""
    change = {
        Cause.SHUDDER: launches.probability_negative(negative),
        Cause.LEVEL_LOW: level.cdf(CHANGE_LEVEL_RATIO),
        Cause.LOSS_LARGE: _lost(since, CHANGE_LEVEL_RATIO),
    }
    if (bad := _standing(Condition.CHANGE_FLUID, change, give_at, previous, previous_cause, facts)) is not None:
        return bad
    if margin.stdev > MAX_MARGIN_STD_RATIO * reference_margin:
        return nothing(Silence.MARGIN_UNSURE, f"mu_C - mu_S known to {margin.stdev:.4f} only: {facts}")
    watch = {
        Cause.MARGIN_THIN: thin,
        Cause.LEVEL_FALLING: level.cdf(WATCH_LEVEL_RATIO),
        Cause.LOSS_BEGUN: _lost(since, WATCH_LEVEL_RATIO),
    }
    if (bad := _standing(Condition.WATCH, watch, give_at, previous, previous_cause, facts)) is not None:
        return bad
    is_sure = margin.stdev <= SURE_MARGIN_STD_RATIO * reference_margin
    if (doubt := _doubt(watch, own_thin, common_thin, previous, is_sure=is_sure)) is not None:
        return nothing(Silence.MARGIN_UNSURE, f"too early to say, {doubt[0]} ({likely(doubt[1])}): {facts}")
    if launches.speak:
        why, what = (Silence.LAUNCHES_JUDDER, "launches") if counted == SHIFTS else (Silence.SLIP_SWINGS, counted)
        return nothing(why, f"its {what} contradict its friction: {facts}")
    return Finding(condition=Condition.GOOD, reason=facts, ground=None, probability=1.0 - max(watch.values()))


def _thin(own: float, common: float, *, is_early: bool) -> float:
    """Return the probability of a thin margin by that of a clutch and of both: one may be misread, both rarely are."""
    if own > 0.5:  # then both together tell better
        return common if is_early else max(own, common)
    return min(own, common) if is_early else own


def _doubt(
    watch: Mapping[Cause, float], own_thin: float, common_thin: float, previous: Condition, *, is_sure: bool
) -> tuple[Cause, float] | None:
    """Return a cause that is too likely for a fluid to be called good, by its own clutch or by both together."""
    situation = Situation.STILL_GOOD if previous is Condition.GOOD else Situation.UNSURE_BEFORE_GOOD
    may_be_thin = own_thin > THRESHOLDS[Cause.MARGIN_THIN, situation].value
    common_least = THRESHOLDS[Cause.MARGIN_THIN, Situation.BOTH_BEFORE_GOOD].value
    may_be_thin |= common_thin > common_least and previous is not Condition.GOOD
    if may_be_thin and not is_sure:
        return Cause.MARGIN_THIN, max(own_thin, common_thin)
    likeliest = max(watch.items(), key=itemgetter(1))
    return likeliest if likeliest[1] >= THRESHOLDS[likeliest[0], Situation.BEFORE_GOOD].value else None


def decide_up_to_scale(
    slope: FrictionSlope,
    since: FrictionTrend | None,
    reference: FrictionCurve,
    shift_count: int,
    previous: Condition,
    previous_cause: Cause | None,
    launches: Launches,
    situations: tuple[Situation, ...],
) -> Finding:
    """Return the verdict on a clutch whose level of friction is not known; arguments as of `decide`.

    Slope and change are told without it. That friction is low, or sound, is not.
    """
    if shift_count < MIN_SHIFT_COUNT:
        return nothing(Silence.FEW_SHIFTS, f"{shift_count} usable shift(s), {MIN_SHIFT_COUNT} needed")
    facts = ", ".join((
        f"a negative mu-v slope is {likely(slope.probability_negative)}",
        f"mu_S {plus_minus(slope.mu_s_ratio, slope.std_mu_s_ratio, '{:.0f}', scale=100.0)} % of mu_C",
        *(() if since is None else (_changed(since),)),
        f"{shift_count} shifts",
        *((launches.text(SHIFTS),) if launches.speak else ()),
    ))  # fmt: skip
    std_ratio = slope.std_mu_s_ratio / (margin_ratio := 1.0 - reference.mu_s / reference.mu_c)
    falls = slope.probability_negative if std_ratio <= MAX_SLOPE_STD_RATIO else 0.0
    change = {Cause.SHUDDER: launches.probability_negative(falls), Cause.LOSS_LARGE: _lost(since, CHANGE_LEVEL_RATIO)}
    give_at = given_at(*situations, *((Situation.EARLY,) if std_ratio > EARLY_MARGIN_STD_RATIO else ()))
    if (bad := _standing(Condition.CHANGE_FLUID, change, give_at, previous, previous_cause, facts)) is not None:
        return bad
    watch = {Cause.LOSS_BEGUN: _lost(since, WATCH_LEVEL_RATIO)}
    if std_ratio <= MAX_MARGIN_STD_RATIO:
        margin = NormalDist(1.0 - slope.mu_s_ratio, slope.std_mu_s_ratio)
        watch[Cause.MARGIN_THIN] = margin.cdf(WATCH_MARGIN_RATIO * margin_ratio)
    if (bad := _standing(Condition.WATCH, watch, give_at, previous, previous_cause, facts)) is not None:
        return bad
    return nothing(Silence.LEVEL_UNKNOWN, f"engine torque is {slope.torque.replace('_', ' ')}, not measured: {facts}")


def _facts(friction: FrictionEstimate, level: NormalDist, since: FrictionTrend | None, told_by: str) -> str:
    facts = (
        f"a negative mu-v slope is {likely(friction.probability_negative_slope)}, "
        f"mu_C {plus_minus(level.mean, level.stdev, '{:.0f}', scale=100.0)} % of new"
    )
    if since is not None:
        facts += f", {_changed(since)}"
    return f"{facts}, {told_by}"


def _changed(since: FrictionTrend) -> str:
    change = plus_minus(since.change_mu_c_ratio, since.std_change_mu_c_ratio, "{:+.1f}", scale=100.0)
    return f"{change} % since the baseline"


def likely(probability: float) -> str:
    """Return how likely something is, for people; never certain, never impossible."""
    least, most = _STEP, 1.0 - _STEP
    bound = "under " if probability < 0.5 * least else "over " if probability > 1.0 - 0.5 * least else ""
    return f"{bound}{_PERCENT * min(max(probability, least), most):.1f} % likely"


def _lost(since: FrictionTrend | None, level_ratio: float) -> float:
    """Return the probability that mu_C has fallen below a share of the vehicle's own baseline."""
    if since is None:
        return 0.0
    return NormalDist(1.0 + since.change_mu_c_ratio, max(since.std_change_mu_c_ratio, 1e-9)).cdf(level_ratio)


def _standing(
    condition: Condition,
    causes: Mapping[Cause, float],
    give_at: Mapping[Cause, float],
    previous: Condition,
    previous_cause: Cause | None,
    facts: str,
) -> Finding | None:
    """Return a bad verdict by its likeliest cause, or by that for which it was given; None: no cause is likely."""
    given = [cause for cause, probability in causes.items() if probability >= give_at[cause]]
    cause = max(given or causes, key=causes.__getitem__) if given or previous_cause is None else previous_cause
    probability = causes.get(cause, 0.0)
    if not given and (previous is not condition or probability < LEAVE_PROBABILITY):
        return None
    reason = f"{cause} ({likely(probability)}): {facts}"
    return Finding(condition=condition, reason=reason, ground=cause, probability=probability)
