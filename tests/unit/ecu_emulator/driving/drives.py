"""Short drives for tests: traces from a few points, rows of a whole trip, the events in them."""

from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import FloatArray
from ecu_emulator.driving.indices import ManoeuvreKind
from ecu_emulator.driving.journey import Car, DriveConditions, Trip
from ecu_emulator.driving.traffic import SpeedTrace
from ecu_emulator.plant.state import Col

WARM_K = 363.15
COLD_K = 263.15


def trace(*points: tuple[float, float], grade_ratio: float = 0.0) -> SpeedTrace:
    """Return a trace through points of time [s] and speed [m/s]."""
    t_s, speed_m_s = (np.array(column) for column in zip(*points, strict=True))
    return SpeedTrace(name="made up", t_s=t_s, speed_m_s=speed_m_s, grade_ratio=np.full(t_s.size, grade_ratio))


def conditions(**changes: float) -> DriveConditions:
    """Return warm conditions without whims, but for what is given."""
    return DriveConditions(**{"whim_ratio": 0.0, **changes})  # type: ignore[arg-type]  # all of them are numbers


def trip(
    road: SpeedTrace, *, seed: int = 1, is_audited: bool = False, mass_kg: float | None = None, **changes: float
) -> Trip:
    """Return a trip of the nominal car, loaded to a mass if one is given."""
    car = Car()
    if mass_kg is not None:
        vehicle = car.parameters.vehicle._replace(mass_kg=mass_kg)
        car = replace(car, parameters=replace(car.parameters, vehicle=vehicle))
    whole = Trip(car, road, conditions(**changes), np.random.default_rng(seed))
    if is_audited:
        whole.audit()
    return whole


def driven(road: SpeedTrace, *, seed: int = 1, mass_kg: float | None = None, **changes: float) -> FloatArray:
    """Return all rows of a trip."""
    return trip(road, seed=seed, is_audited=False, mass_kg=mass_kg, **changes).advance(road.duration_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One event and its rows."""

    kind: ManoeuvreKind
    rows: FloatArray

    @property
    def is_aborted(self) -> bool:
        """Whether it went back to where it began."""
        return bool(self.rows[:, Col.IS_ABORTED].any())

    @property
    def gears(self) -> tuple[int, int]:
        """Gear it began in and gear it aimed at."""
        return int(self.rows[0, Col.CURRENT_GEAR]), int(self.rows[0, Col.TARGET_GEAR])


def events(rows: FloatArray) -> list[Event]:
    """Return the events of a drive in order."""
    numbers = np.unique(rows[:, Col.EVENT_NUMBER])
    found = [rows[rows[:, Col.EVENT_NUMBER] == number] for number in numbers[numbers > 0.0]]
    return [Event(kind=ManoeuvreKind(int(during[0, Col.EVENT_KIND])), rows=during) for during in found]


def of_kind(rows: FloatArray, kind: ManoeuvreKind) -> list[Event]:
    """Return the events of one kind."""
    return [event for event in events(rows) if event.kind is kind]
