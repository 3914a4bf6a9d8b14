"""The verdict, its thresholds and its hysteresis."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.condition import ConditionMemory, judge
from diag_service.estimation.belief import Belief
from diag_service.estimation.parameters import State
from diag_service.records import Condition

CALIBRATION = nominal_calibration()


def believed(mu_c: float, mu_s: float, *, std: float = 0.001, shift_count: int = 5) -> Belief:
    """Return a running state with the friction of both clutches known to ``std``."""
    belief = Belief.fresh(CALIBRATION)
    mean = belief.mean.copy()
    mean[: State.MU_S2 + 1] = [mu_c, mu_s, mu_c, mu_s]
    covariance = belief.covariance.copy()
    covariance[:4, :4] = np.eye(4) * std**2
    return replace(belief, mean=mean, covariance=covariance, shift_counts=(shift_count, shift_count))


def condition_of(belief: Belief, previous: Condition = Condition.NO_VERDICT) -> Condition:
    _, verdict = judge(ConditionMemory(conditions=(previous, previous)), belief, 1, CALIBRATION)
    return verdict.condition


@pytest.mark.parametrize(
    ("mu_c", "mu_s", "expected"),
    [
        (0.140, 0.119, Condition.GOOD),
        (0.133, 0.125, Condition.WATCH),  # case 1: the margin against shudder is more than halved
        (0.119, 0.137, Condition.CHANGE_FLUID),  # case 2: negative slope
        (0.105, 0.088, Condition.CHANGE_FLUID),  # healthy slope, but a quarter of the torque is gone
        (0.122, 0.104, Condition.WATCH),
    ],
)
def test_known_fluids_get_their_verdict(mu_c: float, mu_s: float, expected: Condition) -> None:
    assert condition_of(believed(mu_c, mu_s)) is expected


def test_one_shift_is_no_verdict() -> None:
    assert condition_of(believed(0.119, 0.137, shift_count=1)) is Condition.NO_VERDICT


def test_an_uncertain_margin_is_no_verdict() -> None:
    assert condition_of(believed(0.140, 0.119, std=0.02)) is Condition.NO_VERDICT


def test_a_certain_shudder_is_told_even_when_the_margin_is_uncertain() -> None:
    assert condition_of(believed(0.10, 0.15, std=0.01)) is Condition.CHANGE_FLUID


def test_a_verdict_stays_until_its_cause_is_unlikely() -> None:
    borderline = believed(0.1295, 0.1285, std=0.001)  # slope negative with probability 0.24
    assert condition_of(borderline) is Condition.WATCH
    assert condition_of(borderline, previous=Condition.CHANGE_FLUID) is Condition.CHANGE_FLUID
    clear = believed(0.133, 0.129, std=0.001)
    assert condition_of(clear, previous=Condition.CHANGE_FLUID) is Condition.WATCH


def test_the_reason_names_cause_and_certainty() -> None:
    _, verdict = judge(ConditionMemory.fresh(), believed(0.119, 0.137), 2, CALIBRATION)
    assert verdict.clutch == 2
    assert "shudder" in verdict.reason
    assert "5 shifts" in verdict.reason
    assert verdict.level_ratio == pytest.approx(0.85)


def test_each_clutch_has_its_own_memory() -> None:
    memory, _ = judge(ConditionMemory.fresh(), believed(0.119, 0.137), 2, CALIBRATION)
    assert memory.conditions == (Condition.NO_VERDICT, Condition.CHANGE_FLUID)
    assert ConditionMemory.from_json(memory.to_json()) == memory


@pytest.mark.parametrize("table", [{}, {"conditions": ["FINE", "GOOD"]}, {"conditions": None}])
def test_a_damaged_memory_is_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="condition memory"):
        ConditionMemory.from_json(table)
