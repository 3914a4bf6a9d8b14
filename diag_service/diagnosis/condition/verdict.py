"""What a verdict rests on: thresholds, launches, scatter, and the probability of each cause; docs/verdict.md says why.

`Launches` are a witness for the sign of the slope that needs no torque: friction that falls with the slip lets a soft
driveline swing as a clutch sticks. A launch without it says nothing: with little load worn fluid does not swing either.
`RunningScatter` is measured, not stated: how far single shifts of a clutch lie from the running estimate. `advice` is
one plain sentence for a workshop. It holds no order: both clutches slip in one oil, so `fleet_contract.orders` makes
one order of what both of them say.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from operator import itemgetter
from statistics import NormalDist
from typing import Final, Self

from clutch_model.calibration import FrictionCurve
from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
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
from fleet_contract.orders import LEVEL_UNTOLD, UNTOLD, title_of

MIN_SHIFT_COUNT = 3  # of two that disagree nobody knows which is wrong
MAX_MARGIN_STD_RATIO = 0.25  # of the reference margin: beyond it the slope is anyone's guess
SURE_MARGIN_STD_RATIO = 0.05  # likewise: until it is known so well, more shifts will tell a thin margin from a good one
CHANGE_PROBABILITY = 0.95  # a workshop visit costs: be sure
WATCH_PROBABILITY = 0.80  # of friction that is low or falls: to look again costs less than a workshop visit
WATCH_MARGIN_PROBABILITY = 0.70  # of a thin margin: films and torques of unknown law feign a level, rarely a difference
THIN_PROBABILITY = 0.01  # of a thin margin, to call a fluid good before that: a drive is judged a hundred times
EARLY_MARGIN_STD_RATIO = 0.15  # worse known, the margin of one clutch is believed only as far as both together say so
COLD_K = 333.15  # of a pack: below it nobody knows the laws of film and drag well, and a drive has many looks at them
UNSURE_CHANGE_PROBABILITY = 0.99  # in the cold, and until the margin is known to EARLY_MARGIN_STD_RATIO
UNSURE_LEVEL_PROBABILITY = 0.98  # to watch low friction, in the cold and while a vehicle calibrates
EARLY_MARGIN_PROBABILITY = 0.80  # to watch a thin margin, until it is known so well
MAX_SLOPE_STD_RATIO = 0.5  # of the reference margin, by a modelled torque: worse known, a sure slope is no lining's
SLIP_PROBABILITY = 0.999  # of a lock-up clutch, for either: its slip is judged every minute, for hours
COMMON_THIN_PROBABILITY = 0.003  # the same by both clutches together: they slip in one oil
LEAVE_PROBABILITY = 0.20  # to call off a verdict once given, its cause must have become unlikely
FIT_WINDOW = 20  # shifts of both clutches: two cycles
MAX_MISFIT_SHARE = 0.25  # none of the shifts of sound drives misfit; of another vehicle's calibration half do
MIN_MISFIT_COUNT = 3  # one or two shifts are no share
NEW_FLUID_CONTRADICTIONS = 6  # it contradicts what is known of each clutch up to three times, then that starts afresh
_PERCENT: Final = 100.0  # of a ratio
_NEARLY_SURE: Final = 0.995  # beyond it a rounded percentage would promise certainty
_STEP: Final = 0.001  # to which a reason says a probability


class Cause(StrEnum):
    """What speaks for a change of the fluid, in the words of the verdict's reason."""

    SHUDDER = "shudder"  # the slope is negative
    LEVEL_LOW = "friction too low"
    LOSS_LARGE = "too much friction lost since the baseline"
    MARGIN_THIN = "margin against shudder halved"
    LEVEL_FALLING = "friction falling"
    LOSS_BEGUN = "friction lost since the baseline"


class Silence(StrEnum):
    """Why nothing is said of a clutch, and what would help."""

    FEW_SHIFTS = f"fewer than {MIN_SHIFT_COUNT} of its shifts could be used so far; more drives will tell"
    FEW_EVENTS = f"fewer than {MIN_SHIFT_COUNT} of its events could be used so far; more drives will tell"
    MARGIN_UNSURE = "its friction is not known well enough yet; more drives will tell"
    LAUNCHES_JUDDER = "it slips again after it has stuck when the car starts off, and its friction does not say why"
    SLIP_SWINGS = "its slip swings by itself, and its friction does not say why"
    CALIBRATION_MISFIT = "the calibration does not fit this vehicle; diag-service calibrate makes one that does"
    CONVERTER_MISFIT = "the description of its converter does not fit this vehicle; have its numbers looked at"
    SIGNALS_MISSING = UNTOLD
    LEVEL_UNKNOWN = LEVEL_UNTOLD
    SENSOR_DRIFTED = "a sensor by which it is judged has probably drifted; have that mended, then calibrate anew"
    DATA_CONTRADICT = (
        "its last events were refused, ten or more, because its sensors contradict each other or the commands; have "
        "them looked at"
    )
    INTERNAL_ERROR = "this program failed over its last event; what was known before stands, the next events will tell"
    PART_OF_DRIVE = "only a part of the drive was seen; measure again on a whole one"


_CHANGE: Final = (Cause.SHUDDER, Cause.LEVEL_LOW, Cause.LOSS_LARGE)
_LEVEL: Final = (Cause.LEVEL_FALLING, Cause.LOSS_BEGUN)
SURE_AT: Final = {
    **dict.fromkeys(_CHANGE, CHANGE_PROBABILITY),
    **dict.fromkeys(_LEVEL, WATCH_PROBABILITY),
    Cause.MARGIN_THIN: WATCH_MARGIN_PROBABILITY,
}
"""From which probability of its cause on a bad verdict is given."""
_UNSURE_CHANGE_AT: Final = dict.fromkeys(_CHANGE, UNSURE_CHANGE_PROBABILITY)
CALIBRATING_AT: Final = SURE_AT | dict.fromkeys(_LEVEL, UNSURE_LEVEL_PROBABILITY)
COLD_AT: Final = CALIBRATING_AT | _UNSURE_CHANGE_AT
UNSURE_UP_TO_SCALE_AT: Final = COLD_AT | {Cause.MARGIN_THIN: UNSURE_LEVEL_PROBABILITY}  # a model feigns that, too
SLIP_AT: Final = dict.fromkeys(Cause, SLIP_PROBABILITY)
_EARLY_AT: Final = {**_UNSURE_CHANGE_AT, Cause.MARGIN_THIN: EARLY_MARGIN_PROBABILITY}
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
    return f"{title}: {_WHAT[ground]} ({_until_called_off(probability, SURE_AT[ground])})."


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


JUDDER_RAD_S: Final = 5.2  # slip after the clutch had stuck: 5, and a little of what the noise of its speeds adds
SHIFTS: Final = "shifts"  # what friction of a clutch is told by, where its kind has no word of its own
LAUNCH_WINDOW: Final = 20  # launches of a clutch that are remembered
LEAST_COUNT: Final = 2  # a single one may be a load that pulled the clutch open
LEAST_SWUNG_COUNT: Final = 3  # windows of a stretch of slip: one may be a hole in the road
LEAST_SWUNG_SHARE: Final = 0.04  # of its windows
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
    give_at: dict[Cause, float],
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
    give_at
        From which probability of its cause on a bad verdict is given, where the margin is known.
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
        negative, give_at = min(negative, common.cdf(0.0)), give_at | _EARLY_AT
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
    may_be_thin = own_thin > (LEAVE_PROBABILITY if previous is Condition.GOOD else THIN_PROBABILITY)
    may_be_thin |= common_thin > COMMON_THIN_PROBABILITY and previous is not Condition.GOOD
    if may_be_thin and not is_sure:
        return Cause.MARGIN_THIN, max(own_thin, common_thin)
    likeliest = max(watch.items(), key=itemgetter(1))
    return likeliest if likeliest[1] >= WATCH_PROBABILITY else None


def decide_up_to_scale(
    slope: FrictionSlope,
    since: FrictionTrend | None,
    reference: FrictionCurve,
    shift_count: int,
    previous: Condition,
    previous_cause: Cause | None,
    launches: Launches,
    give_at: dict[Cause, float],
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
    if std_ratio > EARLY_MARGIN_STD_RATIO:
        give_at = {cause: max(at, _EARLY_AT.get(cause, at)) for cause, at in give_at.items()}
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
    give_at: dict[Cause, float],
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
