"""What the page shows, as records: the same for people, for programs and in files. SI units, UTC, all digits."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from enum import StrEnum

from clutch_results.loads import Load
from clutch_results.prognosis import Outlook
from clutch_results.records import Causes, ShiftQuality
from clutch_results.shift_course import ShiftCourse


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


@dataclass(frozen=True, slots=True, kw_only=True)
class VehiclesAnswer:
    """A part of the vehicles, each by its worse clutch; ``next`` is the offset of what follows."""

    vehicles: tuple[ClutchNow, ...]
    matching_count: int
    vehicle_count: int
    counts: Mapping[str, int]  # of all by verdict
    due_count: int  # within 30 days, more probably than not
    silent_count: int  # no result came for 14 days
    alarm_count: int  # with an open alarm
    next: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill:
    """New fluid."""

    filled_at: datetime
    odometer_m: float | None
    product: str
    note: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """An alarm that a rule raised."""

    vehicle: str
    clutch: int | None  # null: of the vehicle as a whole
    element: str | None  # as of `ClutchNow`
    rule: str
    number: int  # from 1 on, of each vehicle, clutch and rule
    raised_at: datetime
    cleared_at: datetime | None
    reason: str
    acknowledged_at: datetime | None
    acknowledged_by: str | None
    note: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrendPoint:
    """What one event said, and what was known of the clutch after it."""

    vehicle: str
    clutch: int
    end_at: datetime
    odometer_m: float | None
    kind: str | None
    status: str
    reasons: tuple[str, ...]
    mu_c: float | None
    std_mu_c: float | None
    random_std_mu_c: float | None
    mu_s: float | None
    std_mu_s: float | None
    running_mu_c: float | None
    running_std_mu_c: float | None
    running_mu_s: float | None
    running_std_mu_s: float | None
    running_correlation: float | None  # of the errors of mu_C and mu_S
    level_ratio: float | None
    condition: str
    score: float | None  # of a gear change, 100 is faultless
    stream: str
    seq: int
    algorithm_version: str
    calibration_version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReachAnswer:
    """Distance until a limit is passed, with 10, 50 and 90 % probability at most that far; null: beyond the horizon."""

    p10_m: float | None
    p50_m: float | None
    p90_m: float | None
    probability_before_service: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlookAnswer:
    """How far the fluid of a clutch will go."""

    clutch: int
    outlook: Outlook
    row_count: int
    left_out_count: int
    service_distance_m: float
    watch: ReachAnswer | None
    change_fluid: ReachAnswer | None
    assumptions: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchHistory:
    """One clutch of a vehicle: now, its future and its past, the oldest event first."""

    now: ClutchNow
    outlook: OutlookAnswer | None
    why_no_outlook: str | None
    trend: tuple[TrendPoint, ...]
    result_count: int  # those that are not in the trend counted too


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleAnswer:
    vehicle: str
    is_online: bool | None
    connected_at: datetime | None
    last_result_at: datetime | None
    service_version: str | None
    action: str | None  # what is to be done about its fluid; null without any result, as are the next two
    order: str | None
    outlook: str | None  # how far the fluid will go, or why that cannot be said
    fills: tuple[Fill, ...]
    alarms: tuple[Alarm, ...]
    clutches: tuple[ClutchHistory, ...]
    changes: tuple[ShiftCourse, ...]  # of gears
    loads: tuple[Load, ...]
    causes: Causes | None  # why it is as it is


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftAnswer:
    """One event: its own estimate, the running one after it, and what its data were worth."""

    vehicle: str
    stream: str
    seq: int
    clutch: int
    element: str | None  # as of `ClutchNow`
    number: int
    kind: str | None
    end_reason: str | None
    from_gear: int
    to_gear: int
    start_at: datetime
    end_at: datetime
    duration_s: float
    status: str
    reasons: tuple[str, ...]
    trust: float | None
    trust_parts: Mapping[str, float] | None
    shift_quality: ShiftQuality | None
    causes: Causes | None
    quality: float
    sample_count: int
    window_s: float
    chi_square_ratio: float
    friction: Mapping[str, float] | None
    running: Mapping[str, float] | None
    running_shift_count: int
    condition: str
    condition_reason: str
    advice: str | None
    level_ratio: float | None
    sump_temperature_k: float | None
    clutch_temperature_k: float | None
    slip_energy_j: float | None
    odometer_m: float | None
    algorithm_version: str
    calibration_version: str
    stored_at: datetime
    older_versions: tuple[str, ...]  # algorithm and calibration of results that this one supersedes


@dataclass(frozen=True, slots=True, kw_only=True)
class Quarantined:
    """A message that could not be used."""

    digest: str
    received_at: datetime
    topic: str
    vehicle: str | None
    reason: str
    detail: str
    size_bytes: int
    head: str
    acknowledged_at: datetime | None
    acknowledged_by: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class QuarantineAnswer:
    """A part of the quarantine, the latest first; ``next`` is the offset of what follows."""

    messages: tuple[Quarantined, ...]
    next: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmsAnswer:
    """A part of the alarms, the latest first; ``next`` is the offset of what follows."""

    alarms: tuple[Alarm, ...]
    next: int | None


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
    distance_a_day_m: float | None
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MaintenanceAnswer:
    """When the fluids of a part of the fleet are due, by day; ``next`` is the offset of what follows."""

    clutches: tuple[Due, ...]
    clutch_count: int
    next: int | None
