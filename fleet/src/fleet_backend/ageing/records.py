"""The fleet as records: a clutch now, a fluid fill, when a fluid is due. SI units, UTC."""

from dataclasses import dataclass
from datetime import date, datetime
from enum import StrEnum

from fleet_backend.schema import FRICTION_TIER


class Severity(StrEnum):
    """Verdicts as the database writes them."""

    CHANGE_FLUID = "change_fluid"
    WATCH = "watch"
    GOOD = "good"
    NO_VERDICT = "no_verdict"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchNow:
    """The running condition of a clutch after its last event."""

    vehicle: str
    clutch: int
    element: str | None  # its name, where it is neither clutch 1 nor clutch 2 of a pair
    condition: str
    condition_reason: str
    advice: str | None
    level_ratio: float | None
    shift_count: int
    mu_c: float | None
    mu_s: float | None
    std_mu_c: float | None
    std_mu_s: float | None
    correlation: float | None
    slope_s_rad: float | None
    std_slope_s_rad: float | None
    probability_negative_slope: float | None
    score: float | None  # of the last gear change that engaged it, 100 is faultless
    odometer_m: float | None
    end_at: datetime
    stored_at: datetime
    fluid: str | None
    fluid_since: datetime | None
    action: str  # what is to be done about the fluid of the vehicle; this and the next the same for both clutches
    order: str
    stream: str
    seq: int
    algorithm_version: str
    calibration_version: str
    tier: int | None  # what its signals suffice for, 1 is friction; None: of an older program
    shifting: str | None = None  # how the vehicle shifts, in a sentence, where it cannot tell friction

    @property
    def tells_friction(self) -> bool:
        """Whether its signals suffice for friction; of older programs nobody knows, and it is taken as so."""
        return self.tier is None or self.tier == FRICTION_TIER


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill:
    """New fluid."""

    filled_at: datetime
    odometer_m: float | None
    product: str
    note: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Due:
    """When the fluid of a clutch is due; a day is null without a trend or a distance a day, and in far future."""

    vehicle: str
    clutch: int
    element: str | None  # as of `ClutchNow`
    condition: str
    is_overdue: bool  # its limit is passed, or more probably so than not
    due_from: date | None  # it lasts until then with a probability of 90 %
    half_by: date | None
    most_by: date | None
    left_m: float | None  # from the last event until `half_by`
    least_left_m: float | None  # from there on it lasts at least so far, 90 % sure; known without a trend, too
    distance_a_day_m: float | None
    text: str
