"""What is measured of how a vehicle shifts, and under which conditions: read from the estimate of an event."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from clutch_model.units import rpm_from_rad_s
from clutch_results.records import ShiftEstimate, Tier
from clutchdiag_io.people import plus_minus

Reading = tuple[float | None, float | None]  # a value and its own standard deviation


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """Something that is measured of every event: SI in records, ``unit`` for people."""

    key: str  # in records, with its unit
    name: str
    unit: str
    scale: float  # from SI to the unit of people
    form: str  # of a number in that unit
    more: str  # what one says of a larger value
    less: str
    read: Callable[[ShiftEstimate], Reading]

    def number(self, mean: float, std: float | None) -> str:
        """Return a value with two deviations, if these are known, in the unit of people, which is not said."""
        text = self.form.format(self.scale * mean)
        return text if std is None else plus_minus(mean, std, self.form, scale=self.scale)

    def words(self, mean: float, std: float | None) -> str:
        """Return a value with two deviations, if these are known, and its unit for people."""
        return f"{self.number(mean, std)} {self.unit}".rstrip()


def _by_index(key: str) -> Callable[[ShiftEstimate], Reading]:
    def read(estimate: ShiftEstimate) -> Reading:
        indices = estimate.indices
        return (None, None) if indices is None else (getattr(indices, key), getattr(indices, f"std_{key}"))

    return read


def _score(estimate: ShiftEstimate) -> Reading:
    return None if estimate.shift_quality is None else estimate.shift_quality.score, None


_RPM: Final = rpm_from_rad_s(1.0)
SHIFT_TIME: Final = Measure(
    key="shift_time_s",
    name="shift time",
    unit="s",
    scale=1.0,
    form="{:.2f}",
    more="longer",
    less="shorter",
    read=_by_index("shift_time_s"),
)
SLIP_TIME: Final = replace(SHIFT_TIME, key="slip_duration_s", name="slip time", read=_by_index("slip_duration_s"))
PEAK_SLIP: Final = Measure(
    key="peak_slip_rad_s",
    name="peak slip",
    unit="rpm",
    scale=_RPM,
    form="{:.0f}",
    more="higher",
    less="lower",
    read=_by_index("peak_slip_rad_s"),
)
HEAT: Final = replace(
    PEAK_SLIP, key="slip_energy_j", name="heat", unit="kJ", scale=1e-3, form="{:.2f}", read=_by_index("slip_energy_j")
)
CAPACITY: Final = replace(
    PEAK_SLIP,
    key="torque_capacity_ratio",
    name="torque capacity",
    unit="",
    scale=1.0,
    form="{:.2f}",
    read=_by_index("torque_capacity_ratio"),
)
JUDDER: Final = replace(
    PEAK_SLIP,
    key="judder_rad_s",
    name="judder",
    form="{:.1f}",
    more="stronger",
    less="weaker",
    read=_by_index("judder_rad_s"),
)
JERK: Final = replace(
    PEAK_SLIP,
    key="jerk_m_s3",
    name="jerk",
    unit="m/s³",
    scale=1.0,
    form="{:.1f}",
    more="harder",
    less="softer",
    read=_by_index("jerk_m_s3"),
)
RATIO: Final = replace(CAPACITY, key="ratio_after", name="ratio after", form="{:.3f}", read=_by_index("ratio_after"))
SCORE: Final = replace(CAPACITY, key="score", name="score", form="{:.0f}", more="better", less="worse", read=_score)
MEASURES: Final = (SHIFT_TIME, SLIP_TIME, PEAK_SLIP, HEAT, CAPACITY, JUDDER, JERK, RATIO, SCORE)
"""In the order in which faces show them."""
BY_KEY: Final = {measure.key: measure for measure in MEASURES}


@dataclass(frozen=True, slots=True)
class EventCondition:
    """Something under which an event happens, and which is no fault of the clutch."""

    name: str
    read: Callable[[ShiftEstimate], float | None]
    not_for: frozenset[str] = frozenset()  # keys of measures that it is part of


def _acceleration(estimate: ShiftEstimate) -> float | None:
    return None if estimate.shift_quality is None else estimate.shift_quality.parts.acceleration_m_s2


def _bridged(estimate: ShiftEstimate) -> float | None:
    return None if estimate.indices is None else estimate.indices.peak_slip_rad_s


OIL: Final = EventCondition("oil temperature", lambda estimate: estimate.conditions.sump_temperature_k)
DRIVEN: Final = (
    EventCondition("speed to bridge", _bridged, frozenset({PEAK_SLIP.key, RATIO.key, CAPACITY.key})),
    EventCondition("acceleration", _acceleration, frozenset({RATIO.key})),
)


def shown_measures(tier: Tier | None) -> tuple[Measure, ...]:
    """Return the measures by which people are told how a vehicle of a tier shifts."""
    if tier is Tier.KINEMATIC:
        return SHIFT_TIME, SLIP_TIME, PEAK_SLIP, JERK, RATIO
    return SLIP_TIME, PEAK_SLIP, HEAT, CAPACITY, SCORE
