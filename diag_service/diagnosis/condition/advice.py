"""One plain sentence for a workshop: what a clutch says of its friction, and how sure that is.

It holds no order: both clutches slip in one oil, so `fleet_contract.orders` makes one order of what both of them say.
"""

from enum import StrEnum
from typing import Final

from diag_service.diagnosis.condition.thresholds import (
    CHANGE_LEVEL_RATIO,
    CHANGE_PROBABILITY,
    LEAVE_PROBABILITY,
    MIN_SHIFT_COUNT,
    WATCH_LEVEL_RATIO,
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

    FEW_SHIFTS = f"fewer than {MIN_SHIFT_COUNT} of its shifts could be used so far; more drives will tell"
    MARGIN_UNSURE = "its friction is not known well enough yet; more drives will tell"
    LAUNCHES_JUDDER = "it slips again after it has stuck when the car starts off, and its friction does not say why"
    CALIBRATION_MISFIT = "the calibration does not fit this vehicle; diag-service calibrate makes one that does"
    SIGNALS_MISSING = "the signals of this vehicle do not tell its friction"
    PART_OF_DRIVE = "only a part of the drive was seen; measure again on a whole one"


_WHAT: Final = {
    Cause.SHUDDER: "it can shudder",
    Cause.LEVEL_LOW: f"its friction is below {_PERCENT * CHANGE_LEVEL_RATIO:.0f} % of new",
    Cause.LOSS_LARGE: f"it has lost more than {_PERCENT * (1.0 - CHANGE_LEVEL_RATIO):.0f} % of its own friction",
    Cause.MARGIN_THIN: "half of its margin against shudder is gone",
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
        return f"Clutch {clutch}: {ground}."
    if ground is None:
        return f"Clutch {clutch}: its friction is sound ({_percent(probability)} sure)."
    given_at = CHANGE_PROBABILITY if condition is Condition.CHANGE_FLUID else WATCH_PROBABILITY
    return f"Clutch {clutch}: {_WHAT[ground]} ({_until_called_off(probability, given_at)})."


def _until_called_off(probability: float, given_at: float) -> str:
    """Return how sure a cause is; of a verdict that merely stands also what calls it off."""
    if probability >= given_at:
        return f"{_percent(probability)} sure"
    return (
        f"{_percent(probability)} sure now, at least {_percent(given_at)} before; "
        f"the verdict stands until that falls below {_percent(LEAVE_PROBABILITY)}"
    )


def _percent(probability: float) -> str:
    return "over 99 %" if probability > _NEARLY_SURE else f"{_PERCENT * probability:.0f} %"
