"""What a verdict may rest on, and from where on it does: one table, which docs/verdict.md prints.

A threshold stands at a ground (a cause, or why there is no verdict) and a situation. Of the situations that hold for a
clutch the one that asks most decides. ``python -m tests.tools.threshold_table`` prints the table.
"""

from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Final, NamedTuple

from clutch_results.curves import CALIBRATED_RATIO, CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO, WATCH_MARGIN_RATIO
from fleet_contract.orders import LEVEL_UNTOLD, UNTOLD

MIN_SHIFT_COUNT: Final = 3
FIT_WINDOW: Final = 20  # shifts of both clutches: two cycles


class Cause(StrEnum):
    """What speaks for a change of the fluid, in the words of the verdict's reason."""

    SHUDDER = "shudder"  # the slope is negative
    LEVEL_LOW = "friction too low"
    LOSS_LARGE = "too much friction lost since the baseline"
    MARGIN_THIN = "margin against shudder halved"
    LEVEL_FALLING = "friction falling"
    LOSS_BEGUN = "friction lost since the baseline"


class Silence(StrEnum):
    """Why nothing is said of a clutch, and what would help."""

    FEW_SHIFTS = f"fewer than {MIN_SHIFT_COUNT} of its shifts could be used so far; more drives will tell"
    FEW_EVENTS = f"fewer than {MIN_SHIFT_COUNT} of its events could be used so far; more drives will tell"
    MARGIN_UNSURE = "its friction is not known well enough yet; more drives will tell"
    LAUNCHES_JUDDER = "it slips again after it has stuck when the car starts off, and its friction does not say why"
    SLIP_SWINGS = "its slip swings by itself, and its friction does not say why"
    CALIBRATION_MISFIT = "the calibration does not fit this vehicle; diag-service calibrate makes one that does"
    CONVERTER_MISFIT = "the description of its converter does not fit this vehicle; have its numbers looked at"
    SIGNALS_MISSING = UNTOLD
    LEVEL_UNKNOWN = LEVEL_UNTOLD
    SENSOR_DRIFTED = "a sensor by which it is judged has probably drifted; have that mended, then calibrate anew"
    DATA_CONTRADICT = (
        "its last events were refused, ten or more, because its sensors contradict each other or the commands; have "
        "them looked at"
    )
    INTERNAL_ERROR = "this program failed over its last event; what was known before stands, the next events will tell"
    PART_OF_DRIVE = "only a part of the drive was seen; measure again on a whole one"


class Situation(StrEnum):
    """What a clutch is judged in, in the words of the table."""

    MEANING = "what it is"
    BEGINNING = "where the situation begins"
    ALWAYS = "always"
    CALIBRATING = "while a vehicle calibrates"
    COLD = "cold pack"
    UNSURE_UP_TO_SCALE = "cold or while a vehicle calibrates, where torque is modelled"
    EARLY = "margin hardly known"
    UP_TO_SCALE = "where torque is modelled"
    LOCKUP = "lock-up clutch"
    FLUID_IS_NEW = "where none misfits"
    BEFORE_GOOD = "to hold back `good`"
    UNSURE_BEFORE_GOOD = "to hold back `good`, margin not known well"
    BOTH_BEFORE_GOOD = "the same, of both clutches together"
    STILL_GOOD = "to take back `good`, margin not known well"
    STANDING = "to call it off"


class Threshold(NamedTuple):
    """A number, what is held against it, and why it is that number."""

    value: float
    quantity: str  # with its unit
    reason: str
    source: str  # where the reason is shown: a study; or that it is reasoned only


Ground = Cause | Silence | Situation  # of a situation: where it begins
_CHANGE: Final = (Cause.SHUDDER, Cause.LEVEL_LOW, Cause.LOSS_LARGE)
_LEVEL: Final = (Cause.LEVEL_FALLING, Cause.LOSS_BEGUN)
_THIN: Final = (Cause.MARGIN_THIN,)
_JUDDER: Final = (Silence.LAUNCHES_JUDDER, Silence.SLIP_SWINGS)
_PROBABILITY, _MARGIN = "probability", "margin over that of new fluid"
_OF_NEW, _OF_BASELINE = "mu_C over that of new fluid", "mu_C over that of the baseline"
_MARGIN_STD: Final = "deviation of the margin over the margin of new fluid"
_REASONED, _CURVE, _DRIVES = "reasoned", "`make operating-curve`", "`studies.drive_accuracy`"
_LOCKUP, _CAUSES, _CALIBRATION = "`studies.lockup`", "`studies.causes`", "`studies.self_calibration`"
_RESERVE: Final = "a clutch is held at 1.5 times the torque: at 0.80 half of that reserve is gone"
_COLD: Final = "nobody knows the laws of film and drag well, and a drive has many looks at them"
_MODELLED: Final = "a model of the torque feigns a difference, too"
_EARLY: Final = "a few events mislead once in 300 drives"
_STAYS: Final = "a verdict does not come and go: its cause must have become unlikely"

_IN: Final = Situation
_ROWS: Final[tuple[tuple[tuple[Ground, ...], Situation, Threshold], ...]] = (
    ((Cause.SHUDDER,), _IN.MEANING, Threshold(0.0, _MARGIN, "a negative slope lets the driveline shudder", _REASONED)),
    ((Cause.LEVEL_LOW,), _IN.MEANING, Threshold(CHANGE_LEVEL_RATIO, _OF_NEW, _RESERVE, _REASONED)),
    ((Cause.LOSS_LARGE,), _IN.MEANING, Threshold(CHANGE_LEVEL_RATIO, _OF_BASELINE, _RESERVE, _REASONED)),
    (_THIN, _IN.MEANING, Threshold(WATCH_MARGIN_RATIO, _MARGIN, "half of the way to a negative slope", _REASONED)),
    ((Cause.LEVEL_FALLING,), _IN.MEANING, Threshold(WATCH_LEVEL_RATIO, _OF_NEW, "half of the way to 0.80", _REASONED)),
    ((Cause.LOSS_BEGUN,), _IN.MEANING, Threshold(WATCH_LEVEL_RATIO, _OF_BASELINE, "likewise", _REASONED)),
    (_CHANGE, _IN.ALWAYS, Threshold(0.95, _PROBABILITY, "a workshop visit costs: be sure", _CURVE)),
    (_CHANGE, _IN.COLD, Threshold(0.99, _PROBABILITY, _COLD, _DRIVES)),
    (_CHANGE, _IN.UNSURE_UP_TO_SCALE, Threshold(0.99, _PROBABILITY, _MODELLED, _DRIVES)),
    (_CHANGE, _IN.EARLY, Threshold(0.99, _PROBABILITY, _EARLY, _DRIVES)),
    (_LEVEL, _IN.ALWAYS, Threshold(0.80, _PROBABILITY, "to look again costs less than a workshop visit", _CURVE)),
    (_LEVEL, _IN.CALIBRATING, Threshold(0.98, _PROBABILITY, "new fluid seemed to have lost its level", _DRIVES)),
    (_LEVEL, _IN.COLD, Threshold(0.98, _PROBABILITY, _COLD, _DRIVES)),
    (_LEVEL, _IN.UNSURE_UP_TO_SCALE, Threshold(0.98, _PROBABILITY, _MODELLED, _DRIVES)),
    (
        _THIN,
        _IN.ALWAYS,
        Threshold(0.70, _PROBABILITY, "films and torques of unknown law feign a level, rarely a difference", _DRIVES),
    ),
    (_THIN, _IN.UNSURE_UP_TO_SCALE, Threshold(0.98, _PROBABILITY, _MODELLED, _DRIVES)),
    (_THIN, _IN.EARLY, Threshold(0.80, _PROBABILITY, _EARLY, _DRIVES)),
    (
        tuple(Cause),
        _IN.LOCKUP,
        Threshold(0.999, _PROBABILITY, "its slip is judged every minute, for hours", _LOCKUP),
    ),
    (tuple(Cause), _IN.STANDING, Threshold(0.20, _PROBABILITY, _STAYS, _CURVE)),
    (_THIN, _IN.UNSURE_BEFORE_GOOD, Threshold(0.01, _PROBABILITY, "a drive is judged a hundred times", _CURVE)),
    (_THIN, _IN.BOTH_BEFORE_GOOD, Threshold(0.003, _PROBABILITY, "both clutches slip in one oil", _CURVE)),
    (_THIN, _IN.STILL_GOOD, Threshold(0.20, _PROBABILITY, _STAYS, _CURVE)),
    (
        (*_LEVEL, *_THIN),
        _IN.BEFORE_GOOD,
        Threshold(0.80, _PROBABILITY, "what may have to be watched is not sound", _REASONED),
    ),
    (
        (Silence.FEW_SHIFTS, Silence.FEW_EVENTS),
        _IN.ALWAYS,
        Threshold(MIN_SHIFT_COUNT, "usable events", "of two that disagree nobody knows which is wrong", _REASONED),
    ),
    (
        (Silence.MARGIN_UNSURE,),
        _IN.ALWAYS,
        Threshold(0.25, _MARGIN_STD, "with more, new fluid is two deviations from a thin margin", _REASONED),
    ),
    (
        (Situation.UNSURE_BEFORE_GOOD,),
        _IN.BEGINNING,
        Threshold(0.05, _MARGIN_STD, "with more, further events will tell a thin margin from a good one", _REASONED),
    ),
    (
        (Silence.MARGIN_UNSURE,),
        _IN.UP_TO_SCALE,
        Threshold(0.5, _MARGIN_STD, "with more, a sure slope is no lining's", _DRIVES),
    ),
    (
        (Situation.EARLY,),
        _IN.BEGINNING,
        Threshold(0.15, _MARGIN_STD, "with more, one clutch is believed only as far as both together", _DRIVES),
    ),
    (
        (Situation.COLD,),
        _IN.BEGINNING,
        Threshold(333.15, "temperature of the pack, K: 60 degC", "below, films follow laws of their own", _DRIVES),
    ),
    (
        (Situation.CALIBRATING,),
        _IN.BEGINNING,
        Threshold(
            CALIBRATED_RATIO, "share of sensors, oil and latencies", "with less, they may feign friction", _DRIVES
        ),
    ),
    (
        (Silence.LAUNCHES_JUDDER,),
        _IN.MEANING,
        Threshold(5.2, "slip after the clutch had stuck, rad/s", "5, and a little of noise", _REASONED),
    ),
    (
        (Silence.SLIP_SWINGS,),
        _IN.MEANING,
        Threshold(0.04, "share of the windows of a stretch of slip", "roads swing it in fewer", _LOCKUP),
    ),
    (
        (Silence.SLIP_SWINGS,),
        _IN.BEGINNING,
        Threshold(3, "windows of a stretch of slip", "one may be a hole in the road", _REASONED),
    ),
    (
        _JUDDER,
        _IN.ALWAYS,
        Threshold(2, "launches or stretches that did", "one may be a load that pulled the clutch open", _REASONED),
    ),
    (
        (Silence.CALIBRATION_MISFIT, Silence.CONVERTER_MISFIT),
        _IN.ALWAYS,
        Threshold(
            0.25,
            f"share of the last {FIT_WINDOW} events",
            "of sound drives none, of a wrong calibration half",
            _CALIBRATION,
        ),
    ),
    (
        (Silence.CALIBRATION_MISFIT, Silence.CONVERTER_MISFIT),
        _IN.BEGINNING,
        Threshold(3, "events that contradict", "one or two are no share", _REASONED),
    ),
    (
        (Silence.CALIBRATION_MISFIT, Silence.CONVERTER_MISFIT),
        _IN.FLUID_IS_NEW,
        Threshold(6, "events that contradict", "new fluid contradicts each clutch up to three times", _REASONED),
    ),
    (
        (Silence.DATA_CONTRADICT,),
        _IN.ALWAYS,
        Threshold(10, "events refused in a row", "what was known before may no longer hold", _REASONED),
    ),
    (
        (Silence.SENSOR_DRIFTED,),
        _IN.ALWAYS,
        Threshold(0.5, _PROBABILITY, "friction that it tells is likelier wrong than right", _CAUSES),
    ),
)
THRESHOLDS: Final[Mapping[tuple[Ground, Situation], Threshold]] = MappingProxyType(
    {(ground, situation): threshold for grounds, situation, threshold in _ROWS for ground in grounds}
)
"""All thresholds, by what they are of and the situation in which they hold."""


@cache
def given_at(*situations: Situation) -> Mapping[Cause, float]:
    """Return from which probability of each cause on a bad verdict is given where these situations hold."""
    return MappingProxyType(
        {
            cause: max(
                THRESHOLDS[cause, situation].value
                for situation in (Situation.ALWAYS, *situations)
                if (cause, situation) in THRESHOLDS
            )
            for cause in Cause
        }
    )
