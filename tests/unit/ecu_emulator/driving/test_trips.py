"""Traces, trips and the driver that keeps to them."""

from functools import cache

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.journey import (
    COOLANT_PARKED_TIME_CONSTANT_S,
    DAY_TRIPS,
    OIL_PARKED_TIME_CONSTANT_S,
    PARKED_S,
    DriveConditions,
    PlannedTrip,
    Trip,
    cooled_k,
    trips,
)
from ecu_emulator.driving.laws import nominal_driving
from ecu_emulator.driving.traffic import SpeedTrace, public_trace
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario import DriveName
from tests.support.power_balance import power_balance
from tests.support.tolerance import share_within_tolerance
from tests.unit.ecu_emulator.driving.drives import trace, trip

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


PUBLISHED = [  # duration [s], distance [m], highest speed [km/h], time at rest [s]
    pytest.param("wltc", 1800.0, 23_266.0, 131.3, 226, id="wltc"),  # UN GTR 15, Annex 1
    pytest.param("udds", 1369.0, 11_990.0, 91.25, 241, id="udds"),  # US EPA: 7.45 miles, 56.7 mph
    pytest.param("hwfet", 765.0, 16_507.0, 96.4, 5, id="hwfet"),  # US EPA: 10.26 miles, 59.9 mph
    pytest.param("us06", 600.0, 12_888.0, 129.23, 40, id="us06"),  # US EPA: 8.01 miles, 80.3 mph
]


@pytest.mark.parametrize(("name", "duration_s", "distance_m", "top_km_h", "rest_s"), PUBLISHED)
def test_length_distance_and_speed(
    name: str, duration_s: float, distance_m: float, top_km_h: float, rest_s: int
) -> None:
    trace = public_trace(name)
    np.testing.assert_array_equal(trace.t_s, np.arange(duration_s + 1.0))
    assert np.trapezoid(trace.speed_m_s, trace.t_s) == pytest.approx(distance_m, abs=1.0)
    assert trace.speed_m_s.max() * 3.6 == pytest.approx(top_km_h, abs=0.01)
    assert trace.speed_m_s[0] == trace.speed_m_s[-1] == 0.0
    assert np.count_nonzero(trace.speed_m_s == 0.0) == pytest.approx(rest_s, abs=25)
    assert np.all(trace.speed_m_s >= 0.0)
    assert not np.any(trace.grade_ratio)


STOP_AND_GO = trace((0, 0), (2, 0), (8, 9), (11, 9), (15, 0), (20, 0), (26, 8), (30, 8))


@pytest.fixture(scope="module")
def audited() -> tuple[Trip, FloatArray]:
    """Return an audited trip at its end, and all its rows."""
    whole = trip(STOP_AND_GO, whim_ratio=0.5, is_audited=True)
    return whole, whole.advance(STOP_AND_GO.duration_s)


def share(road: SpeedTrace, rows: FloatArray) -> float:
    return share_within_tolerance(road, rows[:, Col.T_S], rows[:, Col.VEHICLE_SPEED])


def test_the_car_keeps_to_its_trace_warm_and_cold(
    town_trace: SpeedTrace, town: FloatArray, cold_town: FloatArray
) -> None:
    assert share(town_trace, town) > 0.995
    assert share(town_trace, cold_town) > 0.995


def test_no_energy_appears_or_gets_lost(audited: tuple[Trip, FloatArray]) -> None:
    whole, _ = audited
    balance = power_balance(whole)
    assert abs(balance.residual_ratio) < 1.0e-6
    assert abs(balance.heat_residual_ratio) < 1.0e-6
    assert balance.clutch_j > 5.0e3
    assert balance.brake_j > 4.0e4


DRIVING = nominal_driving()


def test_feet_move_no_faster_than_feet_and_never_press_both(town: FloatArray, sport: FloatArray) -> None:
    for rows in (town, sport):
        pedal, brake_m_s2 = rows[:, Col.PEDAL], rows[:, Col.BRAKE]
        assert np.abs(np.diff(pedal)).max() * 1000.0 <= DRIVING.driver.pedal_release_per_s + 1.0e-6
        assert np.abs(np.diff(brake_m_s2)).max() * 1000.0 <= DRIVING.driver.brake_press_m_s3 + 1.0e-6
        assert not ((pedal > 0.0) & (brake_m_s2 > 0.0)).any()
        assert pedal.min() >= 0.0
        assert pedal.max() <= 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"oil_k": 100.0}, "oil_k"),
        ({"coolant_k": float("nan")}, "coolant_k"),
        ({"dt_s": 3.0e-4}, "dt_s"),
        ({"dt_s": 1.7e-4}, "divide 1 ms"),
        ({"whim_ratio": 1.5}, "whim_ratio"),
    ],
)
def test_conditions_outside_their_ranges_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(EmulatorConfigError, match=message):
        DriveConditions(**changes)  # type: ignore[arg-type]  # all of them are numbers
