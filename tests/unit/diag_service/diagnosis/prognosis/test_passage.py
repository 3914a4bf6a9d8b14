"""When a limit is passed: probabilities that never fall, quantiles, the first of two limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diag_service.diagnosis.prognosis.assumptions import FUTURE_BENDS, HORIZON_M
from diag_service.diagnosis.prognosis.channels import DISTANCE_M, Clock
from diag_service.diagnosis.prognosis.trend import Mixture, Passage, passage


def sure(now: float, rate_per_m: float, *, std: float = 0.001, start: float = 1.0) -> Mixture:
    """Return a channel that is known well."""
    return Mixture(
        weight=np.ones(1),
        rate_per_m=np.array([rate_per_m]),
        now=np.array([now]),
        now_variance=np.array([std**2]),
        start=np.array([start]),
        start_variance=np.array([std**2]),
        now_start_covariance=np.zeros(1),
        wander=0.0,
        random_per_m=0.0,
        clock=Clock(age_m=np.zeros(1), ahead_m=DISTANCE_M, log_prior=0.0),
    )


def test_a_well_known_fall_passes_where_the_line_does_or_a_little_before() -> None:
    when = passage([sure(0.5, -1.0e-8)], [(0.0, 0.0)]).bent(FUTURE_BENDS)
    median_m = when.quantile_m(0.5)
    assert median_m is not None
    assert 0.85 * 5.0e7 < median_m < 5.0e7
    p10_m, p90_m = when.quantile_m(0.1), when.quantile_m(0.9)
    assert p10_m is not None
    assert p90_m is not None
    assert p10_m < median_m < p90_m < 1.3 * 5.0e7


def test_what_is_passed_already_is_zero_away() -> None:
    when = passage([sure(-0.1, -1.0e-8)], [(0.0, 0.0)]).bent(FUTURE_BENDS)
    assert when.quantile_m(0.9) == 0.0
    assert when.within(0.0) == pytest.approx(1.0)


def test_what_is_beyond_the_horizon_is_not_a_number() -> None:
    when = passage([sure(1.0, -1.0e-9)], [(0.0, 0.0)]).bent(FUTURE_BENDS)
    assert when.quantile_m(0.5) is None
    assert when.within(1.0e7) < 1e-6
    assert when.quantiles_m(np.array([0.5])).tolist() == [HORIZON_M]


def test_a_loss_counts_against_the_channels_own_start() -> None:
    weak = sure(0.86, -1.0e-9, start=0.9)  # lost a twentieth, which is 14 % below new
    of_new, of_own = passage([weak], [(0.9, 0.0)]), passage([weak], [(0.0, 0.9)])
    assert of_new.within(0.0) == pytest.approx(1.0)
    assert of_own.within(0.0) < 0.01
    both = passage([weak], [(0.9, 0.0), (0.0, 0.9)])
    np.testing.assert_allclose(both.probability, np.maximum(of_new.probability, of_own.probability))


@given(
    now=st.floats(-0.5, 1.5),
    rate=st.floats(-1e-7, -1e-11),
    std=st.floats(1e-4, 0.5),
    limit=st.floats(0.0, 0.9),
    share=st.floats(0.0, 0.9),
)
def test_probabilities_never_fall_and_quantiles_are_in_order(
    now: float, rate: float, std: float, limit: float, share: float
) -> None:
    when = passage([sure(now, rate, std=std)], [(limit, share)]).bent(FUTURE_BENDS)
    assert np.all(np.diff(when.probability) >= -1e-12)
    assert -1e-9 <= when.probability[0] <= when.probability[-1] <= 1.0 + 1e-9
    quantiles = when.quantiles_m(np.linspace(0.01, 0.99, 21))
    assert np.all(np.diff(quantiles) >= 0.0)
    known = when.quantile_m(0.5)
    if known is not None and known > 0.0:
        assert when.within(known) == pytest.approx(0.5, abs=1e-6)


def test_of_two_limits_the_first_counts() -> None:
    near = Passage(distance_m=DISTANCE_M, probability=np.minimum(DISTANCE_M / 1.0e8, 1.0))
    never = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))
    np.testing.assert_allclose(near.or_(never).probability, near.probability)
    assert near.or_(near).within(5.0e7) == pytest.approx(0.75, abs=0.01)
