"""What a verdict rests on: the probability of each cause for a change; docs/verdict.md justifies the rules."""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

from clutch_model.clutch import FrictionCurve
from diag_service.diagnosis.condition.advice import Cause, Silence
from diag_service.diagnosis.condition.stick_slip import Launches
from diag_service.diagnosis.condition.thresholds import (
    CHANGE_LEVEL_RATIO,
    CHANGE_PROBABILITY,
    COMMON_THIN_PROBABILITY,
    EARLY_MARGIN_STD_RATIO,
    LEAVE_PROBABILITY,
    MAX_MARGIN_STD_RATIO,
    MIN_SHIFT_COUNT,
    SURE_MARGIN_STD_RATIO,
    THIN_PROBABILITY,
    WATCH_LEVEL_RATIO,
    WATCH_MARGIN_RATIO,
    WATCH_PROBABILITY,
)
from diag_service.diagnosis.records import Condition, FrictionEstimate, FrictionTrend


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


def _because(condition: Condition, cause: Cause, probability: float, facts: str) -> Finding:
    reason = f"{cause} ({_likely(probability)}): {facts}"
    return Finding(condition=condition, reason=reason, ground=cause, probability=probability)


def decide(
    friction: FrictionEstimate,
    since: FrictionTrend | None,
    reference: FrictionCurve,
    shift_count: int,
    previous: Condition,
    launches: Launches,
    common: NormalDist,
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
    previous
        The last verdict, which is kept until its cause has become unlikely.
    launches
        Which of its launches juddered.
    common
        Which part of the new fluid's margin is left by both clutches together.
    """
    if shift_count < MIN_SHIFT_COUNT:
        return nothing(Silence.FEW_SHIFTS, f"{shift_count} usable shift(s), {MIN_SHIFT_COUNT} needed")
    reference_margin = reference.mu_c - reference.mu_s
    margin = NormalDist(friction.mu_c - friction.mu_s, friction.std_slope_s_rad * reference.stribeck_speed_rad_s)
    level = NormalDist(friction.mu_c / reference.mu_c, friction.std_mu_c / reference.mu_c)
    own_thin, common_thin = margin.cdf(WATCH_MARGIN_RATIO * reference_margin), common.cdf(WATCH_MARGIN_RATIO)
    negative, thin = friction.probability_negative_slope, own_thin
    if margin.stdev > EARLY_MARGIN_STD_RATIO * reference_margin:  # one clutch may be misread; both rarely are
        negative, thin = min(negative, common.cdf(0.0)), min(own_thin, common_thin)
    facts = _facts(friction, level, since, shift_count) + (f", {launches.text}" if launches.speak else "")
    change = {
        Cause.SHUDDER: launches.probability_negative(negative),
        Cause.LEVEL_LOW: level.cdf(CHANGE_LEVEL_RATIO),
        Cause.LOSS_LARGE: _lost(since, CHANGE_LEVEL_RATIO),
    }
    cause, probability = _likeliest(change)
    if probability >= (LEAVE_PROBABILITY if previous is Condition.CHANGE_FLUID else CHANGE_PROBABILITY):
        return _because(Condition.CHANGE_FLUID, cause, probability, facts)
    if margin.stdev > MAX_MARGIN_STD_RATIO * reference_margin:
        return nothing(Silence.MARGIN_UNSURE, f"mu_C - mu_S known to {margin.stdev:.4f} only: {facts}")
    watch = {
        Cause.MARGIN_THIN: thin,
        Cause.LEVEL_FALLING: level.cdf(WATCH_LEVEL_RATIO),
        Cause.LOSS_BEGUN: _lost(since, WATCH_LEVEL_RATIO),
    }
    cause, probability = _likeliest(watch)
    if probability >= (LEAVE_PROBABILITY if previous is Condition.WATCH else WATCH_PROBABILITY):
        return _because(Condition.WATCH, cause, probability, facts)
    is_sure = margin.stdev <= SURE_MARGIN_STD_RATIO * reference_margin
    if not is_sure and _may_be_thin(own_thin, common_thin, previous):
        by_either = max(own_thin, common_thin)
        return nothing(Silence.MARGIN_UNSURE, f"too early to say, {Cause.MARGIN_THIN} ({_likely(by_either)}): {facts}")
    return _unless_they_judder(launches, 1.0 - probability, facts)


def _may_be_thin(thin: float, common_thin: float, previous: Condition) -> bool:
    """Return whether a margin is too likely thin to be called good, by its own clutch or by both together."""
    if previous is Condition.GOOD:
        return thin > LEAVE_PROBABILITY
    return thin > THIN_PROBABILITY or common_thin > COMMON_THIN_PROBABILITY


def _unless_they_judder(launches: Launches, probability: float, facts: str) -> Finding:
    if launches.speak:
        return nothing(Silence.LAUNCHES_JUDDER, f"its launches contradict its friction: {facts}")
    return Finding(condition=Condition.GOOD, reason=facts, ground=None, probability=probability)


def _facts(friction: FrictionEstimate, level: NormalDist, since: FrictionTrend | None, shift_count: int) -> str:
    facts = (
        f"a negative mu-v slope is {_likely(friction.probability_negative_slope)}, "
        f"mu_C {100.0 * level.mean:.0f} +- {100.0 * level.stdev:.0f} % of new"
    )
    if since is not None:
        change, std = 100.0 * since.change_mu_c_ratio, 100.0 * since.std_change_mu_c_ratio
        facts += f", {change:+.1f} +- {std:.1f} % since the baseline"
    return f"{facts}, {shift_count} shifts"


def _likely(probability: float) -> str:
    return f"{100.0 * probability:.1f} % likely"


def _lost(since: FrictionTrend | None, level_ratio: float) -> float:
    """Return the probability that mu_C has fallen below a share of the vehicle's own baseline."""
    if since is None:
        return 0.0
    return NormalDist(1.0 + since.change_mu_c_ratio, max(since.std_change_mu_c_ratio, 1e-9)).cdf(level_ratio)


def _likeliest(causes: Mapping[Cause, float]) -> tuple[Cause, float]:
    return max(causes.items(), key=lambda item: item[1])
