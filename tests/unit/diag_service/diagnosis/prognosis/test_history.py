"""The past of a clutch from stored results: parts of the errors, fluids, what is left out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diag_service.diagnosis.prognosis import history_of
from diag_service.diagnosis.records import FluidFill, ShiftResult, utc_from_bus_ns
from tests.support.histories import history as stored
from tests.support.pasts import ageing, past


def own_of(results: Sequence[ShiftResult], clutch: int) -> list[ShiftResult]:
    return [one for one in results if one.estimate.clutch == clutch]


def own_valid(count: int) -> list[ShiftResult]:
    return [one for one in own_of(stored(count), 1) if one.estimate.friction is not None]


def with_odometer(result: ShiftResult, odometer_m: float | None) -> ShiftResult:
    return replace(result, estimate=replace(result.estimate, odometer_m=odometer_m))


def test_used_events_are_rows_and_all_events_are_counted() -> None:
    results = stored(60)
    found = history_of(results, (), 1)
    own = own_of(results, 1)
    used = [one for one in own if one.estimate.friction is not None]
    assert found.mu_c.tolist() == [one.estimate.friction.mu_c for one in used if one.estimate.friction]
    assert found.event_count.sum() == 1 + own.index(used[-1])
    assert found.left_out_count == 0


def test_random_and_common_errors_add_up_to_the_stated_ones() -> None:
    found = history_of(stored(30), (), 2)
    own = [one.estimate.friction for one in own_of(stored(30), 2) if one.estimate.friction]
    for name in ("mu_c", "mu_s"):
        total = np.hypot(getattr(found, f"random_std_{name}"), getattr(found, f"common_std_{name}"))
        np.testing.assert_allclose(total, [getattr(one, f"std_{name}") for one in own])


def test_the_order_of_the_results_does_not_matter() -> None:
    results = stored(40)
    forward, backward = history_of(results, (), 1), history_of(results[::-1], (), 1)
    np.testing.assert_array_equal(forward.odometer_m, backward.odometer_m)
    np.testing.assert_array_equal(forward.event_count, backward.event_count)


def test_results_without_a_date_stay_in_their_order() -> None:
    results = own_valid(9)
    undated = [
        replace(one, estimate=replace(one.estimate, start_ns=one.estimate.start_ns % 7, end_ns=one.estimate.end_ns % 7))
        for one in results
    ]
    assert history_of(undated, (), 1).odometer_m.tolist() == history_of(results, (), 1).odometer_m.tolist()


def test_results_without_odometer_or_with_one_that_went_back_are_counted() -> None:
    results = [one for one in stored(40) if one.estimate.friction is not None and one.estimate.clutch == 1]
    results[3], results[5] = with_odometer(results[3], None), with_odometer(results[5], 1.0)
    found = history_of(results, (), 1)
    assert (len(found), found.left_out_count) == (len(results) - 2, 2)
    assert np.all(np.diff(found.odometer_m) >= 0.0)


@pytest.mark.parametrize("wrong_m", [1.0e9, 5.0e7])
@pytest.mark.parametrize("at", [0, 5])
def test_one_wrong_odometer_costs_one_result(wrong_m: float, at: int) -> None:
    results = own_valid(60)
    results[at] = with_odometer(results[at], wrong_m)
    found = history_of(results, (), 1)
    assert (len(found), found.left_out_count, found.is_stale) == (len(results) - 1, 1, False)
    read_m = [one.estimate.odometer_m for number, one in enumerate(results) if number != at]
    assert found.odometer_m.tolist() == read_m


def test_after_another_instrument_cluster_the_distance_goes_on() -> None:
    results = own_valid(60)
    before = [with_odometer(one, (one.estimate.odometer_m or 0.0) + 3.0e7) for one in results[:12]]
    found = history_of([*before, *results[12:]], (), 1)
    assert (len(found), found.left_out_count, found.is_stale) == (len(results), 0, False)
    first_m, last_m = (one.estimate.odometer_m or 0.0 for one in (results[12], results[-1]))
    assert found.odometer_m[-1] - found.odometer_m[12] == pytest.approx(last_m - first_m)


def test_a_past_to_which_nothing_is_added_is_stale() -> None:
    results = own_valid(60)
    unknown = [with_odometer(one, None) for one in results[-6:]]
    assert history_of([*results[:-6], *unknown], (), 1).is_stale
    assert not history_of([*results[:-6], *unknown[:3]], (), 1).is_stale


def test_nothing_known_is_an_empty_past() -> None:
    found = history_of((), (), 1)
    assert (len(found), found.new_fluids, found.slip_energy_j) == (0, (), None)


def test_a_fill_begins_another_fluid_that_was_new_when_seen_soon_after() -> None:
    results = stored(60)
    at = utc_from_bus_ns(results[30].estimate.start_ns)
    known_m = FluidFill(vehicle="car1", filled_at=at, odometer_m=results[29].estimate.odometer_m)
    found = history_of(results, (known_m,), 1)
    assert np.unique(found.fluid_number).tolist() == [0, 1]
    assert found.new_fluids == (0, 1)
    without = history_of(results, (replace(known_m, odometer_m=None),), 1)
    assert without.new_fluids == (0, 1)
    unseen = [*results[:30], *(with_odometer(one, 9.0e7 + (one.estimate.odometer_m or 0.0)) for one in results[30:])]
    assert history_of(unseen, (replace(known_m, odometer_m=6.0e7),), 1).new_fluids == (0,)
    assert history_of(unseen, (replace(known_m, odometer_m=8.9e7),), 1).new_fluids == (0, 1)


def test_a_fluid_is_new_also_by_the_odometer_of_another_instrument() -> None:
    results = own_valid(90)
    worn = [with_odometer(one, 1.0e8 + (one.estimate.odometer_m or 0.0)) for one in results[:15]]
    at = utc_from_bus_ns(results[30].estimate.start_ns)
    fill = FluidFill(vehicle="car1", filled_at=at, odometer_m=results[29].estimate.odometer_m)
    assert history_of([*worn, *results[15:]], (fill,), 1).new_fluids == (1,)


def test_columns_that_are_no_past_are_refused() -> None:
    good = past(ageing(20))
    with pytest.raises(ValueError, match="mu_c must have 20 finite values"):
        replace(good, mu_c=np.full(20, np.nan))
    with pytest.raises(ValueError, match="must not fall"):
        replace(good, odometer_m=good.odometer_m[::-1])
    with pytest.raises(ValueError, match="deviations must be > 0"):
        replace(good, random_std_mu_s=np.zeros(20))


def test_the_first_rows_are_a_past_too() -> None:
    whole = past(ageing(50))
    part = whole.first(20)
    assert len(part) == 20
    assert part.odometer_m[-1] == whole.odometer_m[19]
