"""The past of a clutch from stored results: parts of the errors, fluids, what is left out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diag_service.diagnosis.prognosis import history_of
from diag_service.diagnosis.records import FluidFill, ShiftResult, utc_from_bus_ns
from tests.support.histories import history as stored


def own_of(results: Sequence[ShiftResult], clutch: int) -> list[ShiftResult]:
    return [one for one in results if one.estimate.clutch == clutch]


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


def test_results_without_odometer_or_with_one_that_went_back_are_counted() -> None:
    results = [one for one in stored(40) if one.estimate.friction is not None and one.estimate.clutch == 1]
    results[3], results[5] = with_odometer(results[3], None), with_odometer(results[5], 1.0)
    found = history_of(results, (), 1)
    assert (len(found), found.left_out_count) == (len(results) - 2, 2)
    assert np.all(np.diff(found.odometer_m) >= 0.0)


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
