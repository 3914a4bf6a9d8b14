"""The verdict on a clutch and its fluid; every threshold is named here and justified in docs/verdict.md."""

from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Self

from clutch_model.calibration import Calibration, FrictionCurve
from diag_service.estimation.belief import Belief
from diag_service.records import ClutchVerdict, Condition, FrictionEstimate

MIN_SHIFT_COUNT = 2  # one shift may be an outlier
MAX_MARGIN_STD_RATIO = 0.5  # of the reference margin: beyond it the slope is anyone's guess
CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
CHANGE_PROBABILITY = 0.95  # a workshop visit costs: be sure
WATCH_PROBABILITY = 0.80
LEAVE_PROBABILITY = 0.20  # to call off a verdict once given, its cause must have become unlikely


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionMemory:
    """The last verdict on each clutch: hysteresis looks back at it."""

    conditions: tuple[Condition, Condition] = (Condition.NO_VERDICT, Condition.NO_VERDICT)

    @classmethod
    def fresh(cls) -> Self:
        """Return the memory of a vehicle not judged before."""
        return cls()

    def to_json(self) -> dict[str, Any]:
        """Return the memory as JSON-ready values."""
        return {"conditions": [condition.name for condition in self.conditions]}

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> Self:
        """Rebuild a memory saved by `to_json`.

        Raises
        ------
        ValueError
            If the table is not such a memory.
        """
        try:
            first, second = (Condition[name] for name in table["conditions"])
        except (KeyError, TypeError) as exc:
            raise ValueError(f"not a condition memory: {exc!r}") from exc
        return cls(conditions=(first, second))


def judge(
    memory: ConditionMemory, belief: Belief, clutch: int, calibration: Calibration
) -> tuple[ConditionMemory, ClutchVerdict]:
    """Return the verdict on clutch 1 or 2 from its running state, and the memory with it.

    Each cause (negative slope, low friction, thin margin) has a probability. A verdict is given when the probability of
    a cause reaches its threshold and kept until that has fallen below ``LEAVE_PROBABILITY``.
    """
    index = clutch - 1
    friction = belief.friction(clutch)
    reference = calibration.clutches[index].friction
    shift_count = belief.shift_counts[index]
    condition, reason = _decide(friction, reference, shift_count, memory.conditions[index])
    conditions = list(memory.conditions)
    conditions[index] = condition
    verdict = ClutchVerdict(
        clutch=clutch,
        condition=condition,
        reason=reason,
        level_ratio=friction.mu_c / reference.mu_c if shift_count else None,
        friction=friction if shift_count else None,
        shift_count=shift_count,
    )
    return replace(memory, conditions=(conditions[0], conditions[1])), verdict


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
    friction: FrictionEstimate, reference: FrictionCurve, shift_count: int, previous: Condition
) -> tuple[Condition, str]:
    if shift_count < MIN_SHIFT_COUNT:
        return Condition.NO_VERDICT, f"{shift_count} usable shift(s), {MIN_SHIFT_COUNT} needed"
    reference_margin = reference.mu_c - reference.mu_s
    margin = NormalDist(friction.mu_c - friction.mu_s, friction.std_slope_s_rad * reference.stribeck_speed_rad_s)
    level = NormalDist(friction.mu_c / reference.mu_c, friction.std_mu_c / reference.mu_c)
    facts = (
        f"mu-v slope negative with probability {friction.probability_negative_slope:.3f}, "
        f"mu_C {100.0 * level.mean:.0f} +- {100.0 * level.stdev:.0f} % of new, {shift_count} shifts"
    )

    def found(condition: Condition, enter: float, causes: dict[str, float]) -> str | None:
        threshold = LEAVE_PROBABILITY if previous == condition else enter
        cause, probability = max(causes.items(), key=lambda item: item[1])
        return f"{cause} ({probability:.2f}): {facts}" if probability >= threshold else None

    change = {
        "shudder": friction.probability_negative_slope,
        "friction too low": level.cdf(CHANGE_LEVEL_RATIO),
    }
    if reason := found(Condition.CHANGE_FLUID, CHANGE_PROBABILITY, change):
        return Condition.CHANGE_FLUID, reason
    if margin.stdev > MAX_MARGIN_STD_RATIO * reference_margin:
        return Condition.NO_VERDICT, f"mu_C - mu_S known to {margin.stdev:.4f} only: {facts}"
    watch = {
        "margin against shudder halved": margin.cdf(WATCH_MARGIN_RATIO * reference_margin),
        "friction falling": level.cdf(WATCH_LEVEL_RATIO),
    }
    if reason := found(Condition.WATCH, WATCH_PROBABILITY, watch):
        return Condition.WATCH, reason
    return Condition.GOOD, facts
