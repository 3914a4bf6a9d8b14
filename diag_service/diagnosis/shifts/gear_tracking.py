"""When gears change: from current and target gear, from the target and the slip, or from the ratio of speeds.

A tracker walks along the samples once, in steps of any size, and reports the bounds of the shifts it saw end.
"""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np

from canlog.series import Series
from clutch_model.gears import clutch_of_gear
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.events import EndReason
from diag_service.diagnosis.shifts.engaged_gear import CurrentGear, EngagedTracker, RatioGear
from diag_service.diagnosis.shifts.history import Ahead
from diag_service.diagnosis.shifts.shift_bounds import DWELL_NS, MAX_SHIFT_NS, Bounds, GearTracker, held_values

_BOTH_GEARS = frozenset({Signal.CURRENT_GEAR, Signal.TARGET_GEAR})
CLOSED_SLIP_RAD_S = 5.0  # 50 rpm: beyond it the clutch slips, whatever two controllers' speeds differ by


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

    As long as no target gear has come, a change of the current gear is all that tells of a shift. A shift that is on
    when both gears are first known began nobody knows when: it ends as interrupted.
    """

    def __init__(self) -> None:
        self._lone = EngagedTracker(CurrentGear())
        self._has_target = False
        self._gears = _Gears()
        self._first_ns: dict[Signal, int] = {}  # when each gear came first
        self._open: Bounds | None = None
        self._is_begun = False  # the beginning of the open shift was seen
        self._overdue = False  # the open shift was reported as too long; wait until the gears agree
        self._closed: list[Bounds] = []

    @property
    def open_ns(self) -> int | None:
        """When the open shift began, if there is one."""
        return self._lone.open_ns if self._open is None else self._open.start_ns

    def track(self, ahead: Ahead, until_ns: int) -> list[Bounds]:
        """Walk the gear changes with ``t < until_ns``."""
        if self._has_target and not any(map(ahead.has_change, _BOTH_GEARS)):
            self._close_overdue(until_ns)
            return self._pop_closed()
        current = ahead.until(Signal.CURRENT_GEAR, until_ns)
        target = ahead.until(Signal.TARGET_GEAR, until_ns)
        self._note_first(current, target)
        if not self._has_target:
            self._closed += self._lone.track(ahead, int(target.t_ns[0]) if len(target.t_ns) else until_ns)
            self._has_target = len(target.t_ns) > 0
            if self._has_target:
                self._closed += self._lone.interrupt(int(target.t_ns[0]))
        self._walk(current, target)
        self._close_overdue(until_ns)
        return self._pop_closed()

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Return the open shift as interrupted."""
        self._closed += self._lone.interrupt(now_ns)
        self._close(now_ns, EndReason.INTERRUPTED)
        self._gears, self._has_target = _Gears(), False
        self._first_ns.clear()
        self._overdue = False
        return self._pop_closed()

    def _pop_closed(self) -> list[Bounds]:
        closed, self._closed = self._closed, []
        return closed

    def _note_first(self, current: Series, target: Series) -> None:
        for signal, series in ((Signal.CURRENT_GEAR, current), (Signal.TARGET_GEAR, target)):
            if signal not in self._first_ns and len(series.t_ns):
                self._first_ns[signal] = int(series.t_ns[0])

    def _walk(self, current: Series, target: Series) -> None:
        """Step through the gears that differ from the last ones."""
        changed: dict[int, dict[str, int]] = {}
        for name, series, before in (
            ("current", current, self._gears.current),
            ("target", target, self._gears.target),
        ):
            values = series.value.astype(np.int64)
            for row in np.flatnonzero(np.diff(values, prepend=before)).tolist():
                changed.setdefault(int(series.t_ns[row]), {})[name] = int(values[row])
        for t_ns, gears in sorted(changed.items()):
            self._close_overdue(t_ns)
            self._step(t_ns, replace(self._gears, **gears))

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
            self._is_begun = t_ns > max(self._first_ns.values())

    def _close(self, t_ns: int, reason: EndReason) -> None:
        if self._open is not None:
            if reason is EndReason.COMPLETE and not self._is_begun:
                reason = EndReason.INTERRUPTED
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

    def track(self, ahead: Ahead, until_ns: int) -> list[Bounds]:
        """Walk target gear and slip with ``t < until_ns``."""
        names = tuple(dict.fromkeys((Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *self._inputs)))
        series = {name: ahead.until(name, until_ns) for name in names}
        t_ns = np.unique(np.concatenate([one.t_ns for one in series.values()]))
        values = {name: held_values(one, t_ns, self._last.get(name, np.nan)) for name, one in series.items()}
        found: list[Bounds] = []
        if len(t_ns):
            self._last = {name: float(value[-1]) for name, value in values.items()}
            target = np.nan_to_num(values[Signal.TARGET_GEAR]).astype(np.int64)
            first, second = (np.abs(values[Signal.ENGINE_SPEED] - values[name]) for name in self._inputs)
            slip_rad_s = np.where(clutch_of_gear(target) == 1, first, second)
            state = 2 * target + (slip_rad_s > CLOSED_SLIP_RAD_S)  # an unknown slip counts as closed
            changes = np.flatnonzero(np.diff(state, prepend=-1))
            for row in changes:
                found += self._step(int(t_ns[row]), int(target[row]), slips=bool(state[row] % 2))
        return [*found, *self._end_if_due(until_ns)]

    def interrupt(self, now_ns: int) -> list[Bounds]:
        """Return the open shift as interrupted."""
        found = self._end_if_due(now_ns)
        if self._open is not None:
            found.append(replace(self._open, end_ns=now_ns))
        self._forget()
        return found

    def _step(self, t_ns: int, target: int, *, slips: bool) -> list[Bounds]:
        found = self._end_if_due(t_ns)
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
