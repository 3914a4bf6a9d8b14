"""Events are fused, and kept as the running state."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import (
    FRICTION_ROWS,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    JudgedEvent,
    Knowledge,
    Measurement,
    fuse,
)
from diag_service.diagnosis.friction.posterior import BASELINE_SHIFT_COUNT, RECENT_COUNT, Posterior, friction, trend
from fleet_contract import JsonObject
from tests.support.builders import with_latencies

CALIBRATION = nominal_calibration()
MU = np.array([0.140, 0.120])
STD = 0.001


def event(number: int, clutch: int, mu: np.ndarray, rng: np.random.Generator, noise: float = 1.0) -> JudgedEvent:
    """Return an event that sees friction and, less sharply, all else; ``noise`` is over what is stated."""
    at, std = Posterior.fresh(CALIBRATION).known.mean, Posterior.fresh(CALIBRATION).known.std()
    slope = 0.05 * rng.normal(size=(24, PARAMETER_COUNT)) / std
    slope[:, FRICTION_ROWS[0]] = slope[:, FRICTION_ROWS[1]] = 0.0
    slope[:, FRICTION_ROWS[clutch - 1]] = np.tile(np.eye(2), (12, 1)) / STD / np.sqrt(12.0)
    truth = at.copy()
    truth[FRICTION_ROWS[clutch - 1]] = mu
    residual = slope @ (truth - at) + noise * rng.normal(size=24)
    measured = Measurement(residual=residual, jacobian=slope, covariance=np.eye(24))
    return JudgedEvent(clutch=clutch, end_ns=number, evidence=Evidence.of([measured], at))


def driven(count: int, seed: int = 0, mu: Callable[[int], np.ndarray] = lambda _: MU, noise: float = 1.0) -> Posterior:
    """Return what is known after some events of both clutches in turn."""
    rng, state = np.random.default_rng(seed), Posterior.fresh(CALIBRATION)
    for number in range(count):
        state = state.with_event(event(number, 1 + number % 2, mu(number), rng, noise))
    return state


def test_nothing_is_lost_when_events_become_part_of_the_base() -> None:
    """But for the drift of a few events, the whole is what all events say at once, if none differs from the others."""
    rng = np.random.default_rng(0)
    total = Evidence.none()
    for number in range(30):
        total = Evidence.sum((total, event(number, 1 + number % 2, MU, rng, 0.1).evidence))
    at_once, state = fuse(Posterior.fresh(CALIBRATION).base, total).knowledge, driven(30, noise=0.1)
    assert len(state.recent) == RECENT_COUNT
    assert state.shift_counts == (15, 15)
    std = at_once.std()
    moved, grown = (state.known.mean - at_once.mean) / std, state.known.std() / std
    drifting = STATE_COUNT + Considered.VISCOSITY  # by what the oil does as it warms up
    assert abs(moved[drifting]) < 0.5
    assert 1.0 < grown[drifting] < 1.5
    assert np.delete(moved, drifting) == pytest.approx(np.zeros(PARAMETER_COUNT - 1), abs=0.1)
    assert np.delete(grown, drifting) == pytest.approx(np.ones(PARAMETER_COUNT - 1), rel=0.05)


def test_a_vehicle_unlike_its_type_begins_again_once_and_only_with_its_first_events() -> None:
    assert not with_latencies(6, 0.020).is_unlike_type
    unlike, again = with_latencies(6, 0.040), with_latencies(6, 0.040).begun_again()
    assert unlike.is_unlike_type
    assert (again.recent, again.shift_counts) == ((), (0, 0))
    assert np.array_equal(again.known.mean, Posterior.fresh(CALIBRATION).known.mean)
    for one in unlike.recent:
        again = again.with_event(one)
    assert np.array_equal(again.known.mean, unlike.known.mean)
    assert not again.is_unlike_type
    assert not with_latencies(RECENT_COUNT + 1, 0.040).is_unlike_type
    assert Posterior.from_json(unlike.to_json(), CALIBRATION).is_unlike_type
    assert not Posterior.from_json(again.to_json(), CALIBRATION).is_unlike_type


def test_a_change_begins_the_count_anew_and_keeps_the_rest() -> None:
    before = driven(20)
    state = driven(26, mu=lambda number: MU * (0.8 if number >= 20 and number % 2 else 1.0))
    assert state.shift_counts == (13, 3)
    assert state.known.mean[FRICTION_ROWS[1]] == pytest.approx(0.8 * MU, abs=5.0 * STD)
    latency = STATE_COUNT + Considered.TORQUE_LATENCY
    assert state.known.std()[latency] <= before.known.std()[latency]


def test_a_change_shows_against_the_baseline() -> None:
    count = 2 * (BASELINE_SHIFT_COUNT + RECENT_COUNT)
    sound, worn = driven(count), driven(count + 8, mu=lambda number: MU * (0.9 if number >= count else 1.0))
    same, since = trend(sound, 1), trend(worn, 1)
    assert same is not None
    assert abs(same.change_mu_c_ratio) < 4.0 * same.std_change_mu_c_ratio
    assert same.baseline_shift_count == BASELINE_SHIFT_COUNT
    assert since is not None
    assert since.change_mu_c_ratio == pytest.approx(-0.1, abs=5.0 * since.std_change_mu_c_ratio)
    assert since.std_change_mu_c_ratio < 0.01


def test_what_the_type_does_not_tell_is_never_averaged_away() -> None:
    """A gain of 3 % and an area of 1 % stay in the total standard deviation however many shifts agree."""
    rng, state = np.random.default_rng(1), Posterior.fresh(CALIBRATION)
    at = state.known.mean
    slope = np.zeros((1, PARAMETER_COUNT))
    slope[0, 0] = 100.0
    slope[0, STATE_COUNT + Considered.PISTON_AREA1] = 14.0  # mu_c * 100: the area scales the torque, as the gain does
    for number in range(200):
        seen = Measurement(residual=0.1 * rng.normal(size=1), jacobian=slope, covariance=np.array([[0.01]]))
        news = JudgedEvent(clutch=1, end_ns=number, evidence=Evidence.of([seen], at))
        state = state.with_event(news)
    found = friction(state, 1)
    assert found.std_mu_c == pytest.approx(np.hypot(0.03, 0.01) * 0.14, rel=0.03)
    assert found.random_std_mu_c < 0.15 * found.std_mu_c


def test_a_saved_state_goes_on_bit_by_bit() -> None:
    rng = np.random.default_rng(9)
    state = driven(2 * BASELINE_SHIFT_COUNT + RECENT_COUNT + 3, mu=lambda number: MU * (1.2 if number == 38 else 1.0))
    state = replace(state, packs=PackTemperatures(clutch_k=(360.0, 351.5), at_ns=12))
    back = Posterior.from_json(json.loads(json.dumps(state.to_json())), CALIBRATION)
    assert back.to_json() == state.to_json()
    news = event(99, 1, MU, rng)
    one, other = state.with_event(news), back.with_event(news)
    assert one.known.mean.tobytes() == other.known.mean.tobytes()
    assert one.known.covariance.tobytes() == other.known.covariance.tobytes()
    assert (one.is_used, one.shift_counts) == (other.is_used, other.shift_counts)
    assert one.baselines[0] is not None
    assert one.packs == other.packs


SAVED = json.dumps(driven(2 * BASELINE_SHIFT_COUNT + RECENT_COUNT).to_json())


def damaged(change: Callable[[Any], object]) -> JsonObject:
    table: JsonObject = json.loads(SAVED)
    change(table)
    return table


@pytest.mark.parametrize(
    "table",
    [
        damaged(lambda table: table.update(format=3)),
        damaged(lambda table: table.pop("base")),
        damaged(lambda table: table["base"].update(mean=[0.1])),
        damaged(lambda table: table["base"]["covariance"][3].__setitem__(3, float("nan"))),
        damaged(lambda table: table.update(baselines=[None])),
        damaged(lambda table: table["baselines"][0].update(cross=[[0.0, 0.0]])),
        damaged(lambda table: table.update(recent="none")),
        damaged(lambda table: table["recent"].extend(table["recent"])),
        damaged(lambda table: table["recent"][0].update(lower=[1.0])),
        damaged(lambda table: table["recent"][0].update(clutch=3)),
        damaged(lambda table: table["recent"][0].update(constant=float("inf"))),
        damaged(lambda table: table.update(folded_counts=None)),
        damaged(lambda table: table["weights"].pop()),
        damaged(lambda table: table["weights"].clear()),
        damaged(lambda table: table["weights"].append(2.0) or table["weights"].pop(0)),
    ],
)
def test_a_damaged_state_is_refused(table: JsonObject) -> None:
    with pytest.raises(ValueError, match="running state"):
        Posterior.from_json(table, CALIBRATION)


def test_events_of_a_state_that_stores_no_weights_count_in_full_or_not_at_all() -> None:
    old = Posterior.from_json(damaged(lambda table: table.pop("weights")), CALIBRATION)
    new = Posterior.from_json(json.loads(SAVED), CALIBRATION)
    assert old.is_used == new.is_used
    assert set(old.weights) <= {0.0, 1.0} != set(new.weights)


SCALES = 10.0 ** np.random.default_rng(0).uniform(-4.0, 4.0, PARAMETER_COUNT)  # coefficients, pascals, seconds


def knowledge(rng: np.random.Generator) -> Knowledge:
    root = rng.normal(size=(PARAMETER_COUNT, PARAMETER_COUNT)) / np.sqrt(PARAMETER_COUNT)
    spread = (root @ root.T + np.eye(PARAMETER_COUNT)) * np.outer(SCALES, SCALES)
    return Knowledge(mean=rng.normal(size=PARAMETER_COUNT) * SCALES, covariance=spread)


def measurement(rng: np.random.Generator, truth: FloatArray, at: FloatArray, count: int = 24) -> Measurement:
    slope = rng.normal(size=(count, PARAMETER_COUNT)) / SCALES
    root = 0.2 * rng.normal(size=(count, count)) / np.sqrt(count)
    noise = root @ root.T + 0.01 * np.eye(count)
    drawn = np.linalg.cholesky(noise) @ rng.normal(size=count)
    return Measurement(residual=slope @ (truth - at) + drawn, jacobian=slope, covariance=noise)


@pytest.mark.parametrize("seed", range(5))
def test_fusing_is_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = knowledge(rng)
    truth = known.mean + np.linalg.cholesky(known.covariance) @ rng.normal(size=PARAMETER_COUNT)
    at = [known.mean, truth, known.mean + SCALES]
    seen = [measurement(rng, truth, one) for one in at]
    total = Evidence.none()
    for one, where in zip(seen, at, strict=True):
        total = Evidence.sum((total, Evidence.of([one], where)))
    fused = fuse(known, total)

    rows = [np.linalg.cholesky(np.linalg.inv(known.covariance / np.outer(SCALES, SCALES))).T / SCALES]
    sides = [rows[0] @ known.mean]
    for one, where in zip(seen, at, strict=True):
        white = np.linalg.inv(np.linalg.cholesky(one.covariance))
        rows.append(white @ one.jacobian)
        sides.append(white @ (one.residual + one.jacobian @ where))
    design, side = np.vstack(rows) * SCALES, np.concatenate(sides)
    solved, rest, *_ = np.linalg.lstsq(design, side)
    covariance = np.linalg.inv(design.T @ design) * np.outer(SCALES, SCALES)
    assert fused.knowledge.mean / SCALES == pytest.approx(solved, abs=1e-6)
    assert fused.knowledge.covariance / np.outer(SCALES, SCALES) == pytest.approx(
        covariance / np.outer(SCALES, SCALES), abs=1e-8
    )
    assert fused.chi_square == pytest.approx(float(rest[0]), rel=1e-6)


def test_an_event_with_parameters_of_its_own_is_least_squares_with_twice_as_many() -> None:
    """Chi-square, least over what the event may differ by, at any parameters."""
    rng = np.random.default_rng(5)
    known = knowledge(rng)
    seen = measurement(rng, known.mean, known.mean)
    evidence = Evidence.of([seen], known.mean)
    variance = np.where(np.arange(PARAMETER_COUNT) % 3 == 0, (0.3 * SCALES) ** 2, 0.0)
    free = variance > 0.0
    loosened = Evidence.of([seen], known.mean, variance=variance)
    for at in (known.mean, known.mean + SCALES):
        pull = (evidence.vector - evidence.matrix @ at)[free]
        own = np.linalg.solve(evidence.matrix[np.ix_(free, free)] + np.diag(1.0 / variance[free]), pull)
        moved = at.copy()
        moved[free] += own
        least = evidence.chi_square(moved) + float(np.sum(own**2 / variance[free]))
        assert loosened.chi_square(at) == pytest.approx(least, rel=1e-9)
    assert loosened.count == evidence.count
