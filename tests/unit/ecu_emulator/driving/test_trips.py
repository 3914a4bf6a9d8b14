"""Trips, one after the other, and what becomes of a car that is parked in between."""

from functools import cache
from itertools import islice, pairwise

import numpy as np
import pytest

from ecu_emulator.driving.journey import (
    COOLANT_PARKED_TIME_CONSTANT_S,
    DAY_TRIPS,
    NIGHT_S,
    OIL_PARKED_TIME_CONSTANT_S,
    PARKED_S,
    PlannedTrip,
    cooled_k,
    trips,
)
from ecu_emulator.errors import ConfigError
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


@pytest.mark.parametrize("name", [*CYCLES, DriveName.CITY])
def test_an_endless_drive_goes_on_without_being_parked(name: DriveName) -> None:
    endless = list(islice(trips(name, 1, rounds=None), 3))
    assert len(endless) == 3
    assert all(trip.parked_s == 0.0 for trip in endless)
    (first,) = trips(name, 1)
    assert same(first, endless[0])


def test_city_trips_differ_from_each_other_and_from_seed_to_seed() -> None:
    first, second = islice(trips(DriveName.CITY, 1, rounds=None), 2)
    (other,) = trips(DriveName.CITY, 2)
    assert not same(first, second)
    assert not same(first, other)


def test_a_day_has_several_trips_with_the_car_parked_in_between() -> None:
    for seed in range(8):
        assert DAY_TRIPS[0] <= len(day(seed)) <= DAY_TRIPS[1]
        assert day(seed)[0].parked_s == 0.0
        assert all(PARKED_S[0] <= trip.parked_s <= PARKED_S[1] for trip in day(seed)[1:])
    kinds = {trip.trace.name for seed in range(8) for trip in day(seed)}
    assert kinds == {"city", "mixed", "motorway"}


def test_the_same_seed_is_the_same_day_and_its_first_trips_those_of_an_endless_drive() -> None:
    assert all(map(same, day(7), trips(DriveName.DAY, 7, rounds=None)))
    assert not all(map(same, day(7), day(6)))


def test_a_night_lies_between_two_days() -> None:
    first_day = len(day(3))
    endless = list(islice(trips(DriveName.DAY, 3, rounds=None), first_day + 3))
    assert NIGHT_S[0] <= endless[first_day].parked_s <= NIGHT_S[1]
    assert not any(same(one, other) for one, other in pairwise(endless))


def test_a_parked_car_cools_down_to_the_air() -> None:
    warm_k, air_k = 363.15, 263.15
    assert cooled_k(warm_k, air_k, 0.0, OIL_PARKED_TIME_CONSTANT_S) == warm_k
    after_time_constant_k = cooled_k(warm_k, air_k, OIL_PARKED_TIME_CONSTANT_S, OIL_PARKED_TIME_CONSTANT_S)
    assert after_time_constant_k == pytest.approx(air_k + 100.0 / np.e)
    assert cooled_k(warm_k, air_k, 10.0 * 86_400.0, COOLANT_PARKED_TIME_CONSTANT_S) == pytest.approx(air_k)


def test_a_cold_car_warms_up_in_warm_air() -> None:
    assert 253.15 < cooled_k(253.15, 293.15, 3600.0, OIL_PARKED_TIME_CONSTANT_S) < 293.15


def test_parking_twice_is_parking_once_for_longer() -> None:
    once_k = cooled_k(363.15, 283.15, 5000.0, OIL_PARKED_TIME_CONSTANT_S)
    first_k = cooled_k(363.15, 283.15, 2000.0, OIL_PARKED_TIME_CONSTANT_S)
    assert cooled_k(first_k, 283.15, 3000.0, OIL_PARKED_TIME_CONSTANT_S) == pytest.approx(once_k)


@pytest.mark.parametrize("name", [*CYCLES, DriveName.CITY])
def test_a_drive_is_driven_as_often_as_asked_for(name: DriveName) -> None:
    assert len(list(trips(name, 1, rounds=3))) == 3


def test_two_days_are_a_day_and_another_one() -> None:
    days = list(trips(DriveName.DAY, 5, rounds=2))
    assert sum(trip.parked_s >= NIGHT_S[0] for trip in days) == 1
    assert all(map(same, day(5), days))


def test_the_shift_cycle_is_no_drive_on_the_road() -> None:
    with pytest.raises(ConfigError, match="no speed trace 'cycle'"):
        next(trips(DriveName.CYCLE, 1))
