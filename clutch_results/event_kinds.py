"""What happened on a drive: kinds of events, how they end and how well they went, slip that is let be."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from clutchdiag_io import people

DATED_NS: Final = people.DATED_NS


def events_text(count: int) -> str:
    """Return how many events there are, for people."""
    return f"{count} event{'' if count == 1 else 's'}"


class EndReason(StrEnum):
    """How an event ended."""

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"  # the stream began or ended amid it, or bus time jumped
    TOO_LONG = "too_long"
    ABANDONED = "abandoned"  # another event took over: a new target, a shift in a launch; or the clutch was let go


class EventKind(StrEnum):
    """What happened. A gear change lasts until the gears agree and no clutch slips under load."""

    SHIFT = "shift"  # a gear change of which neither torque nor pedal tells more
    POWER_ON_UPSHIFT = "power_on_upshift"
    POWER_OFF_UPSHIFT = "power_off_upshift"
    COAST_DOWNSHIFT = "coast_downshift"
    POWER_ON_DOWNSHIFT = "power_on_downshift"
    KICKDOWN = "kickdown"  # a power-on downshift with the pedal far down
    POWER_ON_SKIP = "power_on_skip"  # two gears down or more, with the foot on the pedal
    COAST_SKIP = "coast_skip"  # the same while coasting
    REGEAR = "regear"  # another gear while both clutches are open
    LAUNCH = "launch"  # a clutch slips under load until the car is as fast as the engine
    CREEP = "creep"  # the same without a foot on the pedal and without an end in lock
    CLOSING = "closing"  # a clutch closes onto a car that rolls by itself
    SLIP = "slip"  # a clutch that was locked slips in gear
    MICRO_SLIP = "micro_slip"  # about a minute in which a lock-up clutch was let slip, and what lay between
    RUN_UP_OPEN = "run_up_open"  # in neutral the engine ran from low speed to high and back, both clutches empty
    RUN_UP_CLOSED = "run_up_closed"  # the same, both clutches closed


SLIPS_IN_GEAR: Final = frozenset({EventKind.LAUNCH, EventKind.CREEP, EventKind.CLOSING, EventKind.SLIP})
_OTHERS: Final = {EventKind.REGEAR, EventKind.MICRO_SLIP, EventKind.RUN_UP_OPEN, EventKind.RUN_UP_CLOSED}
GEAR_CHANGES: Final = frozenset(EventKind) - SLIPS_IN_GEAR - _OTHERS  # from one clutch to the other


@dataclass(frozen=True, slots=True, kw_only=True)
class Shudder:
    """Slip that swings by itself while a clutch is let slip, as speeds show it, of the windows that were looked at."""

    window_count: int  # of 1.28 s, in which the clutch slipped all along
    seen_count: int  # in which slip swung in one narrow line, of neither engine nor road
    frequency_hz: float | None  # of the line; None: none was seen
    amplitude_rad_s: float  # index: root mean square of slip between 5 and 20 Hz, over all windows


@dataclass(frozen=True, slots=True, kw_only=True)
class MicroSlip:
    """Friction of a clutch that is held at small slip, there; ``slip_rad_s`` is 40 rpm."""

    slip_rad_s: float
    mu: float
    std_mu: float
    scale_free_mu: float  # times gain of the torque reading and piston area, as of an estimate
    std_scale_free_mu: float
    slope_s_rad: float  # of friction over slip, there
    std_slope_s_rad: float
    slip_s: float  # that it rests on
    blocks_as_one: float  # half seconds that tell as much as one without correlation
    shudder: Shudder | None = None


class NotMeasured(StrEnum):
    """Why an index of a shift is not to be had."""

    NOT_COMPLETED = "not_completed"
    SIGNAL_MISSING = "signal_missing"
    SAMPLED_TOO_SLOWLY = "sampled_too_slowly"
    TOO_COARSE = "too_coarse"  # in steps as large as what would be measured
    SAMPLES_MISSING = "samples_missing"  # in a gap that hides what would be measured
    SLIP_TOO_SHORT = "slip_too_short"
    NOT_LOCKED = "not_locked"  # a ratio is that of a gear only while no clutch slips
    SHAFT_UNKNOWN = "shaft_unknown"  # of two gears on one shaft, which is free while the new one is engaged
    UNTRUSTED = "untrusted"  # the signals contradict each other


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftIndices:
    """What speeds and torques alone say about one shift (docs/model.md, indices of a shift); None: not to be had.

    ``std_*`` are standard deviations: by the sampling, the resolution and the scatter of the signals in the event.
    """

    shift_time_s: float | None = None  # None unless the shift was completed
    slip_duration_s: float | None = None  # of the on-coming clutch, inside the shift
    peak_slip_rad_s: float | None = None
    slip_angle_rad: float | None = None  # slip integrated over time
    torque_capacity_ratio: float | None = None  # clutch torque transmitted at slip over the one asked for
    std_torque_capacity_ratio: float | None = None
    reslip_rad_s: float | None = None  # largest slip under load after it had ended once; 0: none
    std_shift_time_s: float | None = None
    std_slip_duration_s: float | None = None
    std_peak_slip_rad_s: float | None = None
    slip_energy_j: float | None = None  # heat of the on-coming clutch, by engine torque, inertia and slip
    std_slip_energy_j: float | None = None
    jerk_m_s3: float | None = None  # of the car, the largest within the shift
    std_jerk_m_s3: float | None = None
    ratio_before: float | None = None  # engine speed over output speed while the old gear is locked
    std_ratio_before: float | None = None
    ratio_after: float | None = None  # likewise of the new gear
    std_ratio_after: float | None = None
    judder_rad_s: float | None = None  # root mean square of slip between 5 and 20 Hz while the clutch slips
    std_judder_rad_s: float | None = None
    not_measured: Mapping[str, str] = field(default_factory=dict)  # index by its name here -> a word of `NotMeasured`


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftParts:
    """What the score of a gear change is made of, docs/verdict.md; None: its signals do not tell."""

    fill_error_s: float | None = None  # by which the on-coming clutch was filled for too short a time
    touch_error_pa: float | None = None  # by which its touch point is later than the control believes
    flare_rad_s: float | None = None  # engine speed outside of what lies between both shafts
    tie_up_nm: float | None = None  # that both clutches carried against each other
    torque_hole_m_s2: float | None = None  # acceleration below that before and after
    overtime_s: float | None = None  # from the request to the end of slip, beyond what is intended
    temperature_rise_k: float | None = None  # that slip makes of the warmer pack, no heat carried away
    jerk_m_s3: float | None = None
    lock_rate_rad_s2: float | None = None  # of the slip as it ends
    std_fill_error_s: float | None = None
    std_touch_error_pa: float | None = None
    acceleration_m_s2: float | None = None  # of the car before or after, whichever is larger


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftControl:
    """How the hydraulics followed in an event; None: its signals do not tell."""

    believed_touch_pa: float | None = None  # of the on-coming clutch, by which the control commands pressures
    fill_time_s: float | None = None  # that all of its filling takes at the flow of this one
    pressure_lag_s: float | None = None  # of its pressure behind the command, the pack closed
    pressure_reach_ratio: float | None = None  # of the command beyond the touch point that its pressure reaches
    pressure_short_pa: float | None = None  # by which it stays below the highest command


@dataclass(frozen=True, slots=True, kw_only=True)
class PackHeat:
    """What slip made of one pack in an event; None: its signals do not tell."""

    slip_energy_j: float | None = None
    peak_k: float | None = None  # warm throughout
    life_ratio: float | None = None  # of a lining's life that this slip consumes: an index


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftQuality:
    """How well an event went."""

    score: float | None  # 0 to 100, of a gear change
    reasons: tuple[str, ...] = ()  # the parts that cost a point or more, the dearest first
    parts: ShiftParts = field(default_factory=ShiftParts)
    control: ShiftControl = field(default_factory=ShiftControl)
    packs: tuple[PackHeat, PackHeat] = (PackHeat(), PackHeat())  # of clutch 1 and 2
