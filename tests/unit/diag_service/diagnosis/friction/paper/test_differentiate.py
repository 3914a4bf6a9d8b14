"""Differentiation against polynomials, filterpy and simulated noise."""

import numpy as np
import pytest

from diag_service.diagnosis.friction.paper.differentiate import steady_kalman

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
