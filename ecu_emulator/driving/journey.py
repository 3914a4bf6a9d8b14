"""What is driven, trip after trip, as one stream of plant rows: warm parts cool down while parked, clocks go on."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.driving.traffic import CITY, MIXED, MOTORWAY, Range, SpeedTrace, Traffic, public_trace, traffic_trace
from ecu_emulator.driving.trip import Trip
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.faults import generator

CITY_TRIP_S: Final = 1200.0
CITY_GRADE_RATIO: Final = 0.02  # the steepest place
NIGHT_S: Range = (8.0 * 3600.0, 11.0 * 3600.0)
PARKED_S: Range = (300.0, 4.0 * 3600.0)  # between two trips of a day
DAY_TRIPS: Final = (4, 7)
DAY_GRADE_RATIO: Range = (0.0, 0.04)
# Assumed: half of what oil and coolant are warmer than the air is gone after two hours, the sealed engine bay included.
OIL_PARKED_TIME_CONSTANT_S: Final = 9_000.0
COOLANT_PARKED_TIME_CONSTANT_S: Final = 10_000.0
COLDEST_PARKED_K: Final = 258.15  # colder oil lets no gear in: in a harder winter the car is kept under a roof
MS_PER_S: Final = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedTrip:
    """One trip from rest to rest."""

    trace: SpeedTrace
    parked_s: float  # engine off, since the trip before


@dataclass(frozen=True, slots=True, kw_only=True)
class _DayTrip:
    traffic: Traffic
    duration_s: Range


_DAY: Final[Mapping[_DayTrip, float]] = MappingProxyType({  # and how often each of them is driven
    _DayTrip(traffic=CITY, duration_s=(300.0, 1500.0)): 0.5,
    _DayTrip(traffic=MIXED, duration_s=(600.0, 2400.0)): 0.3,
    _DayTrip(traffic=MOTORWAY, duration_s=(1200.0, 3600.0)): 0.2,
})  # fmt: skip


def trips(name: DriveName, seed: int, rounds: int | None = 1) -> Iterator[PlannedTrip]:
    """Yield the trips of a drive on the road; the first ones are the same however many there are.

    Raises ConfigError if the drive is none on the road.

    Parameters
    ----------
    seed : int
        Of traffic and stays; the public cycles are always the same.
    rounds : int
        How many cycles, trips through the city or days; None: without end.
    """
    for number in count() if rounds is None else range(rounds):
        if name == DriveName.DAY:
            yield from _day(seed, number)
        elif name == DriveName.CITY:
            rng = generator(seed, f"city {number}")
            yield PlannedTrip(trace=traffic_trace(CITY, CITY_TRIP_S, rng, grade_ratio=CITY_GRADE_RATIO), parked_s=0.0)
        else:
            yield PlannedTrip(trace=public_trace(name), parked_s=0.0)


def cooled_k(warm_k: float, ambient_k: float, parked_s: float, time_constant_s: float) -> float:
    """Return the temperature [K] after a car has stood for some time: it approaches that of the air."""
    return ambient_k + (warm_k - ambient_k) * math.exp(-parked_s / time_constant_s)


def _day(seed: int, number: int) -> Iterator[PlannedTrip]:
    """Yield the trips of one day; the first day begins with the first trip, all others with a night."""
    rng = generator(seed, f"day {number}")
    kinds, shares = list(_DAY), list(_DAY.values())
    for index in range(int(rng.integers(DAY_TRIPS[0], DAY_TRIPS[1], endpoint=True))):
        kind = kinds[int(rng.choice(len(kinds), p=shares))]
        parked_s = math.exp(rng.uniform(*np.log(PARKED_S))) if index else float(number > 0) * rng.uniform(*NIGHT_S)
        trace = traffic_trace(
            kind.traffic, rng.uniform(*kind.duration_s), rng, grade_ratio=rng.uniform(*DAY_GRADE_RATIO)
        )
        yield PlannedTrip(trace=trace, parked_s=parked_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Warmth:
    """How warm the car is when a trip begins; the clutches are as warm as the oil."""

    oil_k: float
    coolant_k: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Departure:
    """One trip that begins."""

    number: int  # 1, 2, ... within the journey
    trip: PlannedTrip
    t_start_s: float  # scenario time
    warmth: Warmth


class Journey:
    """Drives trips one after the other.

    Parameters
    ----------
    trips
        What to drive; may be endless.
    depart
        Sets a car in motion on a trip.
    warmth
        At the beginning of the first trip.
    ambient_k
        Towards which a parked car cools down, or warms up.
    longest_stay_s
        Of a longer stay only this much [s] counts in the scenario's time; the car cools down for all of it.
    """

    def __init__(
        self,
        trips: Iterator[PlannedTrip],
        depart: Callable[[Departure], Trip],
        warmth: Warmth,
        ambient_k: float,
        longest_stay_s: float,
    ) -> None:
        self._trips = trips
        self._depart = depart
        self._warmth = warmth
        self._ambient_k = ambient_k
        self._longest_stay_s = longest_stay_s
        self._next_trip = next(trips, None)
        self._car: Trip | None = None  # None: parked
        self._clock_ms = 0  # scenario time of the next row, time to come in which the car is parked left out
        self._past_m = 0.0  # way of the trips before
        self.departure: Departure | None = None

    @property
    def is_parked(self) -> bool:
        """Whether the rows to come belong to another trip."""
        return self._car is None

    @property
    def finished(self) -> bool:
        """Whether the last trip is over."""
        return self.is_parked and self._next_trip is None

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control of a car that drives take these for its clutches' touch points."""
        if self._car is not None:
            self._car.believe(touch_pressures_pa)

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, shape (n, len(Col)); fewer than asked for where a trip ends.

        They belong to one trip, that of ``departure``.
        """
        if self._car is None:
            if self._next_trip is None:
                return np.empty((0, len(Col)))
            self._car = self._set_off(self._next_trip)
        rows = self._car.advance(duration_s)
        rows[:, Col.T_S] = (self._clock_ms + np.arange(len(rows))) / MS_PER_S
        rows[:, Col.DISTANCE] += self._past_m
        self._clock_ms += len(rows)
        if len(rows):
            last = rows[-1]
            self._warmth = Warmth(
                oil_k=float(last[Col.SUMP_TEMPERATURE]), coolant_k=float(last[Col.COOLANT_TEMPERATURE])
            )
        if self._car.finished:
            self._past_m = float(rows[-1, Col.DISTANCE]) if len(rows) else self._past_m
            self._car = None
            self._next_trip = next(self._trips, None)
        return rows

    def _set_off(self, trip: PlannedTrip) -> Trip:
        self._clock_ms += round(min(trip.parked_s, self._longest_stay_s) * MS_PER_S)
        least_k = COLDEST_PARKED_K if trip.parked_s > 0.0 else 0.0
        oil_k = cooled_k(self._warmth.oil_k, self._ambient_k, trip.parked_s, OIL_PARKED_TIME_CONSTANT_S)
        coolant_k = cooled_k(self._warmth.coolant_k, self._ambient_k, trip.parked_s, COOLANT_PARKED_TIME_CONSTANT_S)
        self.departure = Departure(
            number=1 if self.departure is None else self.departure.number + 1,
            trip=trip,
            t_start_s=self._clock_ms / MS_PER_S,
            warmth=Warmth(oil_k=max(oil_k, least_k), coolant_k=max(coolant_k, least_k)),
        )
        return self._depart(self.departure)
