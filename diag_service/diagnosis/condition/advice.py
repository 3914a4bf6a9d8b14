"""One plain sentence for a workshop: what to do about a clutch, by when, and how sure that is.

"By when" goes as far as today's numbers carry: now, at the next service, or after more drives. Nothing here foretells.
"""

from enum import StrEnum
from typing import Final

from diag_service.diagnosis.condition.thresholds import (
    CHANGE_LEVEL_RATIO,
    CHANGE_PROBABILITY,
    LEAVE_PROBABILITY,
    MIN_SHIFT_COUNT,
    WATCH_LEVEL_RATIO,
    WATCH_MARGIN_RATIO,
    WATCH_PROBABILITY,
)
from diag_service.diagnosis.records import Condition

_PERCENT: Final = 100.0  # of a ratio
_NEARLY_SURE: Final = 0.995  # beyond it a rounded percentage would promise certainty


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

    FEW_SHIFTS = f"drive on and measure again: fewer than {MIN_SHIFT_COUNT} of its shifts could be used"
    MARGIN_UNSURE = "drive on and measure again: its friction is not known well enough yet"
    LAUNCHES_JUDDER = (
        "have its launches looked at: the clutch slips again after it has stuck, its friction says not why"
    )
    CALIBRATION_MISFIT = (
        "no verdict: the calibration does not fit this vehicle; let diag-service calibrate make its own, then measure "
        "again"
    )
    SIGNALS_MISSING = "no verdict: the signals of this vehicle do not tell its friction"
    PART_OF_DRIVE = "no verdict on a part of a drive: measure again on a whole one"


_WHAT: Final = {
    Cause.SHUDDER: "its fluid lets it shudder",
    Cause.LEVEL_LOW: f"its friction is below {_PERCENT * CHANGE_LEVEL_RATIO:.0f} % of new",
    Cause.LOSS_LARGE: f"it has lost more than {_PERCENT * (1.0 - CHANGE_LEVEL_RATIO):.0f} % of its own friction",
    Cause.MARGIN_THIN: f"{_PERCENT * (1.0 - WATCH_MARGIN_RATIO):.0f} % of its margin against shudder are gone",
    Cause.LEVEL_FALLING: f"its friction is below {_PERCENT * WATCH_LEVEL_RATIO:.0f} % of new",
    Cause.LOSS_BEGUN: f"it has lost more than {_PERCENT * (1.0 - WATCH_LEVEL_RATIO):.0f} % of its own friction",
}


def advice(clutch: int, condition: Condition, ground: Cause | Silence | None, probability: float = 0.0) -> str:
    """Return the sentence on clutch 1 or 2.

    Parameters
    ----------
    condition, ground :
        The verdict and what it rests on: a cause, or why there is none; None where nothing speaks against the fluid.
    probability :
        That the cause is there; of a good fluid, that none of them is.
    """
    if isinstance(ground, Silence):
        what = f"{ground}"
    elif ground is None:
        what = _if_good(probability)
    elif condition is Condition.CHANGE_FLUID:
        what = f"change the fluid now: {_WHAT[ground]} ({_until_called_off(probability, CHANGE_PROBABILITY)})"
    else:
        sure = _until_called_off(probability, WATCH_PROBABILITY)
        what = f"have the fluid changed at the next service: {_WHAT[ground]} ({sure})"
    return f"Clutch {clutch}: {what}."


def _if_good(probability: float) -> str:
    if probability >= WATCH_PROBABILITY:
        return f"nothing to do until the next service: its fluid is sound ({_percent(probability)} sure)"
    return f"nothing to do now, but measure again after more drives: its fluid is sound ({_percent(probability)} sure)"


def _until_called_off(probability: float, given_at: float) -> str:
    """Return how sure a cause is; of a verdict that merely stands also what calls it off."""
    if probability >= given_at:
        return f"{_percent(probability)} sure"
    return (
        f"{_percent(probability)} sure, after at least {_percent(given_at)}; "
        f"called off below {_percent(LEAVE_PROBABILITY)}"
    )


def _percent(probability: float) -> str:
    return "over 99 %" if probability > _NEARLY_SURE else f"{_PERCENT * probability:.0f} %"
