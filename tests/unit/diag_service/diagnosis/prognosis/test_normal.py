"""The normal distribution for arrays, and noise that is measured, not stated."""

from statistics import NormalDist

import numpy as np
import pytest

from diag_service.diagnosis.prognosis.history import robust_noise_ratio
from diag_service.diagnosis.prognosis.trend import normal_cdf


def test_it_is_the_normal_distribution() -> None:
    values = np.linspace(-8.0, 8.0, 161)
    expected = [NormalDist().cdf(value) for value in values]
    np.testing.assert_allclose(normal_cdf(values), expected, atol=1e-7)
    assert normal_cdf(np.array([-1e9, 1e9])).tolist() == [0.0, 1.0]


@pytest.mark.parametrize("factor", [1.0, 1.5, 4.0])
def test_noise_is_measured_beside_a_trend(factor: float) -> None:
    value = np.linspace(0.0, 1.0, 2000) + factor * 0.01 * np.random.default_rng(1).standard_normal(2000)
    assert robust_noise_ratio(value, np.full(2000, 0.01)) == pytest.approx(factor, rel=0.08)


def test_less_noise_than_stated_is_not_believed() -> None:
    assert robust_noise_ratio(np.ones(50), np.full(50, 0.01)) == 1.0
    assert robust_noise_ratio(np.array([0.0, 9.0, 0.0]), np.full(3, 0.01)) == 1.0
