"""Trip after trip as one stream of plant rows: warm parts cool down while the car is parked, clocks go on."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.driving.trips import (
    COOLANT_PARKED_TIME_CONSTANT_S,
    OIL_PARKED_TIME_CONSTANT_S,
    PlannedTrip,
    cooled_k,
)
from ecu_emulator.plant.columns import Col

MS_PER_S: Final = 1000.0


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


class MovingCar(Protocol):
    """A car on one trip; its rows count time and way from the beginning of the trip."""

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control take these for its clutches' touch points."""

    @property
    def finished(self) -> bool:
        """Whether the trip is over."""

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, one per millisecond; fewer than asked for where the trip ends."""


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
        depart: Callable[[Departure], MovingCar],
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
        self._car: MovingCar | None = None  # None: parked
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

    def _set_off(self, trip: PlannedTrip) -> MovingCar:
        self._clock_ms += round(min(trip.parked_s, self._longest_stay_s) * MS_PER_S)
        self.departure = Departure(
            number=1 if self.departure is None else self.departure.number + 1,
            trip=trip,
            t_start_s=self._clock_ms / MS_PER_S,
            warmth=Warmth(
                oil_k=cooled_k(self._warmth.oil_k, self._ambient_k, trip.parked_s, OIL_PARKED_TIME_CONSTANT_S),
                coolant_k=cooled_k(
                    self._warmth.coolant_k, self._ambient_k, trip.parked_s, COOLANT_PARKED_TIME_CONSTANT_S
                ),
            ),
        )
        return self._depart(self.departure)
