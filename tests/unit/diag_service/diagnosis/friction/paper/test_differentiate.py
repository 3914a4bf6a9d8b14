"""Differentiation against polynomials, filterpy and simulated noise."""

import numpy as np
import pytest

from diag_service.diagnosis.friction.paper.differentiate import SteadyKalman, quiet_filter, steady_kalman

PERIOD_S = 1e-3


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


def test_the_noise_of_the_rate_is_that_of_its_impulse_response() -> None:
    kalman = steady_kalman(PERIOD_S, 1.8e7, 535.0)
    impulse = np.zeros(4000)
    impulse[1] = 1.0
    response = kalman(impulse, PERIOD_S).rate
    assert np.sqrt(np.sum(response**2)) == pytest.approx(kalman.rate_noise_1_s(PERIOD_S), rel=1e-9)


def test_a_quiet_filter_is_as_fast_as_its_noise_allows() -> None:
    kalman = quiet_filter(PERIOD_S, 2.3e4, 5e4)
    assert 2.3e4 * kalman.rate_noise_1_s(PERIOD_S) == pytest.approx(5e4, rel=1e-6)
