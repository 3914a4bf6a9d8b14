"""The prognosis: its history, its trend and its limits."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, level_at
from clutch_results.prognosis import History, Outlook, Prognosis, history_of, prognose
from clutch_results.prognosis.assumptions import KNEE_PROBABILITY, LOAD_LOG_STD, MARGIN_OF_NEW
from clutch_results.prognosis.channels import DISTANCE_M, ChannelName, channels_of, clocks_of
from clutch_results.prognosis.fluid_lives import either
from clutch_results.prognosis.prognosis import Reach, forecast
from clutch_results.prognosis.trend import AgedChannel, Future, aged, gram_matrices, passage
from clutch_results.records import FluidFill, ShiftResult, utc_from_bus_ns
from tests.support.builders import at
from tests.support.histories import history as stored
from tests.support.pasts import REFERENCE, ageing, past

STEP_M = 1.0e5
COUNT = 400  # 40,000 km


def reach(found: Prognosis) -> Reach:
    assert found.change_fluid is not None
    return found.change_fluid


def distance_m(value: float | None) -> float:
    assert value is not None
    return value


@pytest.mark.parametrize("seed", range(4))
def test_an_even_fall_reaches_its_limit_inside_the_interval(seed: int) -> None:
    found = prognose(1, past(ageing(COUNT, until=0.4), step_m=STEP_M, seed=seed), REFERENCE)
    assert found.outlook is Outlook.AGEING
    change, watch = reach(found), found.watch
    assert watch is not None
    truth_m = 0.4 / 0.6 * STEP_M * COUNT
    assert distance_m(change.p10_m) < truth_m < distance_m(change.p90_m)
    assert distance_m(change.p10_m) < distance_m(change.p50_m) < distance_m(change.p90_m)
    assert distance_m(watch.p90_m) < 5.0e6  # half of the margin was gone 6,000 km ago


def test_the_limits_are_those_of_the_verdict() -> None:
    falling = np.linspace(1.0, CHANGE_LEVEL_RATIO - 0.02, COUNT)
    found = prognose(1, past(np.ones(COUNT), level=falling, step_m=STEP_M), REFERENCE)
    assert reach(found).passage.within(0.0) > 0.7
    watch = np.linspace(1.0, WATCH_LEVEL_RATIO - 0.03, COUNT)
    found = prognose(1, past(np.ones(COUNT), level=watch, step_m=STEP_M), REFERENCE)
    assert found.watch is not None
    assert found.watch.passage.within(0.0) > 0.7
    assert reach(found).passage.within(0.0) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_products_of_means_are_those_of_their_whole_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns, variance = rng.standard_normal((2, 4, 12)), rng.uniform(1e-4, 1e-2, 12)
    ages, random = np.cumsum(rng.uniform(0.0, 0.2, (2, 12)), axis=1), np.array([0.0, 0.01, 0.3])
    ages[:, 5] = ages[:, 4]  # driving that counts for nothing
    gram, log_determinant = gram_matrices(columns, ages, variance, random)
    for clock, amount in np.ndindex(log_determinant.shape):
        own, common = ages[clock], columns[clock, -1]
        covariance = np.diag(variance) + random[amount] * np.minimum.outer(own, own) + np.outer(common, common)
        assert gram[clock, amount] == pytest.approx(columns[clock] @ np.linalg.solve(covariance, columns[clock].T))
        assert log_determinant[clock, amount] == pytest.approx(np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("is_noted", [True, False])
def test_after_new_fluid_the_future_is_long_again(is_noted: bool) -> None:
    margin = np.concatenate((ageing(300, until=0.3), np.linspace(1.0, 0.9, 60)))
    level = np.concatenate((np.linspace(1.0, 0.92, 300), np.linspace(0.97, 0.96, 60)))
    filled = past(margin, level=level, step_m=STEP_M, fills=(300,) if is_noted else ())
    before, after = prognose(1, filled.first(300), REFERENCE), prognose(1, filled, REFERENCE)
    assert distance_m(reach(before).p50_m) < 2.5e7 < distance_m(reach(after).p50_m)
    assert [start.is_noted for start in after.fluid_starts] == [True, is_noted]
    told = [line for line in after.assumptions if "not noted" in line]
    assert len(told) == (0 if is_noted else 1)


def test_a_fluid_of_unknown_age_is_not_taken_for_new() -> None:
    worn = replace(past(np.full(40, 0.4), step_m=1.0e4), new_fluids=())
    new = past(np.ones(40), step_m=1.0e4)
    found = prognose(1, worn, REFERENCE)
    assert found.life is not None
    assert found.life.channels[ChannelName.MARGIN].now.mean == pytest.approx(0.4, abs=0.1)
    assert distance_m(reach(found).p10_m) < distance_m(reach(prognose(1, new, REFERENCE)).p10_m)


def with_late_knee(share: float, *, factor: float = 3.5, knee: float = 0.77, count: int = 800) -> tuple[History, float]:
    """Return the past at a share of a life whose wear becomes some times as fast, and what is left of it [m]."""
    at = np.arange(count) / count
    worn = at + (factor - 1.0) * np.maximum(at - knee, 0.0)
    margin = 1.0 - worn / (1.0 + (factor - 1.0) * (1.0 - knee))
    return past(margin, step_m=STEP_M).first(int(share * count)), (1.0 - share) * count * STEP_M


@pytest.mark.parametrize("share", [0.5, 0.65, 0.75])
def test_a_late_knee_to_come_is_inside_the_interval(share: float) -> None:
    history, left_m = with_late_knee(share)
    early_m, late_m = reach(prognose(1, history, REFERENCE)).passage.quantiles_m(np.array([0.05, 0.95]))
    assert early_m < left_m < late_m


@pytest.mark.parametrize("step_m", [5.0e4, 2.0e5])
def test_more_wear_over_the_same_distance_makes_a_life_shorter(step_m: float) -> None:
    medians_m = [
        distance_m(reach(prognose(1, past(ageing(COUNT, until=until), step_m=step_m), REFERENCE)).p50_m)
        for until in (0.7, 0.5, 0.3, 0.1)
    ]
    assert medians_m == sorted(medians_m, reverse=True)


def own_of(results: Sequence[ShiftResult], clutch: int) -> list[ShiftResult]:
    return [one for one in results if one.estimate.clutch == clutch]


def with_odometer(result: ShiftResult, odometer_m: float | None) -> ShiftResult:
    return replace(result, estimate=at(result.estimate, odometer_m=odometer_m))


def test_used_events_are_rows() -> None:
    results = stored(60)
    found = history_of(results, (), 1)
    own = own_of(results, 1)
    used = [one for one in own if one.estimate.friction is not None]
    assert found.mu_c.tolist() == [one.estimate.friction.mu_c for one in used if one.estimate.friction]
    assert found.left_out_count == 0


def test_results_without_odometer_or_with_one_that_went_back_are_counted() -> None:
    results = [one for one in stored(40) if one.estimate.friction is not None and one.estimate.clutch == 1]
    results[3], results[5] = with_odometer(results[3], None), with_odometer(results[5], 1.0)
    found = history_of(results, (), 1)
    assert (len(found), found.left_out_count) == (len(results) - 2, 2)
    assert np.all(np.diff(found.odometer_m) >= 0.0)


def test_a_fill_begins_another_fluid_that_was_new_when_seen_soon_after() -> None:
    results = stored(60)
    at = utc_from_bus_ns(results[30].estimate.start_ns)
    known_m = FluidFill(vehicle="car1", filled_at=at, odometer_m=results[29].estimate.conditions.odometer_m)
    found = history_of(results, (known_m,), 1)
    assert np.unique(found.fluid_number).tolist() == [0, 1]
    assert found.new_fluids == (0, 1)
    without = history_of(results, (replace(known_m, odometer_m=None),), 1)
    assert without.new_fluids == (0, 1)
    unseen = [
        *results[:30],
        *(with_odometer(one, 9.0e7 + (one.estimate.conditions.odometer_m or 0.0)) for one in results[30:]),
    ]
    assert history_of(unseen, (replace(known_m, odometer_m=6.0e7),), 1).new_fluids == (0,)
    assert history_of(unseen, (replace(known_m, odometer_m=8.9e7),), 1).new_fluids == (0, 1)


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
        weight=np.ones(1),
        fall=-rate_per_m * DISTANCE_M[None],
        fall_variance=(LOAD_LOG_STD * rate_per_m * DISTANCE_M[None]) ** 2,
        now=np.array([now]),
        now_variance=np.array([std**2]),
        start=np.array([start]),
        start_variance=np.array([std**2]),
        now_start_covariance=np.zeros(1),
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


@pytest.mark.parametrize("until", [0.9, 0.4, 0.05])
def test_a_forecast_is_that_of_all_limits_at_all_distances(until: float) -> None:
    prognosis = prognose(1, past(ageing(COUNT, until=until), step_m=STEP_M), REFERENCE)
    drawn = forecast(prognosis, 1.0e8)
    assert drawn is not None
    assert prognosis.life is not None
    lefts = np.linspace(-0.2, 1.2, 36)
    passed = [either(prognosis.life, left, level_at(left)).probability for left in lefts.tolist()]
    columns = np.maximum.accumulate(passed).T[np.isin(DISTANCE_M, drawn.distance_m)]
    every = np.transpose([np.interp((0.1, 0.5, 0.9), column, lefts) for column in columns])
    np.testing.assert_allclose(drawn.quantiles, every, rtol=0.0, atol=1e-6)
    assert drawn.distance_m[0] == 0.0
    assert 9.0e7 < drawn.distance_m[-1] <= 1.0e8
    assert 30 <= len(drawn.distance_m) <= 93


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
