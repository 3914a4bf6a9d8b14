"""Speed traces: public test cycles, and seeded traffic with lights, queues, corners, slow and eager drivers, hills.

A trip is made of legs from stop to stop. How fast speeds change is drawn, within what drivers do and what a car of
ordinary power can follow.
"""

import math
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Final

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.tables import record_from
from clutch_model.units import m_s_from_km_h

_HEADER_LINES: Final = 2  # the source, and the names of the columns


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedTrace:
    """Speed and grade over time; straight lines between the points, the last one is the end of the drive."""

    name: str
    t_s: FloatArray  # (n,), n >= 2, rises from 0
    speed_m_s: FloatArray  # (n,)
    grade_ratio: FloatArray  # (n,), rise over way, positive uphill

    @property
    def duration_s(self) -> float:
        """Length of the trace [s]."""
        return float(self.t_s[-1])

    @property
    def distance_m(self) -> float:
        """Way it leads [m]."""
        return float(np.trapezoid(self.speed_m_s, self.t_s))


def public_trace(name: str) -> SpeedTrace:
    """Return one of the public test cycles, on level ground: wltc, udds, hwfet or us06."""
    with files("ecu_emulator").joinpath(f"driving/traces/{name}.csv").open(encoding="utf-8") as lines:
        t_s, speed_km_h = np.loadtxt(lines, delimiter=",", skiprows=_HEADER_LINES, unpack=True)
    return SpeedTrace(name=name, t_s=t_s, speed_m_s=m_s_from_km_h(speed_km_h), grade_ratio=np.zeros(len(t_s)))


Range = tuple[float, float]  # from, to

PERIOD_S: Final = 0.2  # between the points of a trace
MAX_ACCELERATION_M_S2: Final = 2.8  # as in the US06, the hardest of the public cycles (3.8 at its peak)
MAX_DECELERATION_M_S2: Final = 3.0  # the upper end of what drivers call comfortable
MAX_JERK_M_S3: Final = 1.0
MAX_POWER_W_KG: Final = 30.0  # acceleration times speed; WLTC 21, US06 46 at their peaks
LEAST_STEP_M_S: Final = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """What the legs of a trip are drawn from."""

    name: str
    cruise_km_h: Range
    leg_m: Range  # from stop to stop
    accelerate_m_s2: Range  # mean of a change of speed
    brake_m_s2: Range
    stop_s: Range
    queue_share: float  # of the stops, at which the car creeps forward with a queue
    corner_share: float  # of the legs, that slow down to a walk or a run on the way
    green_share: float  # of the approaches, at which the light turns green before the car stands
    push_share: float  # of the legs, in which the driver wants more speed at once
    hills_m: tuple[float, ...]  # lengths of the waves of which the road is made

    @property
    def cruise_m_s(self) -> Range:
        slowest_km_h, fastest_km_h = self.cruise_km_h
        return float(m_s_from_km_h(slowest_km_h)), float(m_s_from_km_h(fastest_km_h))


_TABLES: Final = tomllib.loads(files("ecu_emulator").joinpath("driving/traffic.toml").read_text(encoding="utf-8"))
CITY, MIXED, MOTORWAY = (record_from(Traffic, _TABLES[name], name=name) for name in ("city", "mixed", "motorway"))


def traffic_trace(
    traffic: Traffic, duration_s: float, rng: np.random.Generator, *, grade_ratio: float = 0.0
) -> SpeedTrace:
    """Return a trip that begins and ends at rest.

    Parameters
    ----------
    duration_s : float
        Length of the trip [s]; it goes on until the car has stopped after that.
    rng : Generator
        Equal generators make equal trips.
    grade_ratio : float
        The steepest grade, 0: level; hills lie along the road, up and down alike.
    """
    profile = _Profile()
    profile.hold(rng.uniform(2.0, 6.0))
    while profile.t_s < duration_s:
        _drive_leg(profile, traffic, rng)
        _stand(profile, traffic, rng)
    t_s, speed_m_s = profile.sampled()
    distance_m = np.concatenate(([0.0], np.cumsum(0.5 * (speed_m_s[1:] + speed_m_s[:-1]) * np.diff(t_s))))
    return SpeedTrace(
        name=traffic.name,
        t_s=t_s,
        speed_m_s=speed_m_s,
        grade_ratio=_grade_along(distance_m, traffic.hills_m, grade_ratio, rng),
    )


class _Profile:
    """Speeds, one after the other, at equal steps of time; acceleration changes no faster than a driver's foot."""

    def __init__(self) -> None:
        self._speeds_m_s = [0.0]
        self.distance_m = 0.0

    @property
    def t_s(self) -> float:
        return PERIOD_S * (len(self._speeds_m_s) - 1)

    @property
    def speed_m_s(self) -> float:
        return self._speeds_m_s[-1]

    def hold(self, duration_s: float) -> None:
        for _ in range(round(duration_s / PERIOD_S)):
            self._append(self.speed_m_s)

    def change(self, wanted_m_s: float, rate_m_s2: float) -> None:
        """Go to another speed at this rate, or slower where the car could not."""
        direction = math.copysign(1.0, wanted_m_s - self.speed_m_s)
        limit_m_s2 = min(rate_m_s2, MAX_ACCELERATION_M_S2 if direction > 0.0 else MAX_DECELERATION_M_S2)
        size_m_s2 = 0.0
        while (left_m_s := direction * (wanted_m_s - self.speed_m_s)) > 0.0:
            goal_m_s2 = min(limit_m_s2, math.sqrt(2.0 * MAX_JERK_M_S3 * left_m_s))  # so that it ends softly
            if direction > 0.0:
                goal_m_s2 = min(goal_m_s2, MAX_POWER_W_KG / max(self.speed_m_s, 1.0))
            size_m_s2 = min(goal_m_s2, size_m_s2 + MAX_JERK_M_S3 * PERIOD_S)
            step_m_s = min(max(size_m_s2 * PERIOD_S, LEAST_STEP_M_S), left_m_s)
            self._append(self.speed_m_s + direction * step_m_s if step_m_s < left_m_s else wanted_m_s)

    def sampled(self) -> tuple[FloatArray, FloatArray]:
        """Return times and speeds, each (n,)."""
        speed_m_s = np.array(self._speeds_m_s, np.float64)
        return np.arange(speed_m_s.size, dtype=np.float64) * PERIOD_S, speed_m_s

    def _append(self, speed_m_s: float) -> None:
        self.distance_m += PERIOD_S * 0.5 * (self.speed_m_s + speed_m_s)
        self._speeds_m_s.append(speed_m_s)


def _drive_leg(profile: _Profile, traffic: Traffic, rng: np.random.Generator) -> None:
    start_m, length_m = profile.distance_m, _log_uniform(traffic.leg_m, rng)
    cruise_m_s = min(rng.uniform(*traffic.cruise_m_s), math.sqrt(length_m * traffic.accelerate_m_s2[1]))
    profile.change(cruise_m_s, rng.uniform(*traffic.accelerate_m_s2))
    brake_m_s2 = rng.uniform(*traffic.brake_m_s2)
    if rng.uniform() < traffic.corner_share:
        profile.hold(rng.uniform(0.5, 8.0))
        profile.change(cruise_m_s * rng.uniform(0.15, 0.6), brake_m_s2)
        profile.hold(rng.uniform(0.0, 4.0))
        profile.change(cruise_m_s, rng.uniform(*traffic.accelerate_m_s2))
    if rng.uniform() < traffic.push_share:
        profile.hold(rng.uniform(1.0, 10.0))
        profile.change(min(1.3 * cruise_m_s, traffic.cruise_m_s[1]), MAX_ACCELERATION_M_S2)
    while True:
        stopping_m = profile.speed_m_s**2 / (2.0 * brake_m_s2)
        left_m = length_m - (profile.distance_m - start_m) - stopping_m
        if left_m <= 0.0:
            break
        profile.hold(min(rng.uniform(3.0, 15.0), left_m / profile.speed_m_s))
        wanted_m_s = min(cruise_m_s * rng.uniform(0.88, 1.12), traffic.cruise_m_s[1])
        profile.change(wanted_m_s, rng.uniform(0.2, 0.6))
    if rng.uniform() < traffic.green_share:
        profile.change(profile.speed_m_s * rng.uniform(0.05, 0.4), brake_m_s2)
        profile.change(cruise_m_s, rng.uniform(*traffic.accelerate_m_s2))
    profile.change(0.0, brake_m_s2)


def _stand(profile: _Profile, traffic: Traffic, rng: np.random.Generator) -> None:
    """Wait, and creep forward where there is a queue."""
    profile.hold(_log_uniform(traffic.stop_s, rng))
    if rng.uniform() >= traffic.queue_share:
        return
    for _ in range(rng.integers(1, 4)):
        is_creeping = rng.uniform() < 0.25  # the driver lets the brake go and leaves the pedal alone
        speed_m_s, rate_m_s2 = ((0.8, 1.5), (0.25, 0.35)) if is_creeping else ((2.2, 4.5), (0.5, 1.0))
        profile.change(rng.uniform(*speed_m_s), rng.uniform(*rate_m_s2))
        profile.hold(rng.uniform(0.5, 5.0))
        profile.change(0.0, rng.uniform(0.5, 1.2))
        profile.hold(rng.uniform(1.0, 8.0))


def _grade_along(
    distance_m: FloatArray, hills_m: tuple[float, ...], steepest_ratio: float, rng: np.random.Generator
) -> FloatArray:
    """Return the grade at each place of a road over hills of several lengths, shape (n,)."""
    phases = rng.uniform(0.0, 2.0 * math.pi, len(hills_m))
    waves = [
        np.sin(2.0 * math.pi * distance_m / length_m + phase) for length_m, phase in zip(hills_m, phases, strict=True)
    ]
    grade_ratio: FloatArray = steepest_ratio * np.mean(waves, axis=0)
    return grade_ratio


def _log_uniform(limits: Range, rng: np.random.Generator) -> float:
    """Draw a number whose logarithm is uniform: short ones are more frequent than long ones."""
    return float(np.exp(rng.uniform(math.log(limits[0]), math.log(limits[1]))))
