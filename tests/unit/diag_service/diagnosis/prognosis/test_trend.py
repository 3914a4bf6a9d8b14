"""Courses of wear: rates, temperature, bends behind and ahead, and clocks."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diag_service.diagnosis.prognosis.assumptions import HORIZON_M, KNEE_PROBABILITY, MARGIN_OF_NEW, USUAL_LIFE_M
from diag_service.diagnosis.prognosis.channels import DISTANCE_M, ChannelName, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History, robust_noise_ratio
from diag_service.diagnosis.prognosis.trend import AgedChannel, Future, Passage, aged, normal_cdf, passage
from tests.support.pasts import REFERENCE, ageing, past

COUNT = 400
STEP_M = 1.0e5
PER_KM = 1000.0


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


def test_no_fall_has_no_sign() -> None:
    chances = [margin_of(past(np.ones(60), noise_ratio=0.03, seed=seed)).probability_falling for seed in range(20)]
    assert 0.3 < np.mean(chances) < 0.7
    assert np.mean(np.array(chances) >= 0.9) < 0.4


def test_a_bend_in_the_past_counts_more_than_the_mean_over_the_life() -> None:
    bent = np.concatenate((np.linspace(1.0, 0.95, 200), np.linspace(0.95, 0.35, 200)))
    one = margin_of(past(bent, step_m=STEP_M, noise_ratio=0.005))
    truth = -0.6 / (200 * STEP_M)
    assert one.rate_per_m.mean == pytest.approx(truth, rel=0.25)
    assert abs(one.rate_per_m.mean - truth) < 3.0 * one.rate_per_m.std
    even = margin_of(past(ageing(COUNT, until=0.35), step_m=STEP_M, noise_ratio=0.005))
    assert one.bent_odds > 100.0
    assert even.bent_odds < 1.0


def test_running_in_is_no_ageing() -> None:
    age = np.arange(COUNT) * STEP_M
    margin = 1.0 - 0.15 * (1.0 - np.exp(-age / 3.0e6)) - 0.5e-8 * age
    rate = margin_of(past(margin, step_m=STEP_M, noise_ratio=0.005)).rate_per_m
    assert abs(rate.mean + 0.5e-8) < 3.0 * rate.std
    assert abs(rate.mean + 0.5e-8) < 0.4e-8


def test_warm_oil_in_the_end_is_no_ageing() -> None:
    warmth_k = np.linspace(-20.0, 20.0, COUNT) + 10.0 * np.sin(np.arange(COUNT))
    calm = past(np.ones(COUNT), step_m=STEP_M, warmth_k=warmth_k, noise_ratio=0.005)
    one = margin_of(replace(calm, mu_s=calm.mu_s * (1.0 + 2.0e-4 * warmth_k)))
    truth = -2.0e-4 * REFERENCE.mu_s / (REFERENCE.mu_c - REFERENCE.mu_s)
    assert abs(one.warmth_per_k.mean - truth) < 3.0 * one.warmth_per_k.std
    assert abs(one.fallen.mean) < 3.0 * one.fallen.std


def test_a_load_that_changes_speaks_for_the_clock_of_energy() -> None:
    load = np.where(np.arange(COUNT) < 200, 0.4, 1.6)
    worked = past(1.0 - 0.8 * np.cumsum(load) / load.sum(), step_m=STEP_M, noise_ratio=0.005)
    worked = replace(worked, slip_energy_j=8.0e3 * load)
    truth = -0.8 * 1.6 / (load.sum() * STEP_M)
    assert clocks_of(worked, 0, COUNT, is_new=False)[1].pace == pytest.approx(1.6, rel=0.05)
    assert margin_of(worked).rate_per_m.mean == pytest.approx(truth, rel=0.2)


def test_wear_that_slows_speaks_for_a_clock_that_does() -> None:
    slowed = past(1.0 - 0.6 * np.linspace(0.0, 1.0, COUNT) ** 0.5, step_m=2.0e5, noise_ratio=0.005)
    truth = -0.6 * 0.5 / (COUNT * 2.0e5)
    rate = margin_of(slowed, is_new=True).rate_per_m
    assert rate.mean == pytest.approx(truth, rel=0.25)


def test_a_year_ahead_is_as_warm_as_the_year_before() -> None:
    days = np.arange(2 * 365.0)
    season_k = 15.0 * np.sin(2.0 * np.pi * days / 365.25)
    driven = replace(
        past(np.ones(len(days)), step_m=4.0e4, warmth_k=season_k), end_s=days * 86_400.0, slip_energy_j=None
    )
    warm_half, cold_half = (
        clocks_of(driven.first(count), 0, count, is_new=False)[-1] for count in (len(days), len(days) - 183)
    )
    assert warm_half.pace > 1.2  # summer is to come
    assert cold_half.pace < 0.8
    year_m = 365.0 * 4.0e4
    assert np.interp(year_m, DISTANCE_M, warm_half.ahead_m) == pytest.approx(year_m, rel=0.05)


def test_a_fluid_of_unknown_age_is_not_asked_whether_its_wear_slows() -> None:
    history = past(np.ones(COUNT))
    new, unknown = (clocks_of(history, 0, COUNT, is_new=one) for one in (True, False))
    assert len(new) > len(unknown)
    assert np.exp([one.log_prior for one in unknown]).sum() == pytest.approx(1.0)


def test_random_wear_widens_what_is_to_come() -> None:
    near, far = (passage(replace(sure(0.5, -1.0e-8), random=np.array([one])), [(0.0, 0.0)]) for one in (0.0, 0.01))
    widths = [np.diff(one.quantiles_m(np.array([0.05, 0.95])))[0] for one in (near, far)]
    assert widths[1] > 1.2 * widths[0]


def test_a_scale_that_all_results_share_is_not_averaged_away() -> None:
    history = past(np.full(COUNT, 1.0), noise_ratio=0.005)
    split = replace(history, common_correlation=np.zeros(COUNT))
    assert margin_of(split).now.std > 2.0 * margin_of(history).now.std


def test_rates_of_ageing_are_falls() -> None:
    for margin in (ageing(COUNT), np.linspace(1.0, 3.0, COUNT)):
        future = margin_of(past(margin, noise_ratio=0.002)).future
        assert np.all(future.loss > 0.0)
        assert np.all(np.isfinite(future.now))


def test_bends_to_come_are_as_likely_as_they_are_said_to_be() -> None:
    history = past(ageing(COUNT, until=0.6), step_m=STEP_M, noise_ratio=0.005)  # 60,000 km are left
    few, many = (passage(margin_of(history, bend_chance=one, is_new=True).future, [(0.0, 0.0)]) for one in (0.01, 0.4))
    assert few.within(4.0e7) < 0.05
    assert many.within(4.0e7) > 0.15
    assert few.quantiles_m(np.array([0.9]))[0] == pytest.approx(many.quantiles_m(np.array([0.9]))[0], rel=0.05)


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


def test_what_is_passed_already_is_zero_away() -> None:
    when = passage(sure(-0.1, -1.0e-8), [(0.0, 0.0)])
    assert when.quantile_m(0.9) == 0.0
    assert when.within(0.0) == pytest.approx(1.0)


def test_what_is_beyond_the_horizon_is_not_a_number() -> None:
    when = passage(sure(1.0, -1.0e-9), [(0.0, 0.0)])
    assert when.quantile_m(0.5) is None
    assert when.within(1.0e7) < 1e-6
    assert when.quantiles_m(np.array([0.5])).tolist() == [HORIZON_M]


def test_a_loss_counts_against_the_channels_own_start() -> None:
    weak = sure(0.86, -1.0e-9, start=0.9)  # lost a twentieth, which is 14 % below new
    of_new, of_own = passage(weak, [(0.9, 0.0)]), passage(weak, [(0.0, 0.9)])
    assert of_new.within(0.0) == pytest.approx(1.0)
    assert of_own.within(0.0) < 0.01
    both = passage(weak, [(0.9, 0.0), (0.0, 0.9)])
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
    when = passage(sure(now, rate, std=std), [(limit, share)])
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
