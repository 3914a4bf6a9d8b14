"""The running state against the textbook."""

import json
from dataclasses import replace

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.baseline import BASELINE_SHIFT_COUNT
from diag_service.diagnosis.friction.filter_state import STEERING, FilterState, Measurement
from diag_service.diagnosis.friction.parameters import Considered, State
from diag_service.diagnosis.plain_values import to_plain

CALIBRATION = replace(
    nominal_calibration(), uncertainty=replace(nominal_calibration().uncertainty, motoring_gain_ratio=0.02)
)
STATES, CONSIDERED = len(State), len(Considered)
SCALE = np.array([0.1] * 4 + [5.0] + [8e3] * 4)  # keeps the random problems near unit size
CONSIDERED_SCALE = np.sqrt(np.diag(FilterState.fresh(CALIBRATION).considered))
FROZEN = to_plain(replace(FilterState.fresh(CALIBRATION), shift_counts=(99, 99)).counted(1, 1).baselines[0])


def random_measurement(rng: np.random.Generator, rows: int) -> Measurement:
    root = rng.normal(size=(rows, rows))
    return Measurement(
        residual=rng.normal(size=rows),
        by_state=rng.normal(size=(rows, STATES)) / SCALE,
        by_considered=rng.normal(size=(rows, CONSIDERED)) / CONSIDERED_SCALE,
        noise=root @ root.T + 0.1 * np.eye(rows),
    )


def test_the_stated_covariance_is_that_of_the_errors_it_makes() -> None:
    """Propagate every error source through two updates by hand and compare with the filter's covariance."""
    rng = np.random.default_rng(1)
    prior = state = FilterState.fresh(CALIBRATION)
    by_prior, by_considered = np.eye(STATES), np.zeros((STATES, CONSIDERED))
    noises: list[np.ndarray] = []
    for rows in (5, 7):
        seen = random_measurement(rng, rows)
        # The gain is recovered from what the update does to unit residuals.
        steps = [state.updated(replace(seen, residual=unit))[0].mean - state.mean for unit in np.eye(rows)]
        gain = np.column_stack(steps)
        keep = np.eye(STATES) - gain @ seen.by_state
        by_prior = keep @ by_prior
        by_considered = keep @ by_considered + gain @ seen.by_considered
        noises = [keep @ one @ keep.T for one in noises] + [gain @ seen.noise @ gain.T]
        state, _ = state.updated(seen)
    expected = by_prior @ prior.covariance @ by_prior.T + sum(noises)
    expected += by_considered @ prior.considered @ by_considered.T
    stated = state.total_covariance(slice(None))
    assert np.allclose(stated / np.outer(SCALE, SCALE), expected / np.outer(SCALE, SCALE), atol=1e-10)


def test_parameters_whose_derivatives_are_measured_do_not_steer_the_estimate() -> None:
    """Their regressors share noise with the residual: a gain that used them would pull friction down."""
    seen = random_measurement(np.random.default_rng(7), 8)
    planned = np.zeros_like(seen.by_considered)
    planned[:, STEERING] = seen.by_considered[:, STEERING]
    prior = FilterState.fresh(CALIBRATION)
    assert np.array_equal(prior.updated(seen)[0].mean, prior.updated(replace(seen, by_considered=planned))[0].mean)


def test_film_and_lining_steer_the_estimate_as_if_they_were_estimated() -> None:
    """The gain of two updates is that of a Kalman filter of states and film, whose film rows are thrown away."""
    rng = np.random.default_rng(8)
    state = FilterState.fresh(CALIBRATION)
    spread = state.considered[np.ix_(STEERING, STEERING)]
    joint = np.block(
        [[state.covariance, np.zeros((STATES, len(STEERING)))], [np.zeros((len(STEERING), STATES)), spread]]
    )
    for rows in (6, 9):
        seen = random_measurement(rng, rows)
        slope = np.hstack((seen.by_state, seen.by_considered[:, STEERING]))
        gain = joint @ slope.T @ np.linalg.inv(slope @ joint @ slope.T + seen.noise)
        gain[STATES:] = 0.0
        after, _ = state.updated(seen)
        step = gain[:STATES] @ seen.residual
        assert np.allclose((after.mean - state.mean) / SCALE, step / SCALE, atol=1e-9)
        keep = np.eye(len(joint)) - gain @ slope
        joint = keep @ joint @ keep.T + gain @ seen.noise @ gain.T
        state = after


def test_it_is_generalised_least_squares_with_a_prior() -> None:
    rng = np.random.default_rng(2)
    prior = FilterState.fresh(CALIBRATION)
    seen = random_measurement(rng, 20)
    seen = replace(seen, by_considered=np.zeros_like(seen.by_considered))
    after, _ = prior.updated(seen)
    weight = np.linalg.inv(seen.noise)
    information = seen.by_state.T @ weight @ seen.by_state + np.linalg.inv(prior.covariance)
    step = np.linalg.solve(information, seen.by_state.T @ weight @ seen.residual)
    assert np.allclose((after.mean - prior.mean) / SCALE, step / SCALE, atol=1e-9)


def test_a_considered_parameter_is_never_averaged_away() -> None:
    """A gain of 3 % and an area of 1 % stay in the total standard deviation however many shifts agree."""
    state = FilterState.fresh(CALIBRATION)
    by_state = np.zeros((1, STATES))
    by_state[0, State.MU_C1] = 100.0
    by_considered = np.zeros((1, CONSIDERED))
    by_considered[0, Considered.PISTON_AREA1] = 14.0  # mu_c * 100: the area scales the torque, as the gain does
    seen = Measurement(residual=np.zeros(1), by_state=by_state, by_considered=by_considered, noise=np.array([[0.01]]))
    for _ in range(1000):
        state, _ = state.updated(seen)
    friction = state.friction(1)
    assert friction.std_mu_c == pytest.approx(np.hypot(0.03, 0.01) * 0.14, rel=0.02)
    assert friction.random_std_mu_c < 0.1 * friction.std_mu_c


def test_chi_square_of_expected_residuals_is_one() -> None:
    rng = np.random.default_rng(3)
    state = FilterState.fresh(CALIBRATION)
    seen = random_measurement(rng, 12)
    misfits = []
    for _ in range(400):
        residual = (
            seen.by_state @ (rng.normal(size=STATES) * np.sqrt(np.diag(state.covariance)))
            + seen.by_considered @ (rng.normal(size=CONSIDERED) * CONSIDERED_SCALE)
            + rng.multivariate_normal(np.zeros(12), seen.noise)
        )
        misfits.append(state.updated(replace(seen, residual=residual))[1])
    assert np.mean([one.chi_square_ratio for one in misfits]) == pytest.approx(1.0, abs=0.08)
    worst = np.array([one.worst_score for one in misfits])
    assert np.median(worst) < 2.5
    assert np.max(worst) < 5.0


def test_one_parameter_far_off_shows_in_its_own_direction() -> None:
    state = FilterState.fresh(CALIBRATION)
    seen = random_measurement(np.random.default_rng(6), 24)
    row = Considered.TORQUE_LATENCY
    displaced = seen.by_considered[:, row] * 9.0 * np.sqrt(state.considered[row, row])
    misfit = state.updated(replace(seen, residual=displaced))[1]
    assert misfit.worst_score > 4.5
    assert misfit.chi_square_ratio < replace(seen, residual=displaced).misfit_gate


def test_the_gate_is_tighter_for_many_numbers() -> None:
    gates = [replace(random_measurement(np.random.default_rng(7), rows)).misfit_gate for rows in (4, 16, 24)]
    assert gates == pytest.approx([4.0, 4.0, 3.0])


def test_forgetting_one_clutch_keeps_the_other() -> None:
    state, _ = FilterState.fresh(CALIBRATION).updated(random_measurement(np.random.default_rng(4), 9))
    forgotten = state.forget_friction(1, CALIBRATION)
    assert forgotten.friction(2) == state.friction(2)
    assert forgotten.friction(1) == FilterState.fresh(CALIBRATION).friction(1)
    assert np.all(np.linalg.eigvalsh(forgotten.covariance / np.outer(SCALE, SCALE)) > 0.0)


def test_a_saved_state_comes_back_bit_by_bit() -> None:
    state, _ = FilterState.fresh(CALIBRATION).updated(random_measurement(np.random.default_rng(5), 9))
    back = FilterState.from_json(json.loads(json.dumps(state.to_json())), CALIBRATION)
    assert back.mean.tobytes() == state.mean.tobytes()
    assert back.covariance.tobytes() == state.covariance.tobytes()
    assert back.sensitivity.tobytes() == state.sensitivity.tobytes()


def test_a_saved_baseline_comes_back_bit_by_bit() -> None:
    rng = np.random.default_rng(8)
    state, _ = FilterState.fresh(CALIBRATION).updated(random_measurement(rng, 9))
    state = replace(state, shift_counts=(3, BASELINE_SHIFT_COUNT)).counted(1, 5).counted(2, 7)
    state, _ = state.updated(random_measurement(rng, 9))
    back = FilterState.from_json(json.loads(json.dumps(state.to_json())), CALIBRATION)
    assert back.to_json() == state.to_json()
    assert back.baselines[0] is None
    first, second = state.baselines[1], back.baselines[1]
    assert first is not None
    assert second is not None
    assert second.cross.tobytes() == first.cross.tobytes()
    assert (second.end_ns, second.shift_count, second.later_count) == (7, BASELINE_SHIFT_COUNT, 0)


def test_a_baseline_is_frozen_once_and_outlives_forgotten_friction() -> None:
    state = replace(FilterState.fresh(CALIBRATION), shift_counts=(BASELINE_SHIFT_COUNT - 1, 0))
    assert state.counted(1, 1).baselines == (None, None)
    frozen = replace(state, shift_counts=(BASELINE_SHIFT_COUNT, 0)).counted(1, 2)
    later, _ = frozen.updated(random_measurement(np.random.default_rng(9), 9))
    later = later.counted(1, 3).forget_friction(1, CALIBRATION)
    baseline = later.baselines[0]
    assert baseline is not None
    assert (baseline.end_ns, baseline.later_count) == (2, 1)
    assert np.array_equal(baseline.mean, state.mean[:2])
    assert not np.any(baseline.cross[:2])
    assert np.any(baseline.cross[2:])


def test_new_fluid_makes_friction_unknown_and_keeps_what_is_known_of_sensors() -> None:
    state, _ = FilterState.fresh(CALIBRATION).updated(random_measurement(np.random.default_rng(12), 9))
    state = replace(state, shift_counts=(BASELINE_SHIFT_COUNT, 3), refused_counts=(2, 1)).counted(1, 5)
    new, fresh = state.with_new_fluid(CALIBRATION), FilterState.fresh(CALIBRATION)
    assert (new.friction(1), new.friction(2)) == (fresh.friction(1), fresh.friction(2))
    assert np.array_equal(new.mean[4:], state.mean[4:])
    assert np.array_equal(new.covariance[4:, 4:], state.covariance[4:, 4:])
    assert (new.baselines, new.shift_counts, new.refused_counts) == ((None, None), (0, 0), (0, 0))


@pytest.mark.parametrize(
    "damage",
    [
        {"baselines": None},
        {"baselines": [None]},
        {"baselines": [{"mean": [0.1]}, None]},
        {"baselines": [FROZEN | {"mean": [0.1]}, None]},
        {"baselines": [FROZEN | {"cross": [[float("nan"), 0.0]] * STATES}, None]},
        {"format": 0},
        {"mean": [1.0]},
        {"covariance": [[float("nan")] * STATES] * STATES},
        {"shift_counts": None},
    ],
)
def test_a_damaged_state_is_refused(damage: dict[str, object]) -> None:
    table = FilterState.fresh(CALIBRATION).to_json() | damage
    with pytest.raises(ValueError, match=r"running state|unpack"):
        FilterState.from_json(table, CALIBRATION)
