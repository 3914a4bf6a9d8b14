"""The bank of bends: rates, temperature, bends in the past, and two clocks."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diag_service.diagnosis.prognosis.assumptions import FUTURE_BENDS, HORIZON_M, MARGIN_OF_NEW
from diag_service.diagnosis.prognosis.channels import DISTANCE_M, ChannelName, Clock, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History, robust_noise_ratio
from diag_service.diagnosis.prognosis.trend import (
    Fit,
    Mixture,
    Part,
    Passage,
    aged,
    fit,
    log_evidence,
    normal_cdf,
    passage,
    probability_falling,
    summary,
)
from tests.support.pasts import REFERENCE, ageing, past

COUNT = 400
STEP_M = 1.0e5
PER_KM = 1000.0


def margin_fit(history: History, clock: int = 0) -> Fit:
    clocks = clocks_of(history, 0, len(history), is_new=False)
    margin = next(
        one for one in channels_of(history, 0, len(history), REFERENCE, clocks) if one.name is ChannelName.MARGIN
    )
    return fit(margin, clock, float(clocks[clock].age_m[-1]), MARGIN_OF_NEW, 0.0)


@pytest.mark.parametrize("until", [0.8, 0.5, 0.1])
def test_an_even_fall_is_found_with_its_deviation(until: float) -> None:
    one = margin_fit(past(ageing(COUNT, until=until), step_m=STEP_M))
    mean, std = summary(one, Part.RATE)
    truth = (until - 1.0) / (STEP_M * (COUNT - 1))
    assert abs(mean - truth) < 3.0 * std
    assert std < 0.5e-8
    assert probability_falling(one) > 0.9
    now, now_std = summary(one, Part.NOW)
    assert abs(now - until) < 3.0 * now_std


def test_no_fall_has_no_sign() -> None:
    chances = [probability_falling(margin_fit(past(np.ones(60), noise_ratio=0.03, seed=seed))) for seed in range(20)]
    assert 0.3 < np.mean(chances) < 0.7
    assert np.mean(np.array(chances) >= 0.9) < 0.4


def test_a_bend_in_the_past_counts_more_than_the_mean_over_the_life() -> None:
    bent = np.concatenate((np.linspace(1.0, 0.95, 200), np.linspace(0.95, 0.35, 200)))
    rate, std = summary(margin_fit(past(bent, step_m=STEP_M, noise_ratio=0.005)), Part.RATE)
    truth = -0.6 / (200 * STEP_M)
    assert rate == pytest.approx(truth, rel=0.25)
    assert abs(rate - truth) < 3.0 * std


def test_running_in_is_no_ageing() -> None:
    age = np.arange(COUNT) * STEP_M
    margin = 1.0 - 0.15 * (1.0 - np.exp(-age / 3.0e6)) - 0.5e-8 * age
    rate, std = summary(margin_fit(past(margin, step_m=STEP_M, noise_ratio=0.005)), Part.RATE)
    assert abs(rate + 0.5e-8) < 3.0 * std
    assert abs(rate + 0.5e-8) < 0.4e-8


def test_warm_oil_in_the_end_is_no_ageing() -> None:
    warmth_k = np.linspace(-20.0, 20.0, COUNT) + 10.0 * np.sin(np.arange(COUNT))
    calm = past(np.ones(COUNT), step_m=STEP_M, warmth_k=warmth_k, noise_ratio=0.005)
    warm = replace(calm, mu_s=calm.mu_s * (1.0 + 2.0e-4 * warmth_k))
    one = margin_fit(warm)
    per_k, std_per_k = summary(one, Part.WARMTH)
    truth = -2.0e-4 * REFERENCE.mu_s / (REFERENCE.mu_c - REFERENCE.mu_s)
    assert abs(per_k - truth) < 3.0 * std_per_k
    rate, std = summary(one, Part.RATE)
    assert abs(rate) < 3.0 * std


def test_a_load_that_changes_speaks_for_the_clock_of_energy() -> None:
    load = np.where(np.arange(COUNT) < 200, 0.4, 1.6)
    worked = past(1.0 - 0.8 * np.cumsum(load) / load.sum(), step_m=STEP_M, noise_ratio=0.005)
    worked = replace(worked, slip_energy_j=8.0e3 * load)
    by_km, by_energy = clocks_of(worked, 0, COUNT, is_new=False)[:2]
    assert by_energy.pace == pytest.approx(1.6, rel=0.05)
    evidence = [aged(margin_fit(worked, row), MARGIN_OF_NEW, one, 0.0)[1] for row, one in enumerate((by_km, by_energy))]
    assert evidence[1] > evidence[0]


def test_wear_that_slows_speaks_for_a_clock_that_does() -> None:
    slowed = past(1.0 - 0.6 * np.linspace(0.0, 1.0, COUNT) ** 0.5, step_m=2.0e5, noise_ratio=0.005)
    clocks = clocks_of(slowed, 0, COUNT, is_new=True)
    margin = next(iter(channels_of(slowed, 0, COUNT, REFERENCE, clocks)))
    evidence = log_evidence(margin, MARGIN_OF_NEW, np.zeros(1))[:, 0]
    best = clocks[int(np.argmax(evidence))]
    assert best.pace < 0.8
    assert evidence.max() > evidence[0] + 3.0


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
    history = past(ageing(COUNT), step_m=STEP_M)
    clock = clocks_of(history, 0, COUNT, is_new=False)[0]
    near, far = (
        passage([aged(margin_fit(history), MARGIN_OF_NEW, clock, random_per_m)[0]], [(0.0, 0.0)])
        for random_per_m in (0.0, 0.1**2 / 1.0e8)
    )
    widths = [np.diff(one.quantiles_m(np.array([0.05, 0.95])))[0] for one in (near, far)]
    assert widths[1] > 1.2 * widths[0]


def test_a_scale_that_all_results_share_is_not_averaged_away() -> None:
    history = past(np.full(COUNT, 1.0), noise_ratio=0.005)
    split = replace(history, common_correlation=np.zeros(COUNT))
    _, together = summary(margin_fit(history), Part.NOW)
    _, apart = summary(margin_fit(split), Part.NOW)
    assert apart > 2.0 * together


def test_rates_of_ageing_are_falls() -> None:
    history = past(ageing(COUNT))
    clock = clocks_of(history, 0, COUNT, is_new=False)[0]
    mixture, _ = aged(margin_fit(history), MARGIN_OF_NEW, clock, 0.0)
    assert mixture.weight.sum() == pytest.approx(1.0)
    assert np.all(mixture.rate_per_m < 0.0)
    rising, _ = aged(margin_fit(past(np.linspace(1.0, 3.0, COUNT), noise_ratio=0.002)), MARGIN_OF_NEW, clock, 0.0)
    assert np.all(rising.rate_per_m < 0.0)
    assert np.all(np.isfinite(rising.now))


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
