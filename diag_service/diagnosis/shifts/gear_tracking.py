"""When gears change: from current and target gear, from the target and the slip, or from the engaged gear alone.

A tracker walks along the samples once, in steps of any size, and reports the bounds of the shifts it saw end.
"""

import math
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace
from itertools import pairwise

import numpy as np

from canlog.arrays import FloatArray, Int64Array
from canlog.frames import BEFORE_ALL_NS
from clutch_model.calibration import clutch_of_gear
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.shifts.tracking import NS_PER_S, Bounds, HeldSignals, SampleHistory, Tracker, held_values

MAX_SHIFT_NS = 5 * NS_PER_S  # a production shift takes about one second
MAX_LAUNCH_NS = 15 * NS_PER_S  # three seconds, on a hill with a trailer ten
ROLLING_RATIO = 0.5  # of the engine's speed: a shaft that turns as fast is not set in motion by its clutch
DWELL_NS = NS_PER_S // 20  # a clutch that stays closed, a ratio that stays put, for so long does so for good
CLOSED_SLIP_RAD_S = 5.0  # 50 rpm: beyond it the clutch slips, whatever two controllers' speeds differ by
CLOSED_RATIO = 0.02  # of the engine's speed, where a ratio stands for the input shaft: wheels slip, columns are skewed
RATIO_TOLERANCE = 0.04  # neighbouring gears are at least 15 % apart
MIN_SPEED_RAD_S = 50.0  # of the engine: below it drives nothing

_GEAR_PAIR = (Signal.CURRENT_GEAR, Signal.TARGET_GEAR)
GearsOf = Callable[[Mapping[Signal, FloatArray]], Int64Array]


def tracker_for(signals: AbstractSet[Signal], gears: GearRatios | None = None) -> Tracker:
    """Return the tracker that makes the most of the signals that a bus can deliver."""
    if Signal.TARGET_GEAR in signals and Signal.CURRENT_GEAR not in signals:
        inputs = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
        if not signals >= set(inputs):
            inputs = (Signal.INPUT_SPEED, Signal.INPUT_SPEED)
        if gears is not None and not signals >= set(inputs):
            return TargetTracker((gears.over, gears.over), gears.ratios)
        return TargetTracker(inputs)
    if Signal.CURRENT_GEAR not in signals and gears is not None:
        return EngagedTracker((Signal.ENGINE_SPEED, gears.over), lambda values: gears_of_ratio(values, gears))
    return GearPairTracker()


def gears_of_ratio(values: Mapping[Signal, FloatArray], gears: GearRatios) -> Int64Array:
    """Return the gear whose ratio engine speed and the other one have, shape (n,); 0 for none."""
    engine_rad_s, over = values[Signal.ENGINE_SPEED], values[gears.over]
    drives = (engine_rad_s > MIN_SPEED_RAD_S) & (over > 0.0)
    ratio = np.divide(engine_rad_s, over, out=np.zeros(len(over)), where=drives)
    off = np.abs(ratio[:, None] / np.array(gears.ratios) - 1.0)
    nearest = np.argmin(off, axis=1)
    matches = off[np.arange(len(off)), nearest] < RATIO_TOLERANCE
    return np.where(matches, nearest + 1, 0)


class LaunchTracker:
    """A launch lasts from the last moment of standing, or of the slowest rolling, until the engine drives in a gear.

    It is found by engine speed, a speed behind the gears and their ratios alone, where neither slip nor load is known,
    and only at its end: what never locks is none. Of a car that rolls the shaft must be set in motion by its clutch.

    Parameters
    ----------
    gears : GearRatios
        Of the car.
    gear : Signal, optional
        A gear that the ratio must agree with: a launch in second gear passes the ratio of the first.
    """

    def __init__(self, gears: GearRatios, gear: Signal | None = None) -> None:
        self._gears = gears
        self._stated_gear = gear
        self._held = HeldSignals((Signal.ENGINE_SPEED, gears.over, *([] if gear is None else [gear])))
        self._forget()

    def _forget(self) -> None:
        self._held.forget()
        self._slowest: tuple[int, float, float] | None = None  # since no gear drives: when, engine and other speed then
        self._gear = 0  # what the ratio says now
        self._since_ns = self._now_ns = BEFORE_ALL_NS

    @property
    def open_ns(self) -> int | None:
        is_on = self._slowest is not None and self._now_ns <= self._slowest[0] + MAX_LAUNCH_NS
        return self._slowest[0] if is_on and self._slowest is not None else None

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        t_ns, values = self._held.ahead(history, until_ns)
        self._now_ns = until_ns
        gears, engine_rad_s = gears_of_ratio(values, self._gears), values[Signal.ENGINE_SPEED]
        if self._stated_gear is not None:
            stated = _gears(values[self._stated_gear])
            gears = np.where((stated >= 1) & (stated != gears), 0, gears)
        over = np.nan_to_num(values[self._gears.over], nan=np.inf)
        edges = [*np.flatnonzero(np.diff(gears, prepend=-1)).tolist(), len(gears)]
        ended: list[Bounds] = []
        for begin, end in pairwise(edges):
            ended += self._end_if_due(int(t_ns[begin]))
            if gears[begin] != self._gear:
                self._gear, self._since_ns = int(gears[begin]), int(t_ns[begin])
            if self._gear == 0:
                place = end - 1 - int(np.argmin(over[begin:end][::-1]))  # the last of the slowest
                if over[place] <= (math.inf if self._slowest is None else self._slowest[2]):
                    self._slowest = int(t_ns[place]), float(engine_rad_s[place]), float(over[place])
        return [*ended, *self._end_if_due(until_ns)]

    def interrupt(self, _: SampleHistory, now_ns: int) -> list[Bounds]:
        """Forget the stretch; what has not locked is no launch."""
        ended = self._end_if_due(now_ns)
        self._forget()
        return ended

    def _end_if_due(self, now_ns: int) -> list[Bounds]:
        """Return the launch that led to the gear which has driven for long enough by now, if it was one."""
        if self._slowest is None or self._gear < 1 or now_ns < self._since_ns + DWELL_NS:
            return []
        (start_ns, engine_rad_s, over), self._slowest = self._slowest, None
        is_set_in_motion = over * self._gears.ratios[self._gear - 1] < ROLLING_RATIO * engine_rad_s
        if not is_set_in_motion or self._since_ns > start_ns + MAX_LAUNCH_NS:
            return []
        return [Bounds(self._gear, self._gear, start_ns, self._since_ns, EndReason.COMPLETE, EventKind.LAUNCH)]


def _gears(values: FloatArray) -> Int64Array:
    """Return gears as numbers, 0 while unknown."""
    return np.nan_to_num(values).astype(np.int64)


class EngagedTracker:
    """A shift lasts from when one gear is no longer engaged until another one stays engaged.

    It is known only at its end: a stretch that ends between two gears tells of no shift. Which gear is engaged a
    function says from the values of some signals, below 1 for none.
    """

    def __init__(self, signals: tuple[Signal, ...], gears_of: GearsOf) -> None:
        self._held = HeldSignals(signals)
        self._gears_of = gears_of
        self._forget()

    def _forget(self) -> None:
        self._held.forget()
        self._gear = 0  # the gear that was engaged last
        self._left_ns: int | None = None  # since when it is not
        self._present = 0  # the gear that is engaged now
        self._present_ns = 0

    @property
    def open_ns(self) -> int | None:
        """When the last gear was left, if it was."""
        return self._left_ns

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        t_ns, values = self._held.ahead(history, until_ns)
        gears = self._gears_of(values)
        ended: list[Bounds] = []
        for row in np.flatnonzero(np.diff(gears, prepend=-1)):
            ended += self._step(int(t_ns[row]), int(gears[row]))
        return [*ended, *self._end_if_due(until_ns)]

    def interrupt(self, _: SampleHistory, now_ns: int) -> list[Bounds]:
        """Forget the stretch; what it left open is no shift that is known."""
        ended = self._end_if_due(now_ns)
        self._forget()
        return ended

    def _step(self, t_ns: int, matched: int) -> list[Bounds]:
        ended = self._end_if_due(t_ns)
        if matched != self._present:
            if self._gear >= 1 and self._present == self._gear and self._left_ns is None:
                self._left_ns = t_ns
            self._present, self._present_ns = matched, t_ns
        return ended

    def _end_if_due(self, now_ns: int) -> list[Bounds]:
        """Return the shift that led to the gear which has stayed engaged for long enough by now, if there is one."""
        if self._present >= 1 and now_ns >= self._present_ns + DWELL_NS:
            came_from, left_ns = self._gear, self._left_ns
            self._gear, self._left_ns = self._present, None
            if (
                left_ns is not None
                and came_from != self._present
                and self._present_ns + DWELL_NS <= left_ns + MAX_SHIFT_NS
            ):
                return [Bounds(came_from, self._present, left_ns, self._present_ns, EndReason.COMPLETE)]
        elif self._left_ns is not None and now_ns > self._left_ns + MAX_SHIFT_NS:
            self._gear, self._left_ns = 0, None  # neutral, or standing
        return []


class GearPairTracker:
    """A shift lasts from the first sample whose target gear differs from the current one until they agree again.

    As long as no target gear has come, a change of the current gear is all that tells of a shift. A shift that is on
    when both gears are first known began nobody knows when: it ends as interrupted.
    """

    def __init__(self) -> None:
        self._lone = EngagedTracker((Signal.CURRENT_GEAR,), lambda values: _gears(values[Signal.CURRENT_GEAR]))
        self._forget()

    def _forget(self) -> None:
        self._has_target = False
        self._pair = np.full((2, 1), np.nan)  # current and target gear as last seen
        self._open: Bounds | None = None
        self._is_begun = False  # the beginning of the open shift was seen
        self._overdue = False  # the open shift was reported as too long; wait until the gears agree

    @property
    def open_ns(self) -> int | None:
        return self._lone.open_ns if self._open is None else self._open.start_ns

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        ended: list[Bounds] = []
        if not self._has_target:
            target_ns = history.ahead(Signal.TARGET_GEAR, until_ns).t_ns
            self._has_target = len(target_ns) > 0
            ended += self._lone.track(history, int(target_ns[0]) if self._has_target else until_ns)
            if self._has_target:
                ended += self._lone.interrupt(history, int(target_ns[0]))
        if any(map(history.has_change_ahead, _GEAR_PAIR)):
            ended += self._walk(history, until_ns)
        return [*ended, *self._end_overdue(until_ns)]

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        ended = [*self._lone.interrupt(history, now_ns), *self._end(now_ns, EndReason.INTERRUPTED)]
        self._forget()
        return ended

    def _walk(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        """Step through the pairs that differ from the ones before."""
        current, target = (history.ahead(signal, until_ns) for signal in _GEAR_PAIR)
        t_ns = np.union1d(current.t_ns, target.t_ns)
        held = [held_values(series, t_ns, last) for series, (last,) in zip((current, target), self._pair, strict=True)]
        values = np.hstack([self._pair, held])
        self._pair, gears = values[:, -1:], _gears(values)
        is_known = ~np.isnan(values).any(axis=0)
        rows = np.flatnonzero((gears[:, 1:] != gears[:, :-1]).any(axis=0))
        pairs = zip(t_ns[rows].tolist(), gears[:, rows + 1].T.tolist(), is_known[rows].tolist(), strict=True)
        ended: list[Bounds] = []
        for now_ns, (current_gear, target_gear), was_known in pairs:
            ended += self._step(now_ns, current_gear, target_gear, was_known=was_known)
        return ended

    def _step(self, t_ns: int, current: int, target: int, *, was_known: bool) -> list[Bounds]:
        ended = self._end_overdue(t_ns)
        if current < 1 or target < 1:
            return [*ended, *self._end(t_ns, EndReason.ABANDONED)]
        if self._open is not None and (target != self._open.to_gear or current != self._open.from_gear):
            reached = current == target == self._open.to_gear
            ended += self._end(t_ns, EndReason.COMPLETE if reached else EndReason.ABANDONED)
        if current == target:
            self._overdue = False
        elif self._open is None and not self._overdue:
            self._open = Bounds(current, target, t_ns, t_ns, EndReason.INTERRUPTED)
            self._is_begun = was_known
        return ended

    def _end(self, t_ns: int, reason: EndReason) -> list[Bounds]:
        ended, self._open = self._open, None
        if reason is EndReason.COMPLETE and not self._is_begun:
            reason = EndReason.INTERRUPTED
        return [] if ended is None else [replace(ended, end_ns=t_ns, end_reason=reason)]

    def _end_overdue(self, now_ns: int) -> list[Bounds]:
        if self._open is None or now_ns <= self._open.start_ns + MAX_SHIFT_NS:
            return []
        self._overdue = True
        return self._end(self._open.start_ns + MAX_SHIFT_NS, EndReason.TOO_LONG)


class TargetTracker:
    """A shift lasts from a change of the target gear until the slip of the on-coming clutch, once open, stays closed.

    Parameters
    ----------
    inputs : tuple of Signal
        Input speeds of the odd and of the even gears; the same signal twice where the bus has but one.
    ratios : tuple of float
        Of input speed over that signal in every gear, where the signal is a speed behind the gears.
    """

    def __init__(self, inputs: tuple[Signal, Signal], ratios: tuple[float, ...] = ()) -> None:
        self._inputs = inputs
        self._ratios = np.array([math.nan, *ratios]) if ratios else None  # neutral first
        self._held = HeldSignals((Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *inputs))
        self._forget()

    def _forget(self) -> None:
        self._held.forget()
        self._gear = 0
        self._open: Bounds | None = None
        self._has_slipped = False
        self._closed_ns: int | None = None  # since when the clutch has not slipped

    @property
    def open_ns(self) -> int | None:
        return None if self._open is None else self._open.start_ns

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        t_ns, values = self._held.ahead(history, until_ns)
        target = _gears(values[Signal.TARGET_GEAR])
        engine_rad_s = values[Signal.ENGINE_SPEED]
        shaft_rad_s = np.where(clutch_of_gear(target) == 1, *(values[name] for name in self._inputs))
        bound_rad_s: FloatArray | float = CLOSED_SLIP_RAD_S
        if self._ratios is not None:
            shaft_rad_s = shaft_rad_s * self._ratios[np.where(target < len(self._ratios), target, 0)]
            bound_rad_s = np.maximum(CLOSED_SLIP_RAD_S, CLOSED_RATIO * engine_rad_s)
        state = 2 * target + (np.abs(engine_rad_s - shaft_rad_s) > bound_rad_s)  # an unknown slip counts as closed
        is_open = (shaft_rad_s < ROLLING_RATIO * engine_rad_s) & (self._ratios is not None)
        ended: list[Bounds] = []
        for row in np.flatnonzero(np.diff(state, prepend=-1)):
            ended += self._step(int(t_ns[row]), int(target[row]), slips=bool(state[row] % 2))
            if self._open is not None and self._open.start_ns == t_ns[row] and is_open[row]:
                ended.append(replace(self._open, end_reason=EndReason.COMPLETE, kind=EventKind.REGEAR))
                self._open = None  # nothing drove: the gear is chosen for the launch to come
        return [*ended, *self._end_if_due(until_ns)]

    def interrupt(self, _: SampleHistory, now_ns: int) -> list[Bounds]:
        ended = self._end_if_due(now_ns)
        if self._open is not None:
            ended.append(replace(self._open, end_ns=now_ns))
        self._forget()
        return ended

    def _step(self, t_ns: int, target: int, *, slips: bool) -> list[Bounds]:
        ended = self._end_if_due(t_ns)
        if target != self._gear:
            if self._open is not None:
                ended.append(replace(self._open, end_ns=t_ns, end_reason=EndReason.ABANDONED))
            begins = self._gear >= 1 and target >= 1
            self._open = Bounds(self._gear, target, t_ns, t_ns, EndReason.INTERRUPTED) if begins else None
            self._gear, self._has_slipped, self._closed_ns = target, False, None
        self._has_slipped |= slips
        if slips:
            self._closed_ns = None
        elif self._closed_ns is None:
            self._closed_ns = t_ns
        return ended

    def _end_if_due(self, now_ns: int) -> list[Bounds]:
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
