"""Trips, one after the other, and what becomes of a car that is parked in between."""

from functools import cache

import numpy as np
import pytest

from ecu_emulator.driving.journey import (
    COOLANT_PARKED_TIME_CONSTANT_S,
    DAY_TRIPS,
    OIL_PARKED_TIME_CONSTANT_S,
    PARKED_S,
    PlannedTrip,
    cooled_k,
    trips,
)
from ecu_emulator.scenario.drive_names import DriveName

CYCLES = [DriveName.WLTC, DriveName.UDDS, DriveName.HWFET, DriveName.US06]


@cache
def day(seed: int) -> tuple[PlannedTrip, ...]:
    return tuple(trips(DriveName.DAY, seed))


def same(one: PlannedTrip, other: PlannedTrip) -> bool:
    return one.parked_s == other.parked_s and np.array_equal(one.trace.speed_m_s, other.trace.speed_m_s)


@pytest.mark.parametrize("name", CYCLES)
def test_a_public_cycle_is_one_trip_whatever_the_seed(name: DriveName) -> None:
    (trip,) = trips(name, 1)
    (other,) = trips(name, 2)
    assert trip.trace.name == name
    assert same(trip, other)


def test_a_day_has_several_trips_with_the_car_parked_in_between() -> None:
    for seed in range(8):
        assert DAY_TRIPS[0] <= len(day(seed)) <= DAY_TRIPS[1]
        assert day(seed)[0].parked_s == 0.0
        assert all(PARKED_S[0] <= trip.parked_s <= PARKED_S[1] for trip in day(seed)[1:])
    kinds = {trip.trace.name for seed in range(8) for trip in day(seed)}
    assert kinds == {"city", "mixed", "motorway"}


def test_a_parked_car_cools_down_to_the_air() -> None:
    warm_k, air_k = 363.15, 263.15
    assert cooled_k(warm_k, air_k, 0.0, OIL_PARKED_TIME_CONSTANT_S) == warm_k
    after_time_constant_k = cooled_k(warm_k, air_k, OIL_PARKED_TIME_CONSTANT_S, OIL_PARKED_TIME_CONSTANT_S)
    assert after_time_constant_k == pytest.approx(air_k + 100.0 / np.e)
    assert cooled_k(warm_k, air_k, 10.0 * 86_400.0, COOLANT_PARKED_TIME_CONSTANT_S) == pytest.approx(air_k)
