"""When gears change: from current and target gear, from the target and the slip, or from the ratio of speeds.

A tracker walks along the samples once, in steps of any size, and reports the bounds of the shifts it saw end.
"""

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from diag_service.history import held
from diag_service.records import EndReason, FloatArray, GearRatios, Int64Array, Series, Signal

NS_PER_S = 1_000_000_000
MAX_SHIFT_NS = 5 * NS_PER_S  # a production shift takes about one second
DWELL_NS = NS_PER_S // 20  # a clutch that stays closed, a ratio that stays put, for so long does so for good
CLOSED_SLIP_RAD_S = 5.0  # 50 rpm: beyond it the clutch slips, whatever two controllers' speeds differ by
RATIO_TOLERANCE = 0.04  # neighbouring gears are at least 15 % apart
MIN_SPEED_RAD_S = 50.0  # of the engine: below it drives nothing

Samples = Callable[[Signal, int], Series]
"""The samples of a signal from where the tracker stands up to a time."""


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

    def follow(self, samples: Samples, until_ns: int) -> list[Bounds]:
        """Walk the samples with ``t < until_ns`` that are new; return the shifts that ended."""

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """End the stretch: return the shift that is open, as interrupted, and forget everything."""

    @property
    def open_ns(self) -> int | None:
        """When the open shift began, if there is one."""


def tracker_for(signals: AbstractSet[Signal], gears: GearRatios | None = None) -> GearTracker:
    """Return the tracker that makes the most of the signals that a bus can deliver."""
    if Signal.TARGET_GEAR in signals and Signal.CURRENT_GEAR not in signals:
        inputs = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
        if not signals >= set(inputs):
            inputs = (Signal.INPUT_SPEED, Signal.INPUT_SPEED)
        return TargetTracker(inputs)
    if Signal.CURRENT_GEAR not in signals and gears is not None:
        return EngagedTracker(RatioGear(gears))
    return GearPairTracker()


@dataclass(slots=True)
class _Gears:
    """Current and target gear as last seen; 0 while unknown."""

    current: int = 0
    target: int = 0


class GearPairTracker:
    """A shift lasts from the first sample whose target gear differs from the current one until they agree again.

    As long as no target gear has come, a change of the current gear is all that tells of a shift.
    """

    def __init__(self) -> None:
        self._lone = EngagedTracker(CurrentGear())
        self._has_target = False
        self._gears = _Gears()
        self._open: Bounds | None = None
        self._overdue = False  # the open shift was reported as too long; wait until the gears agree
        self._closed: list[Bounds] = []

    @property
    def open_ns(self) -> int | None:
        """When the open shift began, if there is one."""
        return self._lone.open_ns if self._open is None else self._open.start_ns

    def follow(self, samples: Samples, until_ns: int) -> list[Bounds]:
        """Walk the gear changes with ``t < until_ns``."""
        current = samples(Signal.CURRENT_GEAR, until_ns)
        target = samples(Signal.TARGET_GEAR, until_ns)
        if not self._has_target:
            self._closed += self._lone.follow(samples, int(target.t_ns[0]) if len(target.t_ns) else until_ns)
            self._has_target = len(target.t_ns) > 0
            if self._has_target:
                self._closed += self._lone.interrupt(int(target.t_ns[0]))
        is_one_message = np.array_equal(current.t_ns, target.t_ns)  # as a rule; a union costs much more
        t_ns = current.t_ns if is_one_message else np.union1d(current.t_ns, target.t_ns)
        if len(t_ns):
            pairs = np.column_stack((held(current, t_ns, self._gears.current), held(target, t_ns, self._gears.target)))
            before = np.vstack(((self._gears.current, self._gears.target), pairs[:-1]))
            for row in np.flatnonzero(np.any(pairs != before, axis=1)):
                self._close_overdue(int(t_ns[row]))
                self._step(int(t_ns[row]), _Gears(int(pairs[row, 0]), int(pairs[row, 1])))
        self._close_overdue(until_ns)
        return self._take()

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Return the open shift as interrupted."""
        self._closed += self._lone.interrupt(now_ns)
        self._close(now_ns, EndReason.INTERRUPTED)
        self._gears, self._has_target = _Gears(), False
        self._overdue = False
        return self._take()

    def _take(self) -> list[Bounds]:
        closed, self._closed = self._closed, []
        return closed

    def _step(self, t_ns: int, gears: _Gears) -> None:
        self._gears = gears
        if gears.current < 1 or gears.target < 1:
            self._close(t_ns, EndReason.ABANDONED)
            return
        if self._open is not None and (gears.target != self._open.to_gear or gears.current != self._open.from_gear):
            reached = gears.current == gears.target == self._open.to_gear
            self._close(t_ns, EndReason.COMPLETE if reached else EndReason.ABANDONED)
        if gears.current == gears.target:
            self._overdue = False
        elif self._open is None and not self._overdue:
            self._open = Bounds(gears.current, gears.target, t_ns, t_ns, EndReason.INTERRUPTED)

    def _close(self, t_ns: int, reason: EndReason) -> None:
        if self._open is not None:
            self._closed.append(replace(self._open, end_ns=t_ns, end_reason=reason))
            self._open = None

    def _close_overdue(self, now_ns: int) -> None:
        if self._open is not None and now_ns > self._open.start_ns + MAX_SHIFT_NS:
            self._close(self._open.start_ns + MAX_SHIFT_NS, EndReason.TOO_LONG)
            self._overdue = True


class TargetTracker:
    """A shift lasts from a change of the target gear until the slip of the on-coming clutch, once open, stays closed.

    Parameters
    ----------
    inputs : tuple of Signal
        Input speeds of the odd and of the even gears; the same signal twice where the bus has but one.
    """

    def __init__(self, inputs: tuple[Signal, Signal]) -> None:
        self._inputs = inputs
        self._forget()

    def _forget(self) -> None:
        self._last: dict[Signal, float] = {}
        self._gear = 0
        self._open: Bounds | None = None
        self._has_slipped = False
        self._closed_ns: int | None = None  # since when the clutch has not slipped

    @property
    def open_ns(self) -> int | None:
        """When the open shift began, if there is one."""
        return None if self._open is None else self._open.start_ns

    def follow(self, samples: Samples, until_ns: int) -> list[Bounds]:
        """Walk target gear and slip with ``t < until_ns``."""
        names = tuple(dict.fromkeys((Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *self._inputs)))
        series = {name: samples(name, until_ns) for name in names}
        t_ns = np.unique(np.concatenate([one.t_ns for one in series.values()]))
        values = {name: held_values(one, t_ns, self._last.get(name, np.nan)) for name, one in series.items()}
        found: list[Bounds] = []
        if len(t_ns):
            self._last = {name: float(value[-1]) for name, value in values.items()}
            target = np.nan_to_num(values[Signal.TARGET_GEAR]).astype(np.int64)
            odd, even = (np.abs(values[Signal.ENGINE_SPEED] - values[name]) for name in self._inputs)
            slip_rad_s = np.where(target % 2 == 1, odd, even)
            state = 2 * target + (slip_rad_s > CLOSED_SLIP_RAD_S)  # an unknown slip counts as closed
            changes = np.flatnonzero(np.diff(state, prepend=-1))
            for row in changes:
                found += self._step(int(t_ns[row]), int(target[row]), slips=bool(state[row] % 2))
        return [*found, *self._settle(until_ns)]

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Return the open shift as interrupted."""
        found = self._settle(now_ns)
        if self._open is not None:
            found.append(replace(self._open, end_ns=now_ns))
        self._forget()
        return found

    def _step(self, t_ns: int, target: int, *, slips: bool) -> list[Bounds]:
        found = self._settle(t_ns)
        if target != self._gear:
            if self._open is not None:
                found.append(replace(self._open, end_ns=t_ns, end_reason=EndReason.ABANDONED))
            begins = self._gear >= 1 and target >= 1
            self._open = Bounds(self._gear, target, t_ns, t_ns, EndReason.INTERRUPTED) if begins else None
            self._gear, self._has_slipped, self._closed_ns = target, False, None
        self._has_slipped |= slips
        if slips:
            self._closed_ns = None
        elif self._closed_ns is None:
            self._closed_ns = t_ns
        return found

    def _settle(self, now_ns: int) -> list[Bounds]:
        """Return the open shift if its clutch has been closed for long enough by now, or the shift takes too long."""
        if self._open is None:
            return []
        deadline_ns = self._open.start_ns + MAX_SHIFT_NS
        closed_ns = self._closed_ns if self._has_slipped else None
        if closed_ns is not None and closed_ns + DWELL_NS <= min(now_ns, deadline_ns):
            ended = replace(self._open, end_ns=closed_ns, end_reason=EndReason.COMPLETE)
        elif now_ns > deadline_ns:
            ended = replace(self._open, end_ns=deadline_ns, end_reason=EndReason.TOO_LONG)
        else:
            return []
        self._open = None
        return [ended]


class EngagedGear(Protocol):
    """Tells which gear is engaged."""

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The signals that it takes."""

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

    def follow(self, samples: Samples, until_ns: int) -> list[Bounds]:
        """Walk the gears with ``t < until_ns``."""
        series = {name: samples(name, until_ns) for name in self._engaged.signals}
        t_ns = np.unique(np.concatenate([one.t_ns for one in series.values()]))
        found: list[Bounds] = []
        if len(t_ns):
            values = {name: held_values(one, t_ns, self._last.get(name, np.nan)) for name, one in series.items()}
            self._last = {name: float(value[-1]) for name, value in values.items()}
            gears = self._engaged.gears(values)
            for row in np.flatnonzero(np.diff(gears, prepend=-1)):
                found += self._step(int(t_ns[row]), int(gears[row]))
        return [*found, *self._settle(until_ns)]

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Forget the stretch; what it left open is no shift that is known."""
        found = self._settle(now_ns)
        self._forget()
        return found

    def _step(self, t_ns: int, matched: int) -> list[Bounds]:
        found = self._settle(t_ns)
        if matched != self._seen:
            if self._gear >= 1 and self._seen == self._gear and self._left_ns is None:
                self._left_ns = t_ns
            self._seen, self._seen_ns = matched, t_ns
        return found

    def _settle(self, now_ns: int) -> list[Bounds]:
        """Take the ratio that is there for a gear once it has stayed; return the shift that led to it."""
        if self._seen >= 1 and now_ns >= self._seen_ns + DWELL_NS:
            came_from, left_ns = self._gear, self._left_ns
            self._gear, self._left_ns = self._seen, None
            if left_ns is not None and came_from != self._seen and self._seen_ns + DWELL_NS <= left_ns + MAX_SHIFT_NS:
                return [Bounds(came_from, self._seen, left_ns, self._seen_ns, EndReason.COMPLETE)]
        elif self._left_ns is not None and now_ns > self._left_ns + MAX_SHIFT_NS:
            self._gear, self._left_ns = 0, None  # neutral, or standing
        return []


def held_values(series: Series, t_ns: Int64Array, before: float) -> FloatArray:
    """Return the value in force at each time: the latest sample, or the one known ``before`` the first."""
    held = np.concatenate(((before,), series.value))
    return held[np.searchsorted(series.t_ns, t_ns, side="right")]
