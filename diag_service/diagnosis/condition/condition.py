"""The verdict on a clutch and its fluid; every threshold is named here and justified in docs/verdict.md."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from statistics import NormalDist
from typing import Self

from clutch_model.calibration import Calibration
from clutch_model.clutch import FrictionCurve
from clutch_model.gears import with_clutch
from diag_service.diagnosis.condition.scatter import Scatter
from diag_service.diagnosis.friction.filter_state import FilterState
from diag_service.diagnosis.friction.scale_free import clutch_ratio, common_scale_std_ratio, scale_free, trend
from diag_service.diagnosis.plain_values import from_plain, to_plain
from diag_service.diagnosis.records import (
    ClutchVerdict,
    Condition,
    FrictionEstimate,
    FrictionTrend,
    Reason,
    ShiftEstimate,
    Status,
)
from fleet_contract import JsonObject

MIN_SHIFT_COUNT = 2  # one shift may be an outlier
MAX_MARGIN_STD_RATIO = 0.5  # of the reference margin: beyond it the slope is anyone's guess
CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up; of new, and of the own baseline
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
CHANGE_PROBABILITY = 0.95  # a workshop visit costs: be sure
WATCH_PROBABILITY = 0.80
LEAVE_PROBABILITY = 0.20  # to call off a verdict once given, its cause must have become unlikely
FIT_WINDOW = 20  # shifts of both clutches: two cycles
MAX_MISFIT_SHARE = 0.25  # none of the shifts of sound drives misfit; of another vehicle's calibration half do
MIN_MISFIT_COUNT = 3  # one or two shifts are no share
NEW_FLUID_CONTRADICTIONS = 4  # it contradicts the running state of each clutch twice, then that starts afresh
MEMORY_FORMAT = 2
_MISFITS = frozenset({Reason.MISFIT, Reason.ZERO_JUMPED})


class Fit(StrEnum):
    """What a shift says of the calibration that it was estimated with; stored states hold these words."""

    AGREES = "AGREES"
    CONTRADICTS = "SURPRISES"  # it contradicts the running state: the clutch has changed, or the calibration is wrong
    MISFITS = "MISFITS"  # it contradicts the calibration


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionMemory:
    """The last verdict on each clutch, at which hysteresis looks back, and the scatter of its single shifts."""

    conditions: tuple[Condition, Condition] = (Condition.NO_VERDICT, Condition.NO_VERDICT)
    scatters: tuple[Scatter | None, Scatter | None] = (None, None)
    fits: tuple[Fit, ...] = ()  # of the last shifts, the oldest first

    @classmethod
    def fresh(cls) -> Self:
        """Return the memory of a vehicle not judged before."""
        return cls()

    def with_fit(self, estimate: ShiftEstimate) -> Self:
        """Return the memory after a shift that may have been held against the calibration."""
        if not _MISFITS.isdisjoint(estimate.reasons):
            fit = Fit.MISFITS
        elif estimate.status is not Status.VALID:
            return self
        else:
            fit = Fit.CONTRADICTS if Reason.NOT_UPDATED in estimate.reasons else Fit.AGREES
        return replace(self, fits=(*self.fits, fit)[-FIT_WINDOW:])

    @property
    def misfit_text(self) -> str:
        """Why no verdict rests on this calibration; empty if one may."""
        misfits, contradictions = self.fits.count(Fit.MISFITS), self.fits.count(Fit.CONTRADICTS)
        count = misfits + contradictions
        if count < MIN_MISFIT_COUNT or count < MAX_MISFIT_SHARE * len(self.fits):
            return ""
        if not misfits and contradictions <= NEW_FLUID_CONTRADICTIONS:
            return ""
        return (
            f"calibration does not fit: {count} of the last {len(self.fits)} shifts contradict it; "
            "diag-service calibrate makes this vehicle's own"
        )

    def with_shift(self, estimate: ShiftEstimate, before: FilterState) -> Self:
        """Return the memory after a shift, of which the running state stood at ``before``.

        Only a shift that entered the running state counts, and only if there was one before it.
        """
        index, alone = estimate.clutch - 1, estimate.friction
        if alone is None or estimate.status is not Status.VALID or Reason.NOT_UPDATED in estimate.reasons:
            return self
        if not before.shift_counts[index]:
            return self
        known = self.scatters[index] or Scatter.begun(alone)
        scatter = known.with_shift(alone, before.friction(estimate.clutch))
        return replace(self, scatters=with_clutch(self.scatters, estimate.clutch, scatter))

    def to_json(self) -> JsonObject:
        """Return the memory as JSON-ready values; floats survive the round trip bit by bit."""
        names = {"conditions": [one.name for one in self.conditions]}
        return {"format": MEMORY_FORMAT} | to_plain(self) | names

    @classmethod
    def from_json(cls, table: Mapping[str, object]) -> Self:
        """Rebuild a memory saved by `to_json`; stores of earlier versions know of no fits.

        Raises
        ------
        ValueError
            If the table is not such a memory.
        """
        if table.get("format") != MEMORY_FORMAT:
            raise ValueError(f"condition memory of format {table.get('format')!r}, expected {MEMORY_FORMAT}")
        try:
            names, scatters = table["conditions"], table["scatters"]
            conditions = [Condition[name] for name in names] if isinstance(names, list) else names
            memory = from_plain({**table, "conditions": conditions, "scatters": scatters}, cls)
        except (KeyError, TypeError, ValueError) as exc:
            raise ValueError(f"not a condition memory: {exc}") from exc
        for scatter in memory.scatters:
            if scatter is not None and not scatter.is_possible:
                raise ValueError(f"impossible scatter {scatter!r}")
        return memory


def judge(
    memory: ConditionMemory, state: FilterState, clutch: int, calibration: Calibration
) -> tuple[ConditionMemory, ClutchVerdict]:
    """Return the verdict on clutch 1 or 2 from its running state, and the memory with it.

    Each cause (negative slope, low friction, lost friction, thin margin) has a probability. A verdict is given when the
    probability of a cause reaches its threshold and kept until that has fallen below ``LEAVE_PROBABILITY``.
    """
    index = clutch - 1
    reference = calibration.clutches[index].friction
    shift_count = state.shift_counts[index]
    known = bool(shift_count)
    friction, since = state.friction(clutch), trend(state, clutch) if known else None
    condition, reason = _decide(friction, since, reference, shift_count, memory.conditions[index])
    if memory.misfit_text:
        condition, reason = Condition.NO_VERDICT, memory.misfit_text
    scatter = memory.scatters[index]
    verdict = ClutchVerdict(
        clutch=clutch,
        condition=condition,
        reason=reason,
        level_ratio=friction.mu_c / reference.mu_c if known else None,
        friction=friction if known else None,
        shift_count=shift_count,
        scale_free=scale_free(state, clutch) if known else None,
        common_scale_std_ratio=common_scale_std_ratio(state, clutch) if known else None,
        shift_scatter=None if scatter is None else scatter.reported,
        trend=since,
        clutch_ratio=clutch_ratio(state),
    )
    return replace(memory, conditions=with_clutch(memory.conditions, clutch, condition)), verdict


def no_verdict(clutch: int, missing: str) -> ClutchVerdict:
    """Return what is said of a clutch whose friction cannot be known: nothing, and what is missing for more."""
    return ClutchVerdict(
        clutch=clutch,
        condition=Condition.NO_VERDICT,
        reason=f"the signals say nothing of friction: {missing}",
        level_ratio=None,
        friction=None,
        shift_count=0,
    )


def _decide(
    friction: FrictionEstimate,
    since: FrictionTrend | None,
    reference: FrictionCurve,
    shift_count: int,
    previous: Condition,
) -> tuple[Condition, str]:
    if shift_count < MIN_SHIFT_COUNT:
        return Condition.NO_VERDICT, f"{shift_count} usable shift(s), {MIN_SHIFT_COUNT} needed"
    reference_margin = reference.mu_c - reference.mu_s
    margin = NormalDist(friction.mu_c - friction.mu_s, friction.std_slope_s_rad * reference.stribeck_speed_rad_s)
    level = NormalDist(friction.mu_c / reference.mu_c, friction.std_mu_c / reference.mu_c)
    facts = _facts(friction, level, since, shift_count)
    change = {
        "shudder": friction.probability_negative_slope,
        "friction too low": level.cdf(CHANGE_LEVEL_RATIO),
        "too much friction lost since the baseline": _lost(since, CHANGE_LEVEL_RATIO),
    }
    if cause := _cause(change, LEAVE_PROBABILITY if previous is Condition.CHANGE_FLUID else CHANGE_PROBABILITY):
        return Condition.CHANGE_FLUID, f"{cause}: {facts}"
    if margin.stdev > MAX_MARGIN_STD_RATIO * reference_margin:
        return Condition.NO_VERDICT, f"mu_C - mu_S known to {margin.stdev:.4f} only: {facts}"
    watch = {
        "margin against shudder halved": margin.cdf(WATCH_MARGIN_RATIO * reference_margin),
        "friction falling": level.cdf(WATCH_LEVEL_RATIO),
        "friction lost since the baseline": _lost(since, WATCH_LEVEL_RATIO),
    }
    if cause := _cause(watch, LEAVE_PROBABILITY if previous is Condition.WATCH else WATCH_PROBABILITY):
        return Condition.WATCH, f"{cause}: {facts}"
    return Condition.GOOD, facts


def _facts(friction: FrictionEstimate, level: NormalDist, since: FrictionTrend | None, shift_count: int) -> str:
    facts = (
        f"mu-v slope negative with probability {friction.probability_negative_slope:.3f}, "
        f"mu_C {100.0 * level.mean:.0f} +- {100.0 * level.stdev:.0f} % of new"
    )
    if since is not None:
        change, std = 100.0 * since.change_mu_c_ratio, 100.0 * since.std_change_mu_c_ratio
        facts += f", {change:+.1f} +- {std:.1f} % since the baseline"
    return f"{facts}, {shift_count} shifts"


def _lost(since: FrictionTrend | None, level_ratio: float) -> float:
    """Return the probability that mu_C has fallen below a share of the vehicle's own baseline."""
    if since is None:
        return 0.0
    return NormalDist(1.0 + since.change_mu_c_ratio, max(since.std_change_mu_c_ratio, 1e-9)).cdf(level_ratio)


def _cause(causes: Mapping[str, float], threshold: float) -> str | None:
    """Return the likeliest cause and its probability, if that reaches a threshold."""
    cause, probability = max(causes.items(), key=lambda item: item[1])
    return f"{cause} ({probability:.2f})" if probability >= threshold else None
