"""How a vehicle shifts: rows by kind and gears, changes with deviations that hold, words."""

from dataclasses import replace

import numpy as np
import pytest

from clutch_results.event_kinds import EventKind
from clutch_results.measures import CAPACITY, HEAT, PEAK_SLIP, SLIP_TIME
from clutch_results.records import Tier
from clutch_results.shifting import (
    ShiftingChange,
    seen_changes,
    shifting_of,
    shifting_record,
    shifting_words,
    unknown_friction_words,
)
from tests.support.shiftings import EVENT_NS, drives, scattered, told

DATED_NS = 1_770_000_000_000_000_000


def _change(summary_days: list[int], growth: float, seed: int, events: int = 8) -> ShiftingChange:
    results = scattered(np.random.default_rng(seed), summary_days, events, growth=growth)
    value = shifting_of(results).rows[0].value(SLIP_TIME)
    assert value is not None
    assert value.over_drives is not None
    return value.over_drives


def test_rows_are_by_kind_and_gears_and_what_is_not_measured_is_not_told() -> None:
    results = [
        told(1, DATED_NS, 1.0),
        told(2, DATED_NS + EVENT_NS, 1.2, capacity=(0.80, 0.06)),
        told(3, DATED_NS + 2 * EVENT_NS, None, kind=EventKind.COAST_DOWNSHIFT, to_gear=2),
        told(4, DATED_NS + 3 * EVENT_NS, 2.0, kind=EventKind.LAUNCH, to_gear=1, capacity=None),
    ]
    summary = shifting_of(results)
    assert [(row.name, row.event_count) for row in summary.rows] == [
        ("power on upshift 2-3", 2),
        ("coast downshift 1-2", 1),
        ("launch 0-1", 1),
    ]
    upshift, coast, launch = summary.rows
    slip, capacity = upshift.value(SLIP_TIME), upshift.value(CAPACITY)
    assert slip is not None
    assert slip.mean == pytest.approx(1.1)
    assert upshift.value(HEAT) is None
    assert coast.value(SLIP_TIME) is None
    assert launch.value(CAPACITY) is None
    assert capacity is not None
    # both events have an error of 0.06, though they differ by 0.04 alone: the rest is common to them and stays
    assert capacity.std is not None
    assert capacity.std > 0.05


def test_the_mean_of_two_events_is_held_by_the_scatter_of_the_other_kinds() -> None:
    """By two events alone two deviations would be nine of their distances; here 95 of 100 hold the truth as well."""
    held, widths = 0, []
    for seed in range(100):
        values = 1.0 + 0.1 * np.random.default_rng(seed).standard_normal(12)
        rare = [told(n + 1, DATED_NS + n * EVENT_NS, float(values[n]), to_gear=6) for n in range(2)]
        common = [told(n + 1, DATED_NS + n * EVENT_NS, float(2.0 * values[n])) for n in range(2, 12)]
        value = shifting_of([*rare, *common]).rows[1].value(SLIP_TIME)
        assert value is not None
        assert value.std is not None
        held += abs(value.mean - 1.0) <= 2.0 * value.std
        widths.append(value.std)
    assert 90 <= held <= 99
    assert float(np.median(widths)) < 0.15


def test_one_event_has_its_own_deviation_and_no_change() -> None:
    row = shifting_of([told(1, DATED_NS)]).rows[0]
    slip, capacity = row.value(SLIP_TIME), row.value(CAPACITY)
    assert slip is not None
    assert (slip.std, slip.over_drive, slip.over_drives) == (None, None, None)
    assert capacity is not None
    assert capacity.std == 0.06


def test_a_change_over_stored_drives_is_told_against_the_month_of_the_first() -> None:
    results = scattered(np.random.default_rng(5), [0, 1, 2, 90, 91, 92], 12, growth=0.18, among=0.01)
    words = shifting_words(shifting_of(results))
    assert "slip time of all events" in words
    assert "% longer than in March" in words
    assert unknown_friction_words(shifting_of(results)) == f"Friction: cannot be known from this car; {words}"


def test_no_change_is_said_with_how_large_one_might_be() -> None:
    results = scattered(np.random.default_rng(6), [0, 1, 2, 3], 8)
    assert "no change seen since 4 March (slip time ± " in shifting_words(shifting_of(results))
    assert shifting_words(shifting_of(results[:3])).endswith("too few events of a kind to tell a change")
    assert shifting_words(shifting_of([])) == "shifting: no event was seen"


@pytest.mark.parametrize("days", [[0, 60], [0, 20, 40, 60]])  # of two drives nobody knows how much drives differ
@pytest.mark.parametrize("growth", [0.0, 0.18])
def test_two_deviations_hold_the_change_of_95_of_100_vehicles(days: list[int], growth: float) -> None:
    changes = [_change(days, growth, seed) for seed in range(80)]
    held = sum(abs(change.change - 0.9 * growth) <= 2.0 * change.std_change for change in changes)
    assert held >= 0.92 * len(changes)
    assert held < len(changes) or len(days) == 2
    ratios = [
        abs((change.change_ratio or 0.0) - growth) <= 2.0 * (change.std_change_ratio or 0.0) for change in changes
    ]
    assert 0.92 * len(changes) <= sum(ratios) <= 0.995 * len(changes)


def test_many_events_of_two_drives_are_no_proof_that_the_vehicle_changed() -> None:
    """Drives of the same vehicle differ: without that two drives of 100 events would differ in four of five cases."""
    changes = [_change([0, 1], 0.0, seed, events=100) for seed in range(25)]
    assert sum(change.is_seen for change in changes) <= 4


def test_of_many_changes_that_are_looked_at_few_are_seen_by_chance() -> None:
    kinds = [EventKind.POWER_ON_UPSHIFT, EventKind.COAST_DOWNSHIFT, EventKind.LAUNCH]
    seen = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        results = [
            told(
                number + 1,
                DATED_NS + number * EVENT_NS,
                float(1.0 + 0.1 * rng.standard_normal()),
                kind=kinds[number % 3],
                to_gear=1 + number % 5,
                peak_slip_rad_s=float(100.0 + 10.0 * rng.standard_normal()),
                capacity=(float(0.84 + 0.05 * rng.standard_normal()), 0.05),
            )
            for number in range(90)
        ]
        seen += bool(seen_changes(shifting_of(results)))
    assert seen <= 4


def test_like_is_compared_with_like() -> None:
    """A driver who shifts at higher speed later makes longer slips of the same clutch."""
    rng = np.random.default_rng(3)
    results = [
        told(
            number + 1,
            DATED_NS + (number // 10) * 86_400 * 10**9 + number % 10 * EVENT_NS,
            float(0.01 * speed * (1.0 + 0.03 * rng.standard_normal())),
            stream=f"s{number // 10}",
            peak_slip_rad_s=float(speed),
        )
        for number, speed in enumerate(np.concatenate([rng.normal(90.0, 10.0, 30), rng.normal(120.0, 10.0, 30)]))
    ]
    value = shifting_of(results).rows[0].value(SLIP_TIME)
    assert value is not None
    assert value.over_drives is not None
    assert value.over_drives.adjusted_for == ("speed to bridge",)
    assert not value.over_drives.is_seen
    blind = [
        replace(r, estimate=replace(r.estimate, indices=replace(r.estimate.indices, peak_slip_rad_s=None)))
        for r in results
        if r.estimate.indices is not None
    ]
    unlike = shifting_of(blind).rows[0].value(SLIP_TIME)
    assert unlike is not None
    assert unlike.over_drives is not None
    assert unlike.over_drives.is_seen


def test_a_drive_ends_by_a_pause_of_an_hour_or_with_a_log_that_has_no_date() -> None:
    live = [told(n, DATED_NS + n * 50 * 60 * 10**9) for n in range(1, 4)]
    assert shifting_of(live).drive_count == 1
    assert shifting_of([*live, told(9, live[-1].estimate.end_ns + 3_700 * 10**9)]).drive_count == 2
    undated = [told(n, n * EVENT_NS, stream=stream) for stream in ("a", "b", "c") for n in (1, 2)]
    assert shifting_of(undated).drive_count == 3
    logs = [told(n, DATED_NS + n * EVENT_NS, stream=f"log {n}") for n in range(1, 4)]  # each goes on in the next
    assert shifting_of(logs).drive_count == 1
    same_clock = [told(n, DATED_NS + n * EVENT_NS, stream=stream) for stream in ("a", "b") for n in (1, 2)]
    assert shifting_of(same_clock).drive_count == 2


def test_stored_drives_in_any_order_say_the_same() -> None:
    results = scattered(np.random.default_rng(8), [0, 40, 80], 6, growth=0.3)
    by_drive = [results[0:6], results[6:12], results[12:18]]
    turned = [result for drive in reversed(by_drive) for result in drive]
    assert shifting_record(shifting_of(turned)) == shifting_record(shifting_of(results))


def test_a_measure_that_stands_still_has_no_change_and_no_fault() -> None:
    summary = shifting_of(drives([0, 1, 2], 6, lambda _day, _event: 0.96))
    value = summary.rows[0].value(SLIP_TIME)
    assert value is not None
    assert value.over_drives is not None
    assert not value.over_drives.is_seen
    assert summary.rows[0].value(PEAK_SLIP) is not None


def test_the_words_name_what_the_tier_tells() -> None:
    torque = shifting_words(shifting_of([told(1, DATED_NS)]))
    assert "torque capacity 0.84 ± 0.12" in torque
    kinematic = shifting_words(shifting_of([told(1, DATED_NS, capacity=None, tier=Tier.KINEMATIC)]))
    assert "shift time 1.30 s" in kinematic
    assert "capacity" not in kinematic
