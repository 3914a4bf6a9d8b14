"""Records that travel between the stages of the service: columns, shift events, estimates, results.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np
import numpy.typing as npt

from diag_service.comparison import ClutchRatio, FrictionTrend, ScaleFreeFriction, ShiftScatter

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Int64Array = npt.NDArray[np.int64]
UInt8Array = npt.NDArray[np.uint8]
UInt32Array = npt.NDArray[np.uint32]


class Signal(StrEnum):
    """Canonical signals; the unit is the end of the name. A mapping profile fills them from a DBC."""

    ENGINE_SPEED = "engine_speed_rad_s"  # mean over the last crank segment
    ENGINE_TORQUE = "engine_torque_nm"  # at the crankshaft, friction deducted
    PEDAL = "pedal_ratio"
    THROTTLE = "throttle_ratio"
    HUB_SPEED = "hub_speed_rad_s"
    INPUT1_SPEED = "input1_speed_rad_s"
    INPUT2_SPEED = "input2_speed_rad_s"
    INPUT_SPEED = "input_speed_rad_s"  # of the shaft that carries the gear, where the bus has one for both clutches
    OUTPUT_SPEED = "output_speed_rad_s"
    CLUTCH1_PRESSURE = "clutch1_pressure_pa"
    CLUTCH2_PRESSURE = "clutch2_pressure_pa"
    CLUTCH1_PRESSURE_COMMAND = "clutch1_pressure_command_pa"
    CLUTCH2_PRESSURE_COMMAND = "clutch2_pressure_command_pa"
    CLUTCH1_TORQUE_COMMAND = "clutch1_torque_command_nm"
    CLUTCH2_TORQUE_COMMAND = "clutch2_torque_command_nm"
    CLUTCH_TORQUE = "clutch_torque_nm"  # of both clutches together, as the transmission controller states it
    CURRENT_GEAR = "current_gear"
    TARGET_GEAR = "target_gear"
    PRESELECTED_GEAR = "preselected_gear"
    SHIFT_PHASE = "shift_phase"
    SUMP_TEMPERATURE = "sump_temperature_k"
    WHEEL_FL_SPEED = "wheel_fl_speed_m_s"
    WHEEL_FR_SPEED = "wheel_fr_speed_m_s"
    WHEEL_RL_SPEED = "wheel_rl_speed_m_s"
    WHEEL_RR_SPEED = "wheel_rr_speed_m_s"
    VEHICLE_SPEED = "vehicle_speed_m_s"
    BRAKE_PRESSURE = "brake_pressure_pa"
    ODOMETER = "odometer_m"
    AMBIENT_TEMPERATURE = "ambient_temperature_k"


BALANCE_SIGNALS = (
    Signal.ENGINE_SPEED,
    Signal.ENGINE_TORQUE,
    Signal.HUB_SPEED,
    Signal.INPUT1_SPEED,
    Signal.INPUT2_SPEED,
    Signal.CLUTCH1_PRESSURE,
    Signal.CLUTCH2_PRESSURE,
)
"""What the torque balance of the input side needs, sample by sample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GearRatios:
    """Engine speed over another speed in every gear, where no signal tells the gear."""

    over: Signal  # output speed [rad/s] or vehicle speed [m/s]
    ratios: tuple[float, ...]  # first gear first; dimensionless, or [rad/m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Samples of one canonical signal, oldest first; invalid samples were left out and counted before.

    ``sequence`` numbers the transmissions of the message (unwrapped alive counter, gaps where frames are
    missing); without a counter in the DBC it is all -1. ``period_ns`` is the nominal cycle time, 0 if unknown; in
    an event it is the message's own, where that is plainly longer.
    """

    t_ns: Int64Array  # (n,)
    sequence: Int64Array  # (n,)
    value: FloatArray  # (n,), finite
    period_ns: int = 0

    def between(self, start_ns: int, stop_ns: int) -> "Series":
        """Return the samples with ``start_ns <= t_ns < stop_ns``."""
        first, last = self.t_ns.searchsorted((start_ns, stop_ns))
        return Series(
            t_ns=self.t_ns[first:last],
            sequence=self.sequence[first:last],
            value=self.value[first:last],
            period_ns=self.period_ns,
        )


Columns = Mapping[Signal, Series]


class E2eState(IntEnum):
    """What a message as a whole is worth, in the words of AUTOSAR's E2E state machine."""

    NO_DATA = 0  # never heard in this segment
    INIT = 1  # heard, not yet often enough
    VALID = 2
    INVALID = 3  # too many frames lost, broken, repeated or out of sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class E2eChange:
    """A message whose state changed."""

    t_ns: int
    message: str
    state: E2eState


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnBatch:
    """Decoded columns of one batch of frames.

    ``watermark_ns`` is the time of the last frame of the batch, of whatever kind: all that happened before it has
    been seen. ``breaks_before`` says that bus time jumped: what came earlier is another segment.
    """

    columns: Columns
    watermark_ns: int
    breaks_before: bool = False
    bad_frame_ns: Int64Array = field(default_factory=lambda: np.empty(0, np.int64))  # (m,) rejected or missing
    e2e_changes: tuple[E2eChange, ...] = ()  # of each message in the order of time


class EndReason(StrEnum):
    """How a shift or a rev ended."""

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"  # the stream began or ended amid it, or bus time jumped
    TOO_LONG = "too_long"
    ABANDONED = "abandoned"  # the target gear changed or went back before it was reached


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftEvent:
    """One gear change with its signals, cut a little wider than the shift itself."""

    number: int  # 1, 2, ... within the stream
    from_gear: int
    to_gear: int
    start_ns: int  # first sample with target != current
    end_ns: int  # first sample with current == target again
    end_reason: EndReason
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut
    e2e: Mapping[str, E2eState] = field(default_factory=dict)  # message -> INVALID if it ever was, else its last state


class Tier(IntEnum):
    """What the signals of a vehicle suffice for; a smaller number is more."""

    FRICTION = 1  # pressure and torques: mu
    TORQUE = 2  # torque only: transmitted over commanded clutch torque
    KINEMATIC = 3  # speeds and gears: shift time and slip


@dataclass(frozen=True, slots=True, kw_only=True)
class RevEvent:
    """One engine rev in neutral with its signals, cut a little wider than the rev itself.

    A rev goes from low engine speed through a high peak back to low speed, both clutches open or both closed all along.
    """

    number: int  # 1, 2, ... within the stream
    start_ns: int  # first sample of the engine speed that is no longer low
    end_ns: int  # first sample that is low again
    are_clutches_closed: bool  # else both are empty
    end_reason: EndReason  # abandoned: a gear was chosen
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut


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
    LOW_TRUST = "low_trust"  # each flaw alone would pass, together they do not


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


class TrustPart(StrEnum):
    """What the trust in a shift's data is made of."""

    FRAMES = "frames"
    PROTECTION = "protection"
    TIME = "time"
    SATURATION = "saturation"
    PLAUSIBILITY = "plausibility"
    CALIBRATION = "calibration"


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """How far the data of a shift may be trusted, each 0..1; parts that cannot be judged are left out."""

    score: float
    parts: Mapping[TrustPart, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftIndices:
    """What speeds and torques alone say about one shift (docs/model.md, indices of a shift); None: not to be had."""

    shift_time_s: float | None  # None unless the shift was completed
    slip_duration_s: float | None  # of the on-coming clutch, inside the shift
    peak_slip_rad_s: float | None
    slip_angle_rad: float | None  # slip integrated over time
    torque_capacity_ratio: float | None  # clutch torque transmitted at slip over the one asked for
    std_torque_capacity_ratio: float | None


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
    trust: Trust | None = None  # in the data, whatever the estimate; None in results of older versions
    scale_free: ScaleFreeFriction | None = None  # None where there is no friction, and in results of older versions
    tier: Tier = Tier.FRICTION  # what the vehicle's signals suffice for
    indices: ShiftIndices | None = None


class Condition(IntEnum):
    """Verdict on one clutch and its fluid, from best to worst; NO_VERDICT is below all."""

    NO_VERDICT = 0
    GOOD = 1
    WATCH = 2
    CHANGE_FLUID = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutchVerdict:
    """Condition of one clutch after a shift, with the sentence that justifies it."""

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
