"""What finding a shift means, however its gears are known: bounds, and how a tracker is asked for them."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.series import Series
from diag_service.diagnosis.events import EndReason
from diag_service.diagnosis.shifts.history import Ahead

NS_PER_S = 1_000_000_000
MAX_SHIFT_NS = 5 * NS_PER_S  # a production shift takes about one second
DWELL_NS = NS_PER_S // 20  # a clutch that stays closed, a ratio that stays put, for so long does so for good


@dataclass(frozen=True, slots=True)
class Bounds:
    """A shift: its gears and when it began and ended."""

    from_gear: int
    to_gear: int
    start_ns: int
    end_ns: int
    end_reason: EndReason


class GearTracker(Protocol):
    """Finds where shifts begin and end."""

    def track(self, ahead: Ahead, until_ns: int) -> list[Bounds]:
        """Walk the samples with ``t < until_ns`` that are new; return the shifts that ended."""

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """End the stretch: return the shift that is open, as interrupted, and forget everything."""

    @property
    def open_ns(self) -> int | None:
        """When the open shift began, if there is one."""


def held_values(series: Series, t_ns: Int64Array, before: float) -> FloatArray:
    """Return the value in force at each time: the latest sample, or the one known ``before`` the first."""
    held = np.concatenate(((before,), series.value))
    return held[np.searchsorted(series.t_ns, t_ns, side="right")]
