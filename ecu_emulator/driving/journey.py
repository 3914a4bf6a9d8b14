"""A drive on the road: trips, in each of which a car follows a speed trace, one after the other as one stream of rows.

Warm parts cool down while the car is parked; clocks go on.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, field, replace
from itertools import count
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, nominal_calibration
from ecu_emulator.driving import indices
from ecu_emulator.driving.indices import DrivelineState
from ecu_emulator.driving.laws import DrivingLaw, DrivingParameters, idle_rad_s, nominal_driving
from ecu_emulator.driving.loop import GRID_S, Road, follow, run
from ecu_emulator.driving.traffic import CITY, MIXED, MOTORWAY, Range, SpeedTrace, Traffic, public_trace, traffic_trace
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.plant import state as at
from ecu_emulator.plant.course import (
    ROWS_PER_S,
    DriveSettings,
    FrictionFactors,
    MachineCourse,
    as_record,
    check_step,
    idle_machine,
)
from ecu_emulator.plant.driveline import ENGAGED, GRAVITY_M_S2, NEUTRAL
from ecu_emulator.plant.integration import Machine
from ecu_emulator.plant.loop import COLUMN_COUNT
from ecu_emulator.plant.parameters import PlantParameters, nominal_parameters
from ecu_emulator.plant.powertrain import drive_law
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.faults import CheckedRecord, generator, ranged
from ecu_emulator.shift_control import tcu_data

_WHIM_COUNT = 1021  # prime: no pattern of events meets the same whims again and again
_LONGEST_WHIM_DELAY_S = 0.7
_LONGEST_IN_GEAR_DELAY_S = 5.0
_WHIM_LENGTH_S = (0.25, 0.6)
_DEEPER_PEDAL = (0.15, 0.6)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveConditions(CheckedRecord):
    """Temperatures as the drive begins, and how the driver behaves.

    Raises
    ------
    ConfigError
        On construction, naming the first number outside its range.
    """

    oil_k: float = ranged(363.15, 258.15, 403.15)
    coolant_k: float = ranged(358.15, 243.15, 393.15)
    ambient_k: float = ranged(298.15, 233.15, 328.15)
    friction_factors: FrictionFactors = field(default_factory=FrictionFactors)
    dt_s: float = ranged(2.5e-4, 1.0e-6, 2.5e-4)  # a whole fraction of a millisecond
    whim_ratio: float = ranged(0.1, 0.0, 1.0)  # share of the events in which the driver's foot moves without need

    def __post_init__(self) -> None:
        CheckedRecord.__post_init__(self)
        steps = 1.0 / (ROWS_PER_S * self.dt_s)
        if abs(steps - round(steps)) > 1.0e-6 * steps:
            raise EmulatorConfigError(f"dt_s must divide 1 ms, got {self.dt_s}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Car:
    """One car: its true clutches, what is around them, how it is controlled."""

    truth: Calibration = field(default_factory=nominal_calibration)
    parameters: PlantParameters = field(default_factory=nominal_parameters)
    driving: DrivingParameters = field(default_factory=nominal_driving)
    touch_pressures_pa: tuple[float, float] | None = None  # that the control believes in; None: the true ones


class Trip(MachineCourse):
    """A car on its way along a trace.

    Deterministic: the same arguments and the same state of ``rng`` give the same rows to the last bit, however
    `advance` is called.

    Parameters
    ----------
    car : Car
        What is driven.
    trace : SpeedTrace
        What the driver follows.
    conditions : DriveConditions
        Temperatures, habits.
    rng : np.random.Generator
        Of the driver's whims; read once.

    Raises
    ------
    CalibrationError
        If the step is too long for the car.
    """

    def __init__(self, car: Car, trace: SpeedTrace, conditions: DriveConditions, rng: np.random.Generator) -> None:
        self._car, self._conditions = car, conditions
        law = driving_law(car, conditions)
        check_step(conditions.dt_s, law.drive.plant, law.drive.overall_ratios, starts_in_neutral=True)
        self._law = as_record(law)
        self._road = _road(trace, conditions, rng)
        super().__init__(self._law.drive, car.touch_pressures_pa)
        self._machine = _initial_machine(self._law, conditions)

    def become(self, truth: Calibration, parameters: PlantParameters) -> None:
        """Go on from the next row with other clutches or surroundings, of which the control does not know."""
        self._law = as_record(driving_law(replace(self._car, truth=truth, parameters=parameters), self._conditions))
        self._obey(self._law.drive)

    def end(self) -> None:
        """End with the next row."""
        self._road.end[0] = min(self._road.end[0], self._machine.clock[0] + 1)

    def request_gear(self, gear: int) -> None:
        """Ask for a gear, which is engaged step by step as far as its engine speed allows."""
        self._machine.memory[indices.REQUESTED_GEAR] = gear

    @property
    def finished(self) -> bool:
        """Whether the end of the trace is reached."""
        return bool(self._machine.clock[0] >= self._road.end[0])

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, shape (n, len(Col)); fewer at the end of the trace, none after it."""
        rows = np.empty((round(duration_s * ROWS_PER_S), COLUMN_COUNT))
        return rows[: run(self._machine, self._road, self._law, rows)]


@dataclass(slots=True)
class Steering:
    """What somebody outside gives a car, until it is changed."""

    speed_m_s: float = 0.0  # reached at the end of the rows to come
    pedal_ratio: float = 0.0


class SteeredTrip(Trip):
    """A car that moves as fast as somebody outside says, as on rollers, without an end; other arguments as of `Trip`.

    A car that is slowed down with a released pedal is braked, and so is one that is kept at rest.
    """

    def __init__(
        self, steering: Steering, car: Car, trace: SpeedTrace, conditions: DriveConditions, rng: np.random.Generator
    ) -> None:
        super().__init__(car, trace, conditions, rng)
        self._steering = steering
        vehicle = self._law.drive.plant.vehicle
        grip_ratio = vehicle.tyre_friction_ratio * vehicle.driven_load_ratio / vehicle.driven_brake_ratio
        self._most_brake_m_s2 = GRIP_USED_RATIO * grip_ratio * GRAVITY_M_S2
        self._road.end[0] = np.iinfo(np.int64).max

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, shape (n, len(Col))."""
        rows = np.empty((round(duration_s * ROWS_PER_S), COLUMN_COUNT))
        if self.finished:
            return rows[:0]
        before_m_s, steering = float(self._machine.y[at.V]), self._steering
        slowing_m_s2 = (before_m_s - steering.speed_m_s) / duration_s
        standing_m_s2 = self._law.driving.driver.standing_brake_m_s2 if steering.speed_m_s == 0.0 else 0.0
        is_braked = steering.pedal_ratio == 0.0 and slowing_m_s2 > LEAST_BRAKE_M_S2
        braked_m_s2 = min(slowing_m_s2, self._most_brake_m_s2)  # a wall does the rest
        brake_m_s2 = braked_m_s2 if is_braked else standing_m_s2 * (steering.pedal_ratio == 0.0)
        speeds_m_s = np.linspace(before_m_s, steering.speed_m_s, len(rows) + 1)[1:]
        follow(self._machine, self._road, self._law, rows, speeds_m_s, (steering.pedal_ratio, float(brake_m_s2)))
        return rows


GRIP_USED_RATIO: Final = 0.9  # of what the driven tyres hold: a controller keeps them from locking
LEAST_BRAKE_M_S2: Final = 0.5  # what drag and the engine slow a car down by without its brakes
STEERED: Final = SpeedTrace(name="steered", t_s=np.array([0.0, 1.0]), speed_m_s=np.zeros(2), grade_ratio=np.zeros(2))


def driving_law(car: Car, conditions: DriveConditions) -> DrivingLaw:
    """Return everything constant over a trip, in the form the kernels take after `as_record`."""
    around = car.driving.surroundings
    base = drive_law(car.truth, car.parameters, DriveSettings(dt_s=conditions.dt_s))
    plant = base.plant._replace(
        synchroniser=base.plant.synchroniser._replace(lock_slip_rad_s=around.synchroniser_lock_rad_s),
        air_k=float(conditions.ambient_k),
        coolant_k=float(conditions.coolant_k),
        full_brake_m_s=around.full_brake_m_s,
    )
    return DrivingLaw(drive=base._replace(plant=plant), driving=car.driving)


def _road(trace: SpeedTrace, conditions: DriveConditions, rng: np.random.Generator) -> Road:
    grid_s = np.arange(round(trace.duration_s / GRID_S) + 2) * GRID_S
    return Road(
        speeds=np.interp(grid_s, trace.t_s, trace.speed_m_s),
        grades=np.interp(grid_s, trace.t_s, trace.grade_ratio),
        whims=_whims(conditions.whim_ratio, rng),
        end=np.array([round(trace.duration_s * ROWS_PER_S)]),
    )


def _whims(ratio: float, rng: np.random.Generator) -> FloatArray:
    """Return what the driver's foot does without need, one row per event: a lift, or a deeper pedal."""
    table = np.empty((_WHIM_COUNT, indices.WHIM_COLUMN_COUNT))
    has_whim = rng.random(_WHIM_COUNT) < ratio
    table[:, indices.WHIM_DELAY] = np.where(has_whim, rng.uniform(0.0, _LONGEST_WHIM_DELAY_S, _WHIM_COUNT), -1.0)
    is_later = rng.random(_WHIM_COUNT) < ratio
    later_s = rng.uniform(0.0, _LONGEST_IN_GEAR_DELAY_S, _WHIM_COUNT)
    table[:, indices.WHIM_IN_GEAR_DELAY] = np.where(is_later, later_s, -1.0)
    table[:, indices.WHIM_LENGTH] = rng.uniform(*_WHIM_LENGTH_S, _WHIM_COUNT)
    deeper = rng.uniform(*_DEEPER_PEDAL, _WHIM_COUNT)
    table[:, indices.WHIM_SIZE] = np.where(rng.random(_WHIM_COUNT) < 0.5, -1.0, deeper)
    return table


def _initial_machine(law: DrivingLaw, conditions: DriveConditions) -> Machine:
    """Return a car that stands on its brakes, the engine idling, both clutches open, gears 1 and 2 engaged."""
    cycles = np.zeros((1, tcu_data.CYCLE_COLUMN_COUNT))
    cycles[0, tcu_data.CYCLE_MU : tcu_data.CYCLE_UP] = astuple(conditions.friction_factors)
    machine = idle_machine(
        cycles,
        law.drive.plant,
        conditions.oil_k,
        memory_count=indices.MEMORY_COUNT,
        sense_count=indices.SENSE_COUNT,
        command_count=indices.COMMAND_COUNT,
    )
    machine.u[at.COOLANT] = machine.sense[indices.COOLANT] = conditions.coolant_k
    gears = (1, 2)
    machine.modes[at.LINK : at.LINK + 2] = ENGAGED
    if law.drive.plant.converter.is_there:  # behind one shaft, which is in some gear at any time
        gears = (1, 0)
        machine.modes[at.LINK + 1] = NEUTRAL
        machine.y[at.GEAR_RATIO] = law.drive.overall_ratios[1]
    machine.modes[at.GEAR : at.GEAR + 2] = gears
    machine.modes[at.HELD] = 1
    machine.u[at.RATIO : at.RATIO + 2] = [law.drive.overall_ratios[gear] for gear in gears]
    machine.commands[tcu_data.WANTED_GEAR : tcu_data.WANTED_GEAR + 2] = gears
    machine.memory[tcu_data.CURRENT_GEAR] = machine.memory[tcu_data.TARGET_GEAR] = 1
    machine.memory[indices.STATE] = DrivelineState.STANDSTILL
    machine.memory[indices.BRAKE] = law.driving.driver.standing_brake_m_s2
    machine.y[[at.W_E, at.W_H]] = idle_rad_s(machine.sense, law)
    return machine


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


_DAY: Final[tuple[tuple[Traffic, Range, float], ...]] = (  # traffic, length [s], share of the trips
    (CITY, (300.0, 1500.0), 0.5),
    (MIXED, (600.0, 2400.0), 0.3),
    (MOTORWAY, (1200.0, 3600.0), 0.2),
)


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
    shares = [share for *_, share in _DAY]
    for index in range(int(rng.integers(DAY_TRIPS[0], DAY_TRIPS[1], endpoint=True))):
        traffic, duration_s, _ = _DAY[int(rng.choice(len(_DAY), p=shares))]
        parked_s = math.exp(rng.uniform(*np.log(PARKED_S))) if index else float(number > 0) * rng.uniform(*NIGHT_S)
        trace = traffic_trace(traffic, rng.uniform(*duration_s), rng, grade_ratio=rng.uniform(*DAY_GRADE_RATIO))
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
        self._is_off = False
        self._stay_s: float | None = None  # of a car that was switched off and on again; None: as planned
        self._is_ending = False  # whether the trip, or the one that follows, ends with its next row
        self.departure: Departure | None = None

    @property
    def is_parked(self) -> bool:
        """Whether the rows to come belong to another trip."""
        return self._car is None

    @property
    def finished(self) -> bool:
        """Whether the last trip is over, and nobody has switched the engine off to go on later."""
        return self.is_parked and self._next_trip is None and not self._is_off and self._stay_s is None

    @property
    def is_at_turn(self) -> bool:
        """Whether the next row ends a trip, or begins one after an order."""
        return self._is_ending or self._stay_s is not None

    @property
    def is_off(self) -> bool:
        """Whether the car is parked until ``switch_on``."""
        return self._is_off and self.is_parked

    @property
    def car(self) -> Trip | None:
        """The car on its trip, None while it is parked."""
        return self._car

    def switch_off(self) -> None:
        """End this trip with the next row, and begin none before ``switch_on``."""
        self._is_off, self._stay_s = True, None
        self._is_ending = self._car is not None

    def switch_on(self, stay_s: float) -> None:
        """Begin the next trip, else the last one again, after a stay of this length [s], all of which is shown."""
        if self._is_off:
            self._is_off, self._stay_s = False, stay_s

    def end_trip(self) -> None:
        """End this trip with the next row, or the next trip with its first; none follows: nothing happens."""
        self._is_ending = self._car is not None or not (self.finished or self._is_off)

    def request_gear(self, gear: int) -> None:
        """Ask a car on its trip for a gear."""
        if self._car is not None:
            self._car.request_gear(gear)

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control of a car that drives take these for its clutches' touch points."""
        if self._car is not None:
            self._car.believe(touch_pressures_pa)

    def advance(self, duration_s: float) -> FloatArray:
        """Drive on and return the next rows, shape (n, len(Col)); fewer than asked for where a trip ends.

        They belong to one trip, that of ``departure``.
        """
        if self._car is None:
            if self.finished or self._is_off:
                return np.empty((0, len(Col)))
            self._car = self._next_car()
        if self._is_ending:
            self._car.end()
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
            self._car, self._is_ending = None, False
            self._next_trip = next(self._trips, None)
        return rows

    def _next_car(self) -> Trip:
        trip = self._next_trip or (self.departure.trip if self.departure is not None else None)
        if trip is None:
            raise EmulatorConfigError("a drive has at least one trip")
        stay_s, self._stay_s = self._stay_s, None
        if stay_s is None:
            return self._set_off(trip, min(trip.parked_s, self._longest_stay_s))
        return self._set_off(replace(trip, parked_s=stay_s), stay_s)

    def _set_off(self, trip: PlannedTrip, shown_stay_s: float) -> Trip:
        self._clock_ms += round(shown_stay_s * MS_PER_S)
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
