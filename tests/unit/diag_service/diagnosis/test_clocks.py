"""A wrong clock is told, and where the odometer says so the order follows the odometer."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from clutch_results.clocks import chronicle_of, nanoseconds
from clutch_results.prognosis import history_of
from clutch_results.records import Condition, FluidFill, ShiftResult, iso_utc
from diag_service.diagnosis.summary import latest_of, order_by
from fleet_contract.orders import Action
from tests.support.builders import at, shift_result

TODAY_NS = nanoseconds("2026-12-01T12:00:00Z")
GOOD, WORN = Condition.GOOD, Condition.CHANGE_FLUID


def drive(year: int, odometer_km: float | None, condition: Condition, *, month: int = 9) -> list[ShiftResult]:
    """Return the results of a drive, one of each clutch."""
    stream = f"{year}-{month} {odometer_km} {condition}"
    day_ns = nanoseconds(iso_utc(datetime(year, month, 1, tzinfo=UTC)))
    odometer_m = None if odometer_km is None else 1000.0 * odometer_km
    drives = []
    for number in (1, 2):
        result = shift_result(number, stream=stream, to_gear=1 + number)
        start_ns = day_ns + 10**10 * number
        estimate = replace(at(result.estimate, odometer_m=odometer_m), start_ns=start_ns, end_ns=start_ns + 10**9)
        drives.append(
            replace(result, estimate=estimate, verdict=replace(result.verdict, condition=condition, advice=None))
        )
    return drives


def fill(month: int, odometer_km: float | None) -> FluidFill:
    odometer_m = None if odometer_km is None else 1000.0 * odometer_km
    return FluidFill(vehicle="car1", filled_at=iso_utc(datetime(2026, month, 15, tzinfo=UTC)), odometer_m=odometer_m)


AHEAD = (
    "The vehicle's clock was wrong: results are dated up to 2029-09-01, which is yet to come; the odometer says when "
    "they were. Set the clock."
)


@pytest.mark.parametrize("is_turned", [False, True])
@pytest.mark.parametrize(
    ("worn", "new", "note"),
    [
        (drive(2029, 15_000.0, WORN), drive(2026, 60_500.0, GOOD), AHEAD),
        (
            drive(2026, 60_000.0, WORN),
            drive(2020, 61_000.0, GOOD),
            (
                "Dates and odometer contradict each other: 61,000 km on 2020-09-01, 60,000 km on 2026-09-01; the "
                "odometer decides. Set the clock."
            ),
        ),
    ],
)
def test_the_odometer_decides_which_results_are_the_last(
    worn: list[ShiftResult], new: list[ShiftResult], note: str, *, is_turned: bool
) -> None:
    results = new + worn if is_turned else worn + new
    last = latest_of(results, TODAY_NS)
    assert {result.verdict.condition for result in last} == {GOOD}
    order = order_by(results[2:] if not is_turned else results[:2], None, today_ns=TODAY_NS)
    assert order.action is Action.NOTHING
    everything = order_by(last, None, today_ns=TODAY_NS, doubts=chronicle_of(results, (), TODAY_NS).doubts)
    assert everything.action is Action.NOTHING
    assert everything.notes == (note,)
    assert everything.text.endswith(note)


def test_without_an_odometer_a_wrong_date_is_only_told() -> None:
    last = latest_of(drive(2029, None, WORN) + drive(2026, None, GOOD), TODAY_NS)
    order = order_by(last, None, today_ns=TODAY_NS)
    assert order.action is Action.CHANGE_NOW
    assert " ".join(order.notes) == AHEAD.replace("the odometer says", "nothing else says")


@pytest.mark.parametrize(
    ("results", "fluid", "action"),
    [
        (drive(2029, 60_000.0, WORN), fill(10, 60_100.0), Action.NEW_FLUID),  # of the fluid before
        (drive(2029, 60_200.0, WORN), fill(10, 60_100.0), Action.CHANGE_NOW),
        (drive(2020, 60_500.0, GOOD), fill(10, 60_100.0), Action.NOTHING),
        (drive(2029, 60_000.0, WORN), fill(10, None), Action.CHANGE_NOW),  # only told
        (drive(2026, 60_000.0, WORN), fill(10, 60_100.0), Action.NEW_FLUID),
        (drive(2026, 60_200.0, GOOD, month=11), fill(10, 70_100.0), Action.NOTHING),  # somebody has mistyped it
    ],
)
def test_the_odometer_decides_of_which_fluid_a_result_is(
    results: list[ShiftResult], fluid: FluidFill, action: Action
) -> None:
    assert order_by(results, fluid, today_ns=TODAY_NS).action is action


def test_another_instrument_cluster_is_no_wrong_clock() -> None:
    before, after = drive(2026, 160_000.0, WORN, month=5), drive(2026, 300.0, GOOD)
    assert {result.verdict.condition for result in latest_of(before + after, TODAY_NS)} == {GOOD}
    order = order_by(before + after, None, today_ns=TODAY_NS)
    assert " ".join(order.notes) == (
        "Dates and odometer contradict each other: 160,000 km on 2026-05-01, 300 km on 2026-09-01; the dates decide, "
        "as after a change of the instrument cluster or a slip of the pen."
    )


def test_dates_that_fit_are_taken_as_they_are() -> None:
    results = drive(2026, 50_000.0, WORN, month=5) + drive(2026, 60_000.0, GOOD) + drive(2026, 60_005.0, GOOD, month=8)
    chronicle = chronicle_of(results, [fill(6, 50_100.0)], TODAY_NS)
    assert chronicle.results == tuple(results)
    assert not chronicle.doubts
    tomorrow_ns = TODAY_NS - 90 * 86_400 * 10**9
    assert not chronicle_of(drive(2026, 1.0, GOOD), (), tomorrow_ns).doubts  # a day ahead at most


def test_what_is_known_of_the_past_stands_in_the_order_of_the_odometer() -> None:
    results = drive(2029, 15_000.0, WORN) + drive(2026, 60_500.0, GOOD) + drive(2020, 61_000.0, GOOD)
    past = history_of(chronicle_of(results, (), TODAY_NS).results, (), 1)
    assert past.odometer_m.tolist() == [15e6, 60.5e6, 61e6]
