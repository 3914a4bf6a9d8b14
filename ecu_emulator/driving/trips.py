"""What is driven, trip after trip: a public cycle, city traffic, or whole days with the car parked in between."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from types import MappingProxyType
from typing import Final

import numpy as np

from ecu_emulator.driving.public_traces import public_trace
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.driving.traffic import CITY, MIXED, MOTORWAY, Range, Traffic, traffic_trace
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.signals import generator

CITY_TRIP_S: Final = 1200.0
CITY_GRADE_RATIO: Final = 0.02  # the steepest place
NIGHT_S: Range = (8.0 * 3600.0, 11.0 * 3600.0)
PARKED_S: Range = (300.0, 4.0 * 3600.0)  # between two trips of a day
DAY_TRIPS: Final = (4, 7)
DAY_GRADE_RATIO: Range = (0.0, 0.04)
# Assumed: half of what oil and coolant are warmer than the air is gone after two hours, the sealed engine bay included.
OIL_PARKED_TIME_CONSTANT_S: Final = 9_000.0
COOLANT_PARKED_TIME_CONSTANT_S: Final = 10_000.0


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

    Parameters
    ----------
    seed : int
        Of traffic and stays; the public cycles are always the same.
    rounds : int
        How many cycles, trips through the city or days; None: without end.

    Raises
    ------
    ConfigError
        If the drive is none on the road.
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
