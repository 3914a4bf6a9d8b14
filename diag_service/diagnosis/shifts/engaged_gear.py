"""Shifts seen from the engaged gear alone, which a controller states or the ratio of two speeds tells."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.events import EndReason
from diag_service.diagnosis.shifts.history import Ahead
from diag_service.diagnosis.shifts.shift_bounds import DWELL_NS, MAX_SHIFT_NS, Bounds, held_values

RATIO_TOLERANCE = 0.04  # neighbouring gears are at least 15 % apart
MIN_SPEED_RAD_S = 50.0  # of the engine: below it drives nothing


class EngagedGear(Protocol):
    """Says which gear is engaged."""

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The signals that it needs."""

    def gears(self, values: Mapping[Signal, FloatArray]) -> Int64Array:
        """Return the gear from values held at the same times, shape (n,); below 1 for none."""


class CurrentGear:
    """The current gear, as the transmission controller states it."""

    signals = (Signal.CURRENT_GEAR,)

    def gears(self, values: Mapping[Signal, FloatArray]) -> Int64Array:
        """Return the gear, shape (n,)."""
        return np.nan_to_num(values[Signal.CURRENT_GEAR]).astype(np.int64)


class RatioGear:
    """The gear whose ratio engine and output speed have."""

    def __init__(self, gears: GearRatios) -> None:
        self._ratios = np.array(gears.ratios)
        self._over = gears.over
        self.signals = (Signal.ENGINE_SPEED, gears.over)

    def gears(self, values: Mapping[Signal, FloatArray]) -> Int64Array:
        """Return the gear, shape (n,)."""
        engine_rad_s, over = values[Signal.ENGINE_SPEED], values[self._over]
        drives = (engine_rad_s > MIN_SPEED_RAD_S) & (over > 0.0)
        ratio = np.divide(engine_rad_s, over, out=np.zeros(len(over)), where=drives)
        off = np.abs(ratio[:, None] / self._ratios - 1.0)
        nearest = np.argmin(off, axis=1)
        matches = off[np.arange(len(off)), nearest] < RATIO_TOLERANCE
        return np.where(matches, nearest + 1, 0)


class EngagedTracker:
    """A shift lasts from when one gear is no longer engaged until another one stays engaged.

    It is known only at its end: a stretch that ends between two gears tells of no shift.
    """

    def __init__(self, engaged: EngagedGear) -> None:
        self._engaged = engaged
        self._forget()

    def _forget(self) -> None:
        self._last: dict[Signal, float] = {}
        self._gear = 0  # the gear that was engaged last
        self._left_ns: int | None = None  # since when it is not
        self._seen = 0  # the gear that is there now
        self._seen_ns = 0

    @property
    def open_ns(self) -> int | None:
        """When the last gear was left, if it was."""
        return self._left_ns

    def track(self, ahead: Ahead, until_ns: int) -> list[Bounds]:
        """Walk the gears with ``t < until_ns``."""
        series = {name: ahead.until(name, until_ns) for name in self._engaged.signals}
        t_ns = np.unique(np.concatenate([one.t_ns for one in series.values()]))
        found: list[Bounds] = []
        if len(t_ns):
            values = {name: held_values(one, t_ns, self._last.get(name, np.nan)) for name, one in series.items()}
            self._last = {name: float(value[-1]) for name, value in values.items()}
            gears = self._engaged.gears(values)
            for row in np.flatnonzero(np.diff(gears, prepend=-1)):
                found += self._step(int(t_ns[row]), int(gears[row]))
        return [*found, *self._end_if_due(until_ns)]

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Forget the stretch; what it left open is no shift that is known."""
        found = self._end_if_due(now_ns)
        self._forget()
        return found

    def _step(self, t_ns: int, matched: int) -> list[Bounds]:
        found = self._end_if_due(t_ns)
        if matched != self._seen:
            if self._gear >= 1 and self._seen == self._gear and self._left_ns is None:
                self._left_ns = t_ns
            self._seen, self._seen_ns = matched, t_ns
        return found

    def _end_if_due(self, now_ns: int) -> list[Bounds]:
        """Return the shift that led to the gear which has stayed engaged for long enough by now, if there is one."""
        if self._seen >= 1 and now_ns >= self._seen_ns + DWELL_NS:
            came_from, left_ns = self._gear, self._left_ns
            self._gear, self._left_ns = self._seen, None
            if left_ns is not None and came_from != self._seen and self._seen_ns + DWELL_NS <= left_ns + MAX_SHIFT_NS:
                return [Bounds(came_from, self._seen, left_ns, self._seen_ns, EndReason.COMPLETE)]
        elif self._left_ns is not None and now_ns > self._left_ns + MAX_SHIFT_NS:
            self._gear, self._left_ns = 0, None  # neutral, or standing
        return []
