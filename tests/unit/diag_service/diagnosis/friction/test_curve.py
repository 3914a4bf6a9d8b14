"""The band of the friction curve, against the laws at both ends and against random draws between them."""

import numpy as np
import pytest

from clutch_model.calibration import nominal_calibration
from clutch_model.pack import friction_law, stribeck_weights
from diag_service.diagnosis.friction.posterior import curve_band, new_curve
from tests.support.builders import friction_estimate

FRICTION = friction_estimate()
REFERENCE = nominal_calibration().clutches[0].friction


def test_the_band_is_that_of_mu_s_at_lock_and_of_mu_c_far_from_it() -> None:
    mean, std = curve_band(np.array([0.0, 1e3]), FRICTION, REFERENCE)
    assert mean == pytest.approx([FRICTION.mu_s, FRICTION.mu_c])
    assert std == pytest.approx([FRICTION.std_mu_s, FRICTION.std_mu_c])


def test_new_fluid_is_that_of_the_calibration() -> None:
    assert new_curve(np.array([0.0, 1e3]), REFERENCE) == pytest.approx([REFERENCE.mu_s, REFERENCE.mu_c])


def test_the_band_agrees_with_random_draws() -> None:
    slip_rad_s = np.array([2.0, 6.0, 15.0])
    off_diagonal = FRICTION.correlation * FRICTION.std_mu_c * FRICTION.std_mu_s
    covariance = [[FRICTION.std_mu_c**2, off_diagonal], [off_diagonal, FRICTION.std_mu_s**2]]
    drawn = np.random.default_rng(1).multivariate_normal([FRICTION.mu_c, FRICTION.mu_s], covariance, 200_000)
    weight = stribeck_weights(slip_rad_s, friction_law(REFERENCE))
    curves = drawn @ np.vstack((1.0 - weight, weight))
    mean, std = curve_band(slip_rad_s, FRICTION, REFERENCE)
    assert mean == pytest.approx(curves.mean(axis=0), rel=1e-3)
    assert std == pytest.approx(curves.std(axis=0), rel=1e-2)
