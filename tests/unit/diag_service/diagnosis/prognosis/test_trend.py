"""The bank of bends: rates, temperature, bends in the past, and two clocks."""

from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis.assumptions import MARGIN_OF_NEW
from diag_service.diagnosis.prognosis.channels import ChannelName, channels_of, clocks_of
from diag_service.diagnosis.prognosis.history import History
from diag_service.diagnosis.prognosis.trend import Fit, Part, aged, fit, probability_falling, summary
from tests.support.pasts import REFERENCE, ageing, past

COUNT = 400
STEP_M = 1.0e5
PER_KM = 1000.0


def margin_fit(history: History, clock: int = 0) -> Fit:
    clocks = clocks_of(history, 0, len(history))
    margin = next(
        one for one in channels_of(history, 0, len(history), REFERENCE, clocks) if one.name is ChannelName.MARGIN
    )
    return fit(margin.bins, clock, MARGIN_OF_NEW, margin.common_std, float(clocks[clock].age_m[-1]))


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
    clocks = clocks_of(worked, 0, COUNT)
    assert clocks[1].recent_ratio == pytest.approx(1.6, rel=0.05)
    by_km, by_energy = margin_fit(worked), margin_fit(worked, 1)
    assert aged(by_energy, MARGIN_OF_NEW, 1.6)[1] > aged(by_km, MARGIN_OF_NEW, 1.0)[1]


def test_a_scale_that_all_results_share_is_not_averaged_away() -> None:
    history = past(np.full(COUNT, 1.0), noise_ratio=0.005)
    split = replace(history, common_correlation=np.zeros(COUNT))
    _, together = summary(margin_fit(history), Part.NOW)
    _, apart = summary(margin_fit(split), Part.NOW)
    assert apart > 2.0 * together


def test_rates_of_ageing_are_falls() -> None:
    mixture, _ = aged(margin_fit(past(ageing(COUNT))), MARGIN_OF_NEW, 1.0)
    assert mixture.weight.sum() == pytest.approx(1.0)
    assert np.all(mixture.rate_per_m < 0.0)
    rising, _ = aged(margin_fit(past(np.linspace(1.0, 3.0, COUNT), noise_ratio=0.002)), MARGIN_OF_NEW, 1.0)
    assert np.all(rising.rate_per_m < 0.0)
    assert np.all(np.isfinite(rising.now))
