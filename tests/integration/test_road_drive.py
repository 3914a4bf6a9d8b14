"""Drives on the road, from trips to frames and truth."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.drive.recording import Drive, DriveStretch
from ecu_emulator.driving.journey import PlannedTrip
from ecu_emulator.scenario.scenario import Ambient
from ecu_emulator.truth import EventTruth, ShiftTruth, TripTruth
from tests.support.road import road_scenario, short_trip

PARKED_S = 600.0
TRIP_S = short_trip().trace.duration_s
COLD = Ambient(temperature_k=273.15, oil_temperature_k=293.15, coolant_temperature_k=303.15)


def two_trips() -> Iterator[PlannedTrip]:
    return iter([short_trip("there"), short_trip("back", PARKED_S)])


@pytest.fixture(name="stretches", scope="module")
def _stretches() -> list[DriveStretch]:
    drive = Drive(replace(road_scenario("ideal"), ambient=COLD), planned=two_trips())
    return list(drive.stretches(10.0))


@pytest.fixture(name="frames", scope="module")
def _frames(stretches: list[DriveStretch]) -> EncodedFrames:
    return merge([stretch.frames for stretch in stretches])


def test_every_event_is_told_with_its_trip(stretches: list[DriveStretch]) -> None:
    truths = [truth for stretch in stretches for truth in stretch.truths]
    events = [truth for truth in truths if isinstance(truth, EventTruth)]
    assert [event.number for event in events] == list(range(1, len(events) + 1))
    launches = [event for event in events if event.event == "launch"]
    assert len(launches) == 2
    for launch in launches:
        assert (launch.clutch, launch.is_locked, launch.is_aborted) == (1, True, False)
        assert 1000.0 < launch.slip_energy_j < 50_000.0
        assert 40.0 < launch.peak_slip_rad_s < 300.0
        assert launch.clutch_end_temperature_k > launch.clutch_temperature_k
    assert sum(event.event == "power_on_upshift" for event in events) >= 4
    upshifts = [truth for truth in truths if isinstance(truth, ShiftTruth) and truth.to_gear > truth.from_gear]
    assert len(upshifts) >= 4


def test_a_parked_car_is_silent_and_cools_down(stretches: list[DriveStretch], frames: EncodedFrames) -> None:
    there, back = (truth for stretch in stretches for truth in stretch.truths if isinstance(truth, TripTruth))
    assert (there.number, there.trace, there.t_start_s, there.parked_s) == (1, "there", 0.0, 0.0)
    assert (back.number, back.trace, back.parked_s) == (2, "back", PARKED_S)
    assert back.t_start_s == pytest.approx(TRIP_S + PARKED_S, abs=0.01)
    assert (there.oil_temperature_k, there.coolant_temperature_k) == (293.15, 303.15)
    assert 273.15 < back.coolant_temperature_k < 306.0
    gap = np.flatnonzero(np.diff(frames.t_s) > 1.0)
    assert len(gap) == 1
    assert frames.t_s[gap[0] + 1] >= back.t_start_s > frames.t_s[gap[0]] + PARKED_S - 0.1


def test_the_cutting_changes_nothing(frames: EncodedFrames, stretches: list[DriveStretch]) -> None:
    drive = Drive(replace(road_scenario("ideal"), ambient=COLD), planned=two_trips())
    again = list(drive.stretches(0.777))
    other = merge([stretch.frames for stretch in again])
    np.testing.assert_array_equal(other.t_s, frames.t_s)
    np.testing.assert_array_equal(other.data, frames.data)
    kinds = [[type(truth) for stretch in some for truth in stretch.truths] for some in (again, stretches)]
    assert kinds[0] == kinds[1]
    assert drive.totals.driven_s == pytest.approx(2.0 * TRIP_S, abs=0.01)
    assert drive.totals.events == sum(kind is EventTruth for kind in kinds[0])
