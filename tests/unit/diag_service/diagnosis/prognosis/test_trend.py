"""Courses of wear: rates, temperature, bends behind and ahead, and clocks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diag_service.diagnosis.prognosis.assumptions import KNEE_PROBABILITY, MARGIN_OF_NEW, USUAL_LIFE_M
from diag_service.diagnosis.prognosis.channels import DISTANCE_M, ChannelName, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.trend import AgedChannel, Future, aged, passage
from tests.support.pasts import REFERENCE, ageing, past

COUNT = 400
STEP_M = 1.0e5


def margin_of(history: History, *, bend_chance: float = KNEE_PROBABILITY, is_new: bool = False) -> AgedChannel:
    clocks = clocks_of(history, 0, len(history), is_new=is_new)
    margin = next(
        one for one in channels_of(history, 0, len(history), REFERENCE, clocks) if one.name is ChannelName.MARGIN
    )
    return aged(margin, clocks, MARGIN_OF_NEW, bend_chance)


@pytest.mark.parametrize("until", [0.8, 0.5, 0.1])
def test_an_even_fall_is_found_with_its_deviation(until: float) -> None:
    one = margin_of(past(ageing(COUNT, until=until), step_m=STEP_M))
    truth = (until - 1.0) / (STEP_M * (COUNT - 1))
    assert abs(one.rate_per_m.mean - truth) < 3.0 * one.rate_per_m.std
    assert one.rate_per_m.std < 0.5e-8
    assert one.probability_falling > 0.9
    assert abs(one.now.mean - until) < 3.0 * one.now.std
    assert abs(one.fallen.mean - (1.0 - until)) < 3.0 * one.fallen.std


def test_a_bend_in_the_past_counts_more_than_the_mean_over_the_life() -> None:
    bent = np.concatenate((np.linspace(1.0, 0.95, 200), np.linspace(0.95, 0.35, 200)))
    one = margin_of(past(bent, step_m=STEP_M, noise_ratio=0.005))
    truth = -0.6 / (200 * STEP_M)
    assert one.rate_per_m.mean == pytest.approx(truth, rel=0.25)
    assert abs(one.rate_per_m.mean - truth) < 3.0 * one.rate_per_m.std
    even = margin_of(past(ageing(COUNT, until=0.35), step_m=STEP_M, noise_ratio=0.005))
    assert one.bent_odds > 100.0
    assert even.bent_odds < 1.0


def sure(now: float, rate_per_m: float, *, std: float = 0.001, start: float = 1.0) -> Future:
    """Return a channel that is known well."""
    return Future(
        ahead=DISTANCE_M[None] / USUAL_LIFE_M,
        loss=np.array([-rate_per_m * USUAL_LIFE_M]),
        now=np.array([now]),
        now_variance=np.array([std**2]),
        start=np.array([start]),
        start_variance=np.array([std**2]),
        now_start_covariance=np.zeros(1),
        random=np.zeros(1),
    )


def test_a_well_known_fall_passes_where_the_line_does() -> None:
    when = passage(sure(0.5, -1.0e-8), [(0.0, 0.0)])
    median_m = when.quantile_m(0.5)
    assert median_m is not None
    assert median_m == pytest.approx(5.0e7, rel=0.01)
    p10_m, p90_m = when.quantile_m(0.1), when.quantile_m(0.9)
    assert p10_m is not None
    assert p90_m is not None
    assert p10_m < median_m < p90_m < 1.05 * 5.0e7


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
    when = passage(sure(now, rate, std=std), [(limit, share)])
    assert np.all(np.diff(when.probability) >= -1e-12)
    assert -1e-9 <= when.probability[0] <= when.probability[-1] <= 1.0 + 1e-9
    quantiles = when.quantiles_m(np.linspace(0.01, 0.99, 21))
    assert np.all(np.diff(quantiles) >= 0.0)
    known = when.quantile_m(0.5)
    if known is not None and known > 0.0:
        assert when.within(known) == pytest.approx(0.5, abs=1e-6)
