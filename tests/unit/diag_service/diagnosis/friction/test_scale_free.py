"""What is known without the common scale: the stated deviations are those of the errors that are made."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.baseline import BASELINE_SHIFT_COUNT
from diag_service.diagnosis.friction.filter_state import FilterState, Measurement
from diag_service.diagnosis.friction.parameters import FRICTION_COUNT, Considered, friction_rows
from diag_service.diagnosis.friction.scale_free import (
    PISTON_AREAS,
    clutch_ratio,
    common_scale_std_ratio,
    scale_free,
    trend,
)

CALIBRATION = nominal_calibration()
STATES, CONSIDERED = len(FilterState.fresh(CALIBRATION).mean), len(Considered)
STATE_SCALE = np.array([0.002] * FRICTION_COUNT + [5.0] + [8e3] * 4)
DRAWS = 1000
LATER_COUNT = 25
COVERAGE = (0.915, 0.985)  # of two deviations; 1000 draws know 95 % to 0.7 %


def two_shifts() -> tuple[Measurement, Measurement]:
    """Return what two kinds of shift see: every state and every considered parameter, with gain and inertia alike."""
    rng = np.random.default_rng(11)
    fresh = FilterState.fresh(CALIBRATION)
    scale = np.sqrt(np.diag(fresh.considered))
    scale[scale == 0.0] = 1.0

    def one() -> Measurement:
        by_considered = 0.5 * rng.normal(size=(10, CONSIDERED)) / scale
        return Measurement(
            residual=np.zeros(10),
            by_state=rng.normal(size=(10, STATES)) / STATE_SCALE,
            by_considered=by_considered,
            noise=np.eye(10),
        )

    return one(), one()


def drive(rng: np.random.Generator) -> tuple[FilterState, np.ndarray, np.ndarray, np.ndarray]:
    """Return the state after many shifts, friction times gain at the baseline and now, and what was wrong."""
    kinds = two_shifts()
    state = replace(FilterState.fresh(CALIBRATION), covariance=np.diag(np.square(STATE_SCALE)))
    true_state = state.mean + rng.normal(size=STATES) * STATE_SCALE
    wrong = rng.multivariate_normal(np.zeros(CONSIDERED), state.considered)
    then = true_state[:FRICTION_COUNT].copy()
    for number in range(BASELINE_SHIFT_COUNT + LATER_COUNT):
        before = state.drifted()
        true_state = true_state + rng.normal(size=STATES) * np.sqrt(np.diag(before.covariance - state.covariance))
        seen = kinds[number % 2]
        residual = seen.by_state @ (true_state - before.mean) + seen.by_considered @ wrong + rng.normal(size=10)
        state, _ = before.updated(replace(seen, residual=residual))
        state = replace(state, shift_counts=(number + 1, number + 1)).counted(1, number).counted(2, number)
        if number + 1 == BASELINE_SHIFT_COUNT:
            then = true_state[:FRICTION_COUNT].copy()
    return state, then, true_state[:FRICTION_COUNT], wrong


@cache
def errors() -> dict[str, np.ndarray]:
    """Return errors over stated deviations of many drives, by what they are of."""
    rng = np.random.default_rng(12)
    found: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        state, then, now, wrong = drive(rng)
        gain, area = 1.0 + wrong[Considered.TORQUE_GAIN], 1.0 + wrong[Considered.PISTON_AREA1]
        since, ratio = trend(state, 2), clutch_ratio(state)
        assert since is not None
        assert ratio is not None
        free, change = scale_free(state, 1), (now - then) / gain
        pairs = {
            "scale-free mu_C": (free.mu_c - now[0] * area, free.std_mu_c),
            "scale-free mu_S": (free.mu_s - now[1] * area, free.std_mu_s),
            "change of mu_C": (since.change_mu_c - change[2], since.std_change_mu_c),
            "change of mu_S": (since.change_mu_s - change[3], since.std_change_mu_s),
            "relative mu_C": (since.change_mu_c_ratio - (now[2] / then[2] - 1.0), since.std_change_mu_c_ratio),
            "relative mu_S": (since.change_mu_s_ratio - (now[3] / then[3] - 1.0), since.std_change_mu_s_ratio),
            "mu_C1/mu_C2": (ratio.mu_c_ratio - now[0] / now[2], ratio.std_mu_c_ratio),
            "mu_S1/mu_S2": (ratio.mu_s_ratio - now[1] / now[3], ratio.std_mu_s_ratio),
        }
        for name, (error, std) in pairs.items():
            found.setdefault(name, []).append(error / std)
    return {name: np.array(values) for name, values in found.items()}


@pytest.mark.parametrize(
    "name",
    [
        *("scale-free mu_C", "scale-free mu_S", "change of mu_C", "change of mu_S", "relative mu_C", "relative mu_S"),
        *("mu_C1/mu_C2", "mu_S1/mu_S2"),
    ],
)
def test_the_stated_deviation_is_that_of_the_errors(name: str) -> None:
    ratios = errors()[name]
    assert np.std(ratios) == pytest.approx(1.0, abs=0.1)
    assert COVERAGE[0] <= np.mean(np.abs(ratios) < 2.0) <= COVERAGE[1]


def test_a_trend_is_sharper_than_its_two_ends() -> None:
    state, *_ = drive(np.random.default_rng(13))
    since, friction = trend(state, 1), state.friction(1)
    assert since is not None
    assert since.std_change_mu_c_ratio < 0.2 * friction.std_mu_c / friction.mu_c
    assert since.later_shift_count == LATER_COUNT
    assert since.baseline_end_bus_ns == BASELINE_SHIFT_COUNT - 1


@cache
def some_state() -> FilterState:
    return drive(np.random.default_rng(14))[0]


@settings(deadline=None)  # the first call makes the state
@given(gain=st.floats(0.5, 2.0))
def test_what_is_free_of_scale_does_not_know_the_gain(gain: float) -> None:
    state = some_state()
    scaled = replace(state, torque_gain=gain)
    for clutch in (1, 2):
        assert scale_free(scaled, clutch) == scale_free(state, clutch)
        assert scaled.friction(clutch).mu_c == pytest.approx(state.friction(clutch).mu_c / gain)
        here, there = trend(scaled, clutch), trend(state, clutch)
        assert here is not None
        assert there is not None
        assert here.change_mu_c_ratio == there.change_mu_c_ratio
        assert here.std_change_mu_s_ratio == there.std_change_mu_s_ratio
    assert clutch_ratio(scaled) == clutch_ratio(state)


def test_gain_alone_leaves_the_ratio_certain_and_the_areas_do_not() -> None:
    fresh = FilterState.fresh(CALIBRATION)
    sensitivity = np.zeros_like(fresh.sensitivity)
    sensitivity[:FRICTION_COUNT, Considered.ENGINE_INERTIA] = 0.5 * fresh.mean[:FRICTION_COUNT]  # alike in all four
    known = replace(fresh, covariance=np.zeros_like(fresh.covariance), shift_counts=(1, 1), sensitivity=sensitivity)
    ratio = clutch_ratio(known)
    assert ratio is not None
    assert ratio.std_mu_c_ratio == pytest.approx(0.0, abs=1e-12)
    sensitivity[:2, Considered.PISTON_AREA1] = fresh.mean[:2]
    sensitivity[2:4, Considered.PISTON_AREA2] = fresh.mean[2:4]
    ratio = clutch_ratio(known)
    assert ratio is not None
    assert ratio.std_mu_c_ratio == pytest.approx(np.sqrt(2.0) * CALIBRATION.uncertainty.piston_area_ratio)


@pytest.mark.parametrize("clutch", [1, 2])
def test_the_common_scale_is_that_of_gain_and_piston_area(clutch: int) -> None:
    fresh, scatter = FilterState.fresh(CALIBRATION), CALIBRATION.uncertainty
    gain, area = scatter.torque_gain_ratio, scatter.piston_area_ratio
    assert common_scale_std_ratio(fresh, clutch) == pytest.approx(np.hypot(gain, area))
    assert common_scale_std_ratio(replace(fresh, torque_gain=1.5), clutch) == pytest.approx(np.hypot(gain / 1.5, area))
    considered = fresh.considered.copy()
    row = PISTON_AREAS[clutch - 1]
    considered[Considered.TORQUE_GAIN, row] = considered[row, Considered.TORQUE_GAIN] = -gain * area
    assert common_scale_std_ratio(replace(fresh, considered=considered), clutch) == pytest.approx(gain - area)


@pytest.mark.parametrize("clutch", [1, 2])
def test_a_piston_area_that_is_the_lever_of_friction_only_leaves_the_scale_free_value_certain(clutch: int) -> None:
    fresh, rows = FilterState.fresh(CALIBRATION), friction_rows(clutch)
    sensitivity = np.zeros_like(fresh.sensitivity)
    sensitivity[rows, PISTON_AREAS[clutch - 1]] = fresh.mean[rows]
    covariance = np.eye(len(fresh.mean)) * 1e-6
    known = replace(fresh, covariance=covariance, sensitivity=sensitivity)
    free = scale_free(known, clutch)
    assert free.std_mu_c == pytest.approx(1e-3)
    assert free.std_mu_s == pytest.approx(1e-3)
    assert known.friction(clutch).std_mu_c > 0.01 * free.mu_c


def test_nothing_is_compared_before_there_is_something_to_compare_with() -> None:
    fresh = FilterState.fresh(CALIBRATION)
    assert clutch_ratio(replace(fresh, shift_counts=(0, 3))) is None
    frozen = replace(fresh, shift_counts=(0, BASELINE_SHIFT_COUNT)).counted(2, 1)
    assert trend(frozen, 1) is None
    assert trend(frozen, 2) is None  # the baseline is all that is known
