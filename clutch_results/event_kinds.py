"""What happened on a drive, in words: kinds of events, how they end, slip that is let be."""

from dataclasses import dataclass
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
