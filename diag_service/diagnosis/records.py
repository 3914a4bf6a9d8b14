"""What the service says of a shift: estimates, verdicts, results; and these as values that JSON can carry.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TypeVar

import msgspec
import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.events import EndReason, EventKind
from fleet_contract import JsonObject

RecordT = TypeVar("RecordT")


def to_plain(record: object) -> JsonObject:
    """Return the fields of a record as plain values; floats survive the round trip bit by bit."""
    plain = msgspec.to_builtins(record, enc_hook=_array_to_list)
    return {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}


def from_plain(table: object, kind: type[RecordT]) -> RecordT:
    """Rebuild a record that `to_plain` made plain; unknown keys are ignored, missing ones take their defaults.

    Raises
    ------
    ValueError
        Saying which value cannot be one of the record.
    """
    return msgspec.convert(table, kind, dec_hook=_list_to_array)


def _array_to_list(value: FloatArray | Mapping[object, object]) -> object:
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def _list_to_array(_: type, value: object) -> FloatArray:
    return np.array(value, dtype=np.float64)


class Tier(IntEnum):
    """What the signals of a vehicle suffice for; a smaller number is more."""

    FRICTION = 1  # pressure and torques: mu
    TORQUE = 2  # torque only: transmitted over commanded clutch torque
    KINEMATIC = 3  # speeds and gears: shift time and slip


class Status(StrEnum):
    """What an estimate is worth."""

    VALID = "valid"
    REJECTED = "rejected"  # data that must not be used; the reasons say why
    UNOBSERVED = "unobserved"  # sound data without information on friction


class Reason(StrEnum):
    """Why a shift was rejected or carried no information."""

    INTERRUPTED = "interrupted"
    SIGNAL_MISSING = "signal_missing"
    FRAMES_MISSING = "frames_missing"
    NO_SLIP_WINDOW = "no_slip_window"
    MISFIT = "misfit"  # chi-square above the gate
    SENSOR_FROZEN = "sensor_frozen"  # a signal repeats a value while noise is expected
    SPEEDS_DISAGREE = "speeds_disagree"  # shafts that turn together read different speeds
    PRESSURE_OFF_COMMAND = "pressure_off_command"  # a loaded clutch's pressure is not the commanded one
    ZERO_JUMPED = "zero_jumped"  # an empty clutch's pressure reads something else than before
    OUT_OF_RANGE = "out_of_range"  # a signal outside the domain of the model
    NOT_UPDATED = "not_updated"  # sound, but the running state refused it
    E2E_INVALID = "e2e_invalid"  # a message that the estimate needs was not to be believed as a whole
    TIME_UNSURE = "time_unsure"  # frames came too late to say when they were sent
    SATURATED = "saturated"  # signals at the end of their scale
    IMPLAUSIBLE = "implausible"  # sensors contradict each other
    CALIBRATION_OLD = "calibration_old"
    LOW_DATA_QUALITY = "low_trust"  # each flaw alone would pass, together they do not


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionEstimate:
    """Friction coefficients of one clutch with their uncertainty.

    ``std_*`` are total standard deviations: random part and common scale (torque gain, inertia, piston area, ...).
    ``random_std_*`` leave the common scale out: they hold for trends and for the comparison of clutches.
    """

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    correlation: float  # of the total errors of mu_c and mu_s
    random_std_mu_c: float
    random_std_mu_s: float
    slope_s_rad: float  # (mu_c - mu_s) / w_S: initial slope of the Stribeck curve
    std_slope_s_rad: float
    probability_negative_slope: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleFreeFriction:
    """Friction coefficients of one clutch times gain of the torque reading and piston area: what driving alone tells.

    Gain and area count as ratios to what the calibration says. Divided by both the numbers are the coefficients; the
    uncertainty of the two, the common scale, is not in ``std_*``.
    """

    mu_c: float
    mu_s: float
    std_mu_c: float
    std_mu_s: float
    correlation: float  # of the errors of mu_c and mu_s


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftScatter:
    """How much the estimates of single shifts of one clutch scatter about the running one, outliers clipped."""

    std_mu_c: float
    std_mu_s: float
    shift_count: int  # shifts in it


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionTrend:
    """Change of the running friction of one clutch since its baseline; a wrong scale cancels in the ratios."""

    change_mu_c: float
    change_mu_s: float
    std_change_mu_c: float
    std_change_mu_s: float
    change_mu_c_ratio: float  # 0.01 is one percent more than in the baseline
    change_mu_s_ratio: float
    std_change_mu_c_ratio: float
    std_change_mu_s_ratio: float
    baseline_end_bus_ns: int  # end of the shift after which the baseline was frozen
    baseline_shift_count: int  # shifts in the baseline
    later_shift_count: int  # shifts used since


@dataclass(frozen=True, slots=True, kw_only=True)
class LiningChange:
    """Running friction of one clutch against that of its first fluid: what new fluid did not bring back."""

    change_mu_c_ratio: float  # -0.01 is one percent less than with the first fluid
    change_mu_s_ratio: float
    std_change_mu_c_ratio: float
    std_change_mu_s_ratio: float
    baseline_shift_count: int  # shifts in the baseline of the first fluid


@dataclass(frozen=True, slots=True, kw_only=True)
class StickSlip:
    """Launches of one clutch to lock, of the last twenty, and how many of them slipped again after they had stuck."""

    launch_count: int
    judder_count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchRatio:
    """Friction of clutch 1 over that of clutch 2; the torque gain cancels, the piston areas do not."""

    mu_c_ratio: float
    mu_s_ratio: float
    std_mu_c_ratio: float
    std_mu_s_ratio: float


class QualityPart(StrEnum):
    """What the quality of a shift's data is made of."""

    FRAMES = "frames"
    PROTECTION = "protection"
    TIME = "time"
    SATURATION = "saturation"
    PLAUSIBILITY = "plausibility"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True, kw_only=True)
class DataQuality:
    """How far the data of a shift can be believed, each 0..1; parts that cannot be judged are left out."""

    score: float
    parts: Mapping[QualityPart, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftIndices:
    """What speeds and torques alone say about one shift (docs/model.md, indices of a shift); None: not to be had."""

    shift_time_s: float | None  # None unless the shift was completed
    slip_duration_s: float | None  # of the on-coming clutch, inside the shift
    peak_slip_rad_s: float | None
    slip_angle_rad: float | None  # slip integrated over time
    torque_capacity_ratio: float | None  # clutch torque transmitted at slip over the one asked for
    std_torque_capacity_ratio: float | None
    reslip_rad_s: float | None = None  # largest slip under load after it had ended once; 0: none


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftEstimate:
    """What one shift says about the clutch that engaged."""

    number: int
    from_gear: int
    to_gear: int
    clutch: int  # 1 or 2, the on-coming one
    start_ns: int
    end_ns: int
    status: Status
    reasons: tuple[Reason, ...]
    friction: FrictionEstimate | None  # None unless VALID
    sample_count: int  # torque samples inside the slip window
    window_s: float
    chi_square_ratio: float  # chi-square per degree of freedom; 0 when not computed
    quality: float  # 0..1: 1 is a full, clean, well-fitting window
    sump_temperature_k: float | None
    clutch_temperature_k: float | None
    slip_energy_j: float | None
    duration_s: float
    odometer_m: float | None
    data_quality: DataQuality | None = None  # whatever the estimate; None in results of older versions
    scale_free: ScaleFreeFriction | None = None  # None where there is no friction, and in results of older versions
    tier: Tier = Tier.FRICTION  # what the vehicle's signals suffice for
    indices: ShiftIndices | None = None
    kind: EventKind = EventKind.SHIFT  # what happened; the default in results of older versions
    end_reason: EndReason | None = None  # how it ended; None in results of older versions


class Condition(IntEnum):
    """Verdict on one clutch and its fluid, from best to worst; NO_VERDICT is below all."""

    NO_VERDICT = 0
    GOOD = 1
    WATCH = 2
    CHANGE_FLUID = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchVerdict:
    """Condition of one clutch after a shift: what justifies it, and what to do about it."""

    clutch: int
    condition: Condition
    reason: str
    level_ratio: float | None  # mu_c over the calibration's reference
    friction: FrictionEstimate | None  # the running estimate, all shifts combined
    shift_count: int  # shifts in the running estimate
    scale_free: ScaleFreeFriction | None = None  # this and what follows: None while unknown, and in older results
    common_scale_std_ratio: float | None = None  # relative deviation that all friction of the clutch shares
    shift_scatter: ShiftScatter | None = None
    trend: FrictionTrend | None = None  # against the vehicle's own baseline
    clutch_ratio: ClutchRatio | None = None
    lining: LiningChange | None = None  # once there is another fluid than the first
    stick_slip: StickSlip | None = None
    calibration_ratio: float | None = None  # how much of what driving tells of the vehicle is known, 0 to 1
    advice: str | None = None  # what to do, by when, how sure: one sentence for a workshop


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftResult:
    """What is stored and published for one shift: its own estimate and the clutch's verdict after it."""

    vehicle: str
    stream: str  # UUID of a live stream, sha256 of a log
    seq: int
    estimate: ShiftEstimate
    verdict: ClutchVerdict
    algorithm_version: str
    calibration_version: str
    produced_at: str  # ISO 8601 UTC, from the caller's clock; for a log the end of the shift


@dataclass(frozen=True, slots=True, kw_only=True)
class FluidFill:
    """New fluid in a vehicle: its friction before and after have nothing to do with each other."""

    vehicle: str
    filled_at: str  # ISO 8601 UTC with microseconds and ``Z``, so that texts sort as moments do
    odometer_m: float | None = None
    product: str | None = None  # name of the fluid
    note: str | None = None
    is_withdrawn: bool = False  # it was noted by mistake, and is taken back for good
