"""What is known without the common scale: the stated deviations are those of the errors that are made."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory, PairClutch, judge
from diag_service.diagnosis.friction.evidence import (
    FRICTION_COUNT,
    OWN_LAWS,
    PARAMETER_COUNT,
    STATE_COUNT,
    Considered,
    Evidence,
    Knowledge,
    Measurement,
    Prior,
    fuse,
    prior_covariance,
)
from diag_service.diagnosis.friction.posterior import (
    BASELINE_SHIFT_COUNT,
    MODEL_STD_RATIO,
    Baseline,
    Posterior,
    clutch_ratio,
    friction,
    scale_free,
    trend,
)

CALIBRATION = nominal_calibration()
FRESH = Posterior.fresh(CALIBRATION)
GAIN = STATE_COUNT + Considered.TORQUE_GAIN
CURVE, FALL = OWN_LAWS
EXPONENT = STATE_COUNT + Considered.STRIBECK_EXPONENT
AREAS = (STATE_COUNT + Considered.PISTON_AREA1, STATE_COUNT + Considered.PISTON_AREA2)
STATE_SCALE = np.array([0.002] * FRICTION_COUNT + [5.0] + [8e3] * 4)
NUMBERS_OF_A_SHIFT = 10
CHANGE_STD = 0.0005  # of friction, after the baseline
DRAWS = 1000
LATER_COUNT = 25
COVERAGE = (0.915, 0.985)  # of two deviations; 1000 draws know 95 % to 0.7 %


def base() -> Knowledge:
    """Return what is known before: friction roughly, everything else as of the vehicle type."""
    covariance = prior_covariance(CALIBRATION)
    covariance[:STATE_COUNT, :STATE_COUNT] = np.diag(np.square(STATE_SCALE))
    return Knowledge(mean=FRESH.known.mean, covariance=covariance)


@cache
def slopes() -> tuple[FloatArray, FloatArray]:
    """Return what two kinds of shift see: every parameter, with gain and inertia alike."""
    rng = np.random.default_rng(11)
    std = base().std()
    scale = np.concatenate((STATE_SCALE, 2.0 * std[STATE_COUNT:]))
    first, second = (rng.normal(size=(NUMBERS_OF_A_SHIFT, PARAMETER_COUNT)) / scale for _ in range(2))
    return first, second


def shifts(count: int, truth: FloatArray, rng: np.random.Generator) -> Evidence:
    """Return what ``count`` shifts of each kind say, with noise of deviation one."""
    total = Evidence.none()
    for slope in slopes():
        matrix = count * slope.T @ slope
        noise = np.sqrt(count) * slope.T @ rng.normal(size=NUMBERS_OF_A_SHIFT)
        alone = Evidence(matrix=matrix, vector=matrix @ truth + noise, constant=0.0, count=count * NUMBERS_OF_A_SHIFT)
        total = Evidence.sum((total, alone))
    return total


def of(known: Knowledge, counts: tuple[int, int] = (1, 1)) -> Posterior:
    return replace(Posterior.of(known, CALIBRATION), folded_counts=counts)


def drive(rng: np.random.Generator) -> tuple[Posterior, FloatArray, FloatArray]:
    """Return the state after many shifts, and the true parameters at the baseline and now."""
    known = base()
    then = known.mean + np.linalg.cholesky(known.covariance) @ rng.normal(size=PARAMETER_COUNT)
    for row in (CURVE, EXPONENT):  # here all is linear: what a curve leaves out of that is not in the errors
        known.covariance[row, :] = known.covariance[:, row] = then[row] = 0.0
    known = fuse(known, shifts(BASELINE_SHIFT_COUNT, then, rng)).knowledge
    baselines = [
        Baseline.of(clutch, known, end_ns=BASELINE_SHIFT_COUNT, count=BASELINE_SHIFT_COUNT) for clutch in (1, 2)
    ]
    change_std = np.zeros(PARAMETER_COUNT)
    change_std[:FRICTION_COUNT] = CHANGE_STD
    now = then + change_std * rng.normal(size=PARAMETER_COUNT)
    news = fuse(known.less_sure(np.square(change_std)), shifts(LATER_COUNT, now, rng))
    first, second = (replace(one.after(news.error_transition), later_count=LATER_COUNT) for one in baselines)
    return replace(of(news.knowledge), baselines=(first, second)), then, now


@cache
def errors() -> dict[str, FloatArray]:
    """Return errors over stated deviations of many drives, by what they are of."""
    rng = np.random.default_rng(12)
    found: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        state, then, now = drive(rng)
        gain, area = 1.0 + now[GAIN], 1.0 + now[AREAS[0]]
        since, ratio = trend(state, 2), clutch_ratio(state.stated)
        assert since is not None
        model = 1.0 + MODEL_STD_RATIO * rng.normal(size=FRICTION_COUNT)  # what all events of a clutch show alike
        now[:FRICTION_COUNT] *= model
        then[:FRICTION_COUNT] *= model
        free, absolute, change = scale_free(state, 1), friction(state, 1), (now - then) / gain
        pairs = {
            "mu_C": (absolute.mu_c - now[0] / gain, absolute.std_mu_c),
            "mu_S": (absolute.mu_s - now[1] / gain, absolute.std_mu_s),
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
        *("mu_C", "mu_S", "scale-free mu_C", "scale-free mu_S", "change of mu_C", "change of mu_S"),
        *("relative mu_C", "relative mu_S", "mu_C1/mu_C2", "mu_S1/mu_S2"),
    ],
)
def test_the_stated_deviation_is_that_of_the_errors(name: str) -> None:
    ratios = errors()[name]
    assert np.std(ratios) == pytest.approx(1.0, abs=0.1)
    assert COVERAGE[0] <= np.mean(np.abs(ratios) < 2.0) <= COVERAGE[1]


def test_nothing_is_compared_before_there_is_something_to_compare_with() -> None:
    known = FRESH.known
    _, verdict = judge(ConditionMemory(), PairClutch.of(of(known, (0, 3)), 2, CALIBRATION))
    assert verdict.clutch_ratio is None
    baseline = Baseline.of(2, known, end_ns=1, count=BASELINE_SHIFT_COUNT)
    frozen = replace(of(known, (0, BASELINE_SHIFT_COUNT)), baselines=(None, baseline))
    assert trend(frozen, 1) is None
    assert trend(frozen, 2) is None  # the baseline is all that is known


def of_a_curve(shown: float, std: float) -> Evidence:
    """Return evidence of a Stribeck speed with which mu_S of clutch 1 goes, and of that friction to a hundredth."""
    row = np.zeros(PARAMETER_COUNT)
    row[1], row[CURVE] = 1.0, 0.02
    friction_at = 0.12 + 0.02 * shown
    alone = Evidence.of_readings([CURVE], [shown], [std**2])
    matrix = np.outer(row, row) / 1e-6
    seen = Evidence(matrix=matrix, vector=row * friction_at / 1e-6, constant=friction_at**2 / 1e-6, count=1)
    return Evidence.sum([alone, seen])


def assert_same_but_for_the_doubt_of_mu_s(stated: Knowledge, known: Knowledge, tolerance: float) -> None:
    """Assert that two are the same, but that the first is less sure of mu_S: its curve is followed along a line."""
    near = partial(pytest.approx, rel=tolerance, abs=min(tolerance, 1e-9))
    assert stated.mean == near(known.mean)
    doubt = stated.covariance.diagonal() - known.covariance.diagonal()
    assert min(doubt[1], doubt[3]) > 0.0
    doubt[[0, 2]] = doubt[4:] = 0.0
    assert stated.covariance - np.diag(doubt) == near(known.covariance)


def test_a_curve_like_its_types_costs_nothing_and_one_that_is_certain_stays() -> None:
    known, covariance = fuse(base(), of_a_curve(0.05, 0.15)).knowledge, base().covariance
    assert_same_but_for_the_doubt_of_mu_s(FRESH.prior.with_own_laws(known), known, 1e-12)
    covariance[CURVE, :] = covariance[:, CURVE] = 0.0
    certain = fuse(Knowledge(mean=base().mean, covariance=covariance), of_a_curve(0.5, 0.15)).knowledge
    stated = Prior.of(covariance).with_own_laws(certain)
    assert (stated.mean == certain.mean).all()
    assert (stated.covariance == certain.covariance).all()


@pytest.mark.parametrize("shown", [0.5, -0.3])
def test_a_vehicle_of_another_curve_is_held_to_its_type_as_loosely_as_it_differs(shown: float) -> None:
    evidence, start = of_a_curve(shown, 0.15), base()
    start.covariance[1, 1] = 1.0  # friction by itself tells nothing of the curve
    freed = FRESH.prior.with_own_laws(fuse(start, evidence).knowledge)
    covariance = start.covariance.copy()
    covariance[CURVE, CURVE] = min(shown**2, OWN_LAWS[CURVE] ** 2)
    loose = fuse(Knowledge(mean=start.mean, covariance=covariance), evidence).knowledge
    assert_same_but_for_the_doubt_of_mu_s(freed, loose, 0.01)


@pytest.mark.parametrize(("of_speed", "of_exponent", "doubt"), [(0.0, 0.0, 0.0), (0.25, 0.0, 0.0125), (0.0, 0.1, 0.01)])
def test_mu_s_of_a_curve_that_has_moved_is_less_sure(of_speed: float, of_exponent: float, doubt: float) -> None:
    """A curve is followed along a line: what that leaves out grows with the square of how far it moves."""
    known = Knowledge(mean=base().mean.copy(), covariance=np.zeros_like(base().covariance))
    known.mean[[CURVE, EXPONENT]] = of_speed, of_exponent
    for sign in (1.0, -1.0):
        stated = FRESH.prior.with_own_laws(Knowledge(mean=sign * known.mean, covariance=known.covariance))
        assert stated.std()[:4] == pytest.approx(doubt * known.mean[:4] * [0.0, 1.0, 0.0, 1.0])


def test_a_curve_that_moves_further_than_any_has_changed_meanwhile_and_is_not_less_sure_for_it() -> None:
    known = Knowledge(mean=base().mean.copy(), covariance=np.zeros_like(base().covariance))
    known.mean[EXPONENT] = 0.8  # a fluid that ages within some dozen events
    assert FRESH.prior.with_own_laws(known).std()[1] == pytest.approx(0.0225 * known.mean[1])


@pytest.mark.parametrize("shown", [-4.0, -1.2, 3.0])
def test_what_no_lining_is_like_is_no_curve_of_its_own(shown: float) -> None:
    known = fuse(base(), of_a_curve(shown, 0.05)).knowledge
    assert_same_but_for_the_doubt_of_mu_s(FRESH.prior.with_own_laws(known), known, 1e-12)


def test_friction_that_falls_four_times_as_fast_as_its_types_is_believed_where_events_tell() -> None:
    fall, truth, row = -0.002, base().mean[0], np.zeros(PARAMETER_COUNT)  # fall: ratio per kelvin
    row[0], row[FALL] = 1.0, 0.14 * 40.0  # of packs that are 40 K above the reference
    seen = Measurement(residual=np.array([0.14 * 40.0 * fall]), jacobian=row[None], covariance=np.eye(1) * 1e-6)
    told = Evidence.of_readings([FALL], [fall], [0.00025**2])
    known = fuse(base(), Evidence.sum([Evidence.of([seen], base().mean), told])).knowledge
    freed = FRESH.prior.with_own_laws(known)
    assert freed.mean[FALL] == pytest.approx(fall, abs=0.0002)
    assert abs(freed.mean[0] - truth) < min(freed.std()[0], 0.3 * abs(known.mean[0] - truth))
