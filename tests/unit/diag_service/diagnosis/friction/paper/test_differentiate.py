"""Differentiation against polynomials, filterpy and simulated noise."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.paper import (
    SteadyKalman,
    central_difference,
    matched_filter,
    quiet_filter,
    steady_kalman,
)

PERIOD_S = 1e-3


@pytest.mark.parametrize("count", [5, 6, 50])
def test_central_differences_are_exact_for_quartics(count: int) -> None:
    quartic = Polynomial([2.0, -3.0, 0.5, 4.0, -1.5])
    t_s = np.arange(count) * 0.1
    found = central_difference(quartic(t_s), 0.1)
    assert found.rate == pytest.approx(quartic.deriv()(t_s), abs=1e-9)
    assert np.array_equal(found.value, quartic(t_s))


def test_central_differences_are_of_fourth_order() -> None:
    def worst(period_s: float) -> float:
        t_s = np.arange(0.0, 2.0, period_s)
        return float(np.max(np.abs(central_difference(np.sin(5.0 * t_s), period_s).rate - 5.0 * np.cos(5.0 * t_s))))

    assert worst(0.02) / worst(0.01) == pytest.approx(16.0, rel=0.15)


def test_four_samples_have_no_fourth_order_derivative() -> None:
    with pytest.raises(ValueError, match="got 4"):
        central_difference(np.zeros(4), PERIOD_S)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("process", "sample"), [(1.78e7, 535.0), (2e6, 0.0441)])
def test_the_steady_filter_is_filterpy_s_once_that_has_settled(process: float, sample: float) -> None:
    from filterpy.kalman import KalmanFilter  # noqa: PLC0415 - loads matplotlib

    rng = np.random.default_rng(5)
    samples = 200.0 + np.cumsum(rng.normal(0.0, 0.1, 400)) + rng.normal(0.0, 1.0, 400)
    filtered = steady_kalman(PERIOD_S, process, sample)(samples, PERIOD_S)
    reference = KalmanFilter(dim_x=2, dim_z=1)
    drive = np.array([[0.5 * PERIOD_S**2], [PERIOD_S]])
    reference.F = np.array([[1.0, PERIOD_S], [0.0, 1.0]])
    reference.H = np.array([[1.0, 0.0]])
    reference.R *= sample
    reference.Q = process * drive @ drive.T
    for _ in range(20_000):  # its covariance settles without data
        reference.predict()
        reference.update(np.zeros(1))
    reference.predict()
    reference.x = np.array([[samples[0]], [0.0]])
    expected = np.empty((len(samples), 2))
    for k, one in enumerate(samples):
        expected[k] = reference.x[:, 0]
        reference.update(np.array([one]))
        reference.predict()
    assert filtered.value == pytest.approx(expected[:, 0], rel=1e-9)
    assert filtered.rate == pytest.approx(expected[:, 1], rel=1e-9, abs=1e-9 * float(np.max(np.abs(expected[:, 1]))))


def test_the_filter_follows_its_equation() -> None:
    samples = np.random.default_rng(2).normal(3.0, 1.0, 60)
    kalman = SteadyKalman(value_gain=0.2, rate_gain_1_s=4.0)
    found = kalman(samples, PERIOD_S)
    value, rate = float(samples[0]), 0.0
    for k, one in enumerate(samples):
        assert (found.value[k], found.rate[k]) == (pytest.approx(value), pytest.approx(rate, abs=1e-12))
        miss = float(one) - value
        value, rate = value + PERIOD_S * rate + kalman.value_gain * miss, rate + kalman.rate_gain_1_s * miss


def test_the_noise_of_the_rate_is_as_stated() -> None:
    kalman = steady_kalman(PERIOD_S, 1.8e7, 535.0)
    rate = kalman(np.random.default_rng(3).normal(0.0, 2.0, 300_000), PERIOD_S).rate
    assert np.std(rate) == pytest.approx(2.0 * kalman.rate_noise_1_s(PERIOD_S), rel=0.03)


def test_a_quiet_filter_is_as_fast_as_its_noise_allows() -> None:
    kalman = quiet_filter(PERIOD_S, 2.3e4, 5e4)
    assert 2.3e4 * kalman.rate_noise_1_s(PERIOD_S) == pytest.approx(5e4, rel=1e-6)


def noisy_swing() -> tuple[FloatArray, FloatArray]:
    t_s = np.arange(0.0, 5.0, PERIOD_S)
    noise = np.random.default_rng(4).normal(0.0, 5.0, len(t_s))
    return 30.0 * np.sin(4.0 * t_s) + noise, 120.0 * np.cos(4.0 * t_s)


def test_a_matched_filter_comes_nearer_than_slower_and_faster_ones() -> None:
    samples, ideal = noisy_swing()
    best = matched_filter(samples, ideal, PERIOD_S)

    def miss(kalman: SteadyKalman) -> float:
        return float(np.mean((kalman(samples, PERIOD_S).rate - ideal) ** 2))

    for factor in (0.5, 2.0):
        other = SteadyKalman(value_gain=best.value_gain * factor, rate_gain_1_s=best.rate_gain_1_s * factor**2)
        assert miss(best) < miss(other)
    assert miss(best) < 0.2 * float(np.mean(ideal**2))
