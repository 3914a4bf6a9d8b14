"""Detection of gear changes and of what slips without one: canonical columns in, events out.

A tracker of gears says between which gears and when; the slip says how long a clutch worked. A change of gears ends
when the slip under load that reaches beyond it ends; slip that began shortly before is part of it too. Slip that does
not end is more likely a speed sensor's: then the gears alone say when the change ended. What slips without a change of
gears is a launch, a creep, a clutch that closes onto a rolling car, or one that lets go in gear.
"""

import math
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from enum import IntEnum
from operator import attrgetter
from typing import Final

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import share_rows
from clutch_model.calibration import Calibration, clutch_of_gear
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import DriveState, EngineState, GearRatios, Signal
from diag_service.diagnosis.shifts.gear_tracking import ROLLING_RATIO, GearPairTracker, LaunchTracker, tracker_for
from diag_service.diagnosis.shifts.tracking import NS_PER_S, Bounds, EventFinder, SampleHistory, Tracker, held_values

SLIP_RAD_S: Final = 5.0  # 50 rpm: beyond it a clutch slips, whatever two controllers' speeds differ by
ROWS_APART: Final = 2.0  # times what a speed changed from row to row lately: it may change faster until the next one
HELD_ROWS: Final = 4  # a value may be held for so many
LOADED_PA: Final = 0.15e5  # above the touch point: three times what touch point and zero are known to
LOADED_NM: Final = 5.0  # asked for: what is less does not move a car
PEDAL_RATIO: Final = 0.02  # beyond it a foot is on the pedal, below it may be the zero of its sensor
PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)
_TORQUES: Final = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
_TORQUE: Final = (Signal.CLUTCH_TORQUE, Signal.CLUTCH_TORQUE)
SHAFTS: Final = (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)
_SHAFT: Final = (Signal.INPUT_SPEED, Signal.INPUT_SPEED)

_SHAFTS_ROW: Final = 0  # of held values, and what follows: where the signals of both clutches begin, or one stands
_LOADS_ROW: Final = 2
_GEAR_ROW: Final = 4
_PEDAL_ROW: Final = 5
_STATE_ROW: Final = 6
_STATE_SIZE: Final = 4  # grip, grip of the gear's clutch, gear, whether force is asked for
_NOTHING_YET: Final = -2


class Grip(IntEnum):
    """What the clutches do."""

    OPEN = 0  # no clutch is loaded
    LOCKED = 1  # a clutch is loaded, and none that is slips
    SLIPPING = 2  # a clutch slips under load


_OPEN, _LOCKED, _SLIPPING = (int(member) for member in Grip)  # compiled functions know no enumerations
_CREEPING: Final = int(DriveState.CREEPING)


@dataclass(frozen=True, slots=True)
class GripChange:
    """From when on the clutches do something else, or the driver asks for something else."""

    t_ns: int
    grip: Grip  # of both clutches: one may be filled for the next gear while the other one carries
    gear_grip: Grip  # of the clutch of the gear alone
    gear: int  # 0 where no gear is known
    is_asked: bool | None  # whether the car shall be set in motion; None: unknown
    engine_rad_s: float
    shaft_rad_s: float  # of the gear


@dataclass(frozen=True, slots=True, kw_only=True)
class SlipSignals:
    """Where a bus tells of slip and load."""

    engine: Signal
    shafts: tuple[Signal, Signal]
    loads: tuple[Signal, Signal]
    loaded_above: tuple[float, float]  # in the unit of the loads
    gear: Signal

    @property
    def held(self) -> tuple[Signal, ...]:
        """All signals but that of the engine's side, those that may be missing included, in the order of their rows."""
        return (*self.shafts, *self.loads, self.gear, Signal.PEDAL, Signal.DRIVE_STATE)

    @property
    def are_shared(self) -> bool:
        """Whether one signal stands for both clutches: it speaks of that of the gear."""
        return self.loads[0] is self.loads[1] or self.shafts[0] is self.shafts[1]


def slip_signals(signals: AbstractSet[Signal], calibration: Calibration) -> SlipSignals | None:
    """Return where slip and load are told, or None if they are not."""
    first, second = (clutch.touch_pressure_pa + LOADED_PA for clutch in calibration.clutches)
    engine = next((signal for signal in (Signal.HUB_SPEED, Signal.ENGINE_SPEED) if signal in signals), None)
    shafts = next((pair for pair in (SHAFTS, _SHAFT) if signals >= set(pair)), None)
    loads = next((pair for pair in (PRESSURES, _TORQUES, _TORQUE) if signals >= set(pair)), None)
    gear = next((signal for signal in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR) if signal in signals), None)
    if engine is None or shafts is None or loads is None or gear is None:
        return None
    above = (first, second) if loads is PRESSURES else (LOADED_NM, LOADED_NM)
    return SlipSignals(engine=engine, shafts=shafts, loads=loads, loaded_above=above, gear=gear)


class SlipTracker:
    """Walks the samples of the engine's side, in steps of any size, and reports what changes."""

    def __init__(self, signals: SlipSignals) -> None:
        self._signals = signals
        self._held = signals.held
        self.forget()

    def forget(self) -> None:
        self._last = [math.nan] * len(self._held)
        self._doing = np.full((_STATE_SIZE, 1), _NOTHING_YET)
        self._rows = np.empty((1 + _LOADS_ROW, 0))  # engine and shafts, in the last rows of a table

    def track(self, history: SampleHistory, until_ns: int) -> list[GripChange]:
        engine = history.ahead(self._signals.engine, until_ns)
        held = np.empty((len(self._held), len(engine.t_ns)))
        for row, signal in enumerate(self._held):
            series = history.ahead(signal, until_ns)
            held[row] = held_values(series, engine.t_ns, self._last[row])
            if len(series.value):
                self._last[row] = float(series.value[-1])
        if len(engine.t_ns) and engine.sequence[0] < 0:
            self._forgive_rows(history, engine, held, until_ns)
        return self._changes(engine.t_ns, engine.value, held)

    def _forgive_rows(self, history: SampleHistory, engine: Series, held: FloatArray, until_ns: int) -> None:
        """Take for locked what the columns of a table, asked one after the other, may be apart within a row."""
        others = [history.ahead(signal, until_ns) for signal in (self._signals.shafts[0], self._signals.loads[0])]
        rows = np.hstack([self._rows, np.vstack([engine.value, held[:_LOADS_ROW]])])
        before, self._rows = self._rows.shape[1], rows[:, -HELD_ROWS - 1 :].copy()
        if not share_rows([engine, *others]):
            return
        changes_rad_s = np.nan_to_num(np.abs(np.diff(rows, prepend=rows[:, :1])))
        changing_rad_s = np.max(
            [np.pad(changes_rad_s, ((0, 0), (back, 0)))[:, : rows.shape[1]] for back in range(HELD_ROWS)], axis=0
        )[:, before:]
        for shaft, changing in zip(held[:_LOADS_ROW], changing_rad_s[1:], strict=True):
            apart_rad_s = ROWS_APART * np.maximum(changing, changing_rad_s[0])
            is_locked = np.abs(engine.value - shaft) < apart_rad_s
            shaft[is_locked] = engine.value[is_locked]

    def _changes(self, t_ns: Int64Array, engine_rad_s: FloatArray, held: FloatArray) -> list[GripChange]:
        states = _states(engine_rad_s, held, self._signals.loaded_above, are_shared=self._signals.are_shared)
        since = np.hstack([self._doing, states])
        self._doing = since[:, -1:]
        rows = np.flatnonzero((since[:, 1:] != since[:, :-1]).any(axis=0))
        return [
            GripChange(
                t_ns=int(t_ns[row]),
                grip=Grip(grip),
                gear_grip=Grip(gear_grip),
                gear=gear,
                is_asked=None if asked < 0 else bool(asked),
                engine_rad_s=float(engine_rad_s[row]),
                shaft_rad_s=float(held[_SHAFTS_ROW + clutch_of_gear(gear) - 1, row]),
            )
            for row, (grip, gear_grip, gear, asked) in zip(rows.tolist(), states[:, rows].T.tolist(), strict=True)
        ]


def _states(engine_rad_s: FloatArray, held: FloatArray, above: tuple[float, float], *, are_shared: bool) -> Int64Array:
    """Return what the clutches do and what the driver asks for, shape (_STATE_SIZE, n).

    An unknown value tells neither of slip nor of load. Whether force is asked for is -1 while unknown; the
    transmission's own word counts first.
    """
    gear = np.nan_to_num(held[_GEAR_ROW]).astype(np.int64)
    is_of_gear = clutch_of_gear(gear) == np.array([[1], [2]])
    is_loaded = held[_LOADS_ROW:_GEAR_ROW] > np.array(above)[:, np.newaxis]
    if are_shared:
        is_loaded &= is_of_gear
    slips = np.abs(engine_rad_s - held[_SHAFTS_ROW:_LOADS_ROW]) > SLIP_RAD_S
    grips = np.where(is_loaded, np.where(slips, _SLIPPING, _LOCKED), _OPEN)
    gear_grip = np.where(is_of_gear & (gear >= 1), grips, _OPEN).max(axis=0)
    pedal_ratio = held[_PEDAL_ROW]
    asked = np.where(np.isnan(pedal_ratio), -1, pedal_ratio > PEDAL_RATIO)
    asked[held[_STATE_ROW] == _CREEPING] = 0
    return np.stack([grips.max(axis=0), gear_grip, gear, asked])


SETTLE_NS: Final = NS_PER_S // 20  # after a change of gears: slip that begins so soon belongs to it
PRELUDE_NS: Final = 3 * NS_PER_S // 10  # the off-going clutch slips so long before a change is shown, no launch does
LEAST_PRELUDE_NS: Final = 3 * NS_PER_S // 100  # three samples; what is shorter may be the same moment in two messages
LOCK_NS: Final = NS_PER_S  # the last of the slip is led down softly, swings of the driveline may open a clutch again
DWELL_NS: Final = 3 * NS_PER_S // 20  # a clutch that carries nothing for so long was let go
LIFTED_NS: Final = NS_PER_S // 2  # a clutch may carry nothing so long while the foot stays on the pedal
LOCKED_NS: Final = NS_PER_S // 2  # a clutch that begins to carry may stick for a moment; in gear it does for longer
LEAST_SLIP_NS: Final = NS_PER_S // 5  # without a change of gears: a clutch that opens slips for a moment
LOW_RAD_S: Final = 130.0  # of the engine: near idle a clutch is let slip on purpose, above it a locked one must hold
MAX_SLIP_NS: Final = 15 * NS_PER_S  # a launch takes three seconds, on a hill with a trailer ten
MAX_TAIL_NS: Final = 2 * NS_PER_S  # a clutch that works so long after its gear is engaged does not lock
_UNKNOWN: Final = GripChange(
    t_ns=0, grip=Grip.OPEN, gear_grip=Grip.OPEN, gear=0, is_asked=None, engine_rad_s=0.0, shaft_rad_s=0.0
)
PULLING_NM: Final = 8.0  # engine torque from which it drives the car: what friction and auxiliaries may hide
DRIVING_RATIO: Final = 0.06  # of the pedal: beyond it a foot asks for force, below it the engine may brake
KICKDOWN_RATIO: Final = 0.5  # of the pedal
RECENT_NS: Final = NS_PER_S // 10  # before the change: torque is its mean, pedal its movement over so long
_SKIPPED: Final = 2  # gears down at once


def kind_of_change(history: SampleHistory, bounds: Bounds) -> EventKind:
    """Return the kind of a change of gears; a plain shift where neither torque nor pedal is known."""
    pedal_ratio = _latest(history, Signal.PEDAL, bounds.start_ns)
    torque_nm = _torque_nm(history, bounds.start_ns)
    if pedal_ratio is None and torque_nm is None:
        return EventKind.SHIFT
    pedal = history.samples(Signal.PEDAL, bounds.start_ns - RECENT_NS, bounds.start_ns + 1).value
    is_lifting = len(pedal) > 0 and bool(pedal[-1] < pedal[0] - PEDAL_RATIO)  # as the change begins
    is_asked = _is_asked(pedal_ratio, torque_nm, is_lifting=is_lifting)
    if bounds.to_gear > bounds.from_gear:
        is_pulling = is_asked and (torque_nm is None or torque_nm > PULLING_NM)
        return EventKind.POWER_ON_UPSHIFT if is_pulling else EventKind.POWER_OFF_UPSHIFT
    if bounds.from_gear - bounds.to_gear >= _SKIPPED:
        return EventKind.POWER_ON_SKIP if is_asked else EventKind.COAST_SKIP
    if not is_asked:
        return EventKind.COAST_DOWNSHIFT
    is_floored = pedal_ratio is not None and pedal_ratio > KICKDOWN_RATIO
    return EventKind.KICKDOWN if is_floored else EventKind.POWER_ON_DOWNSHIFT


def _is_asked(pedal_ratio: float | None, torque_nm: float | None, *, is_lifting: bool) -> bool:
    """Return whether the driver wants the engine to drive the car, as far as pedal and torque are known."""
    is_pulling = torque_nm is not None and torque_nm > PULLING_NM
    if pedal_ratio is None:
        return is_pulling
    if pedal_ratio > DRIVING_RATIO:
        return True  # torque follows later
    return is_pulling and pedal_ratio > PEDAL_RATIO and not is_lifting  # torque outlasts the foot for a moment


def _torque_nm(history: SampleHistory, start_ns: int) -> float | None:
    """Return the engine's torque just before a change; none while its fuel is cut."""
    if _latest(history, Signal.ENGINE_STATE, start_ns) == EngineState.FUEL_CUT:
        return 0.0
    recent = history.samples(Signal.ENGINE_TORQUE, start_ns - RECENT_NS, start_ns + 1).value
    return float(np.mean(recent)) if len(recent) else None


def _latest(history: SampleHistory, signal: Signal, t_ns: int) -> float | None:
    """Return the value of a signal at a time, as far back as is certain to be kept."""
    recent = history.samples(signal, t_ns - NS_PER_S // 2, t_ns + 1).value
    return float(recent[-1]) if len(recent) else None


@dataclass(frozen=True, slots=True)
class _Slip:
    """A clutch has begun to slip without a change of gears."""

    start_ns: int
    kind: EventKind
    gear: int
    end_ns: int | None = None  # since when it does not slip; None: it does
    is_closed: bool = False  # the clutch still carried as its slip ended: what is led so softly may look open later


@dataclass(frozen=True, slots=True)
class _Change:
    """A change of gears whose gears agree again."""

    bounds: Bounds
    is_slipping: bool  # beyond its end
    closed_ns: int | None = None  # since when it does not, if it did


class EventTracker:
    """Joins the events of a tracker of gears with the slip; reports them in order, however the stream is cut."""

    def __init__(self, gears: Tracker, slip: SlipTracker | None) -> None:
        self._gears = gears
        self._slip_tracker = slip
        self._forget()

    def _forget(self) -> None:
        if self._slip_tracker is not None:
            self._slip_tracker.forget()
        self._changes: list[Bounds] = []  # of gears, not yet begun in the walk
        self._grips: list[GripChange] = []
        self._grip = _UNKNOWN
        self._gear_grip_ns = 0  # since when the clutch of the gear does what it does
        self._inside: Bounds | None = None  # the change of gears in which the walk is
        self._was_open = False  # no clutch was loaded as it began, nor has one slipped under load in it
        self._tail: _Change | None = None
        self._slip: _Slip | None = None
        self._is_overdue = False  # the slip was reported as too long; wait until it ends

    @property
    def open_ns(self) -> int | None:
        """When the oldest event began that was not reported, if there is one."""
        starts = [bounds.start_ns for bounds in self._changes]
        starts += [grip.t_ns for grip in self._grips[:1]]
        starts += [part.start_ns for part in (self._inside, self._slip) if part is not None]
        if self._tail is not None:
            starts.append(self._tail.bounds.start_ns)
        if self._gears.open_ns is not None:
            starts.append(self._gears.open_ns)
        return min(starts, default=None)

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        self._changes += self._gears.track(history, until_ns)
        if self._slip_tracker is not None:
            self._grips += self._slip_tracker.track(history, until_ns)
        open_ns = self._gears.open_ns
        return self._walk(history, until_ns if open_ns is None else min(until_ns, open_ns))

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        self._changes += self._gears.interrupt(history, now_ns)
        ended = self._walk(history, now_ns + 1)
        ended += self._end_tail(history)
        if self._inside is not None:
            ended.append(self._named(history, self._inside))
        ended += self._end_slip(now_ns, EndReason.INTERRUPTED)
        self._forget()
        return ended

    def _walk(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        """Go through beginnings and ends of changes and of slip in the order of time, up to what is known."""
        ended: list[Bounds] = []
        while True:
            begin_ns = self._changes[0].start_ns if self._changes else None
            end_ns = None if self._inside is None else self._inside.end_ns
            grip_ns = self._grips[0].t_ns if self._grips else None
            next_ns = min([t_ns for t_ns in (begin_ns, end_ns, grip_ns) if t_ns is not None], default=None)
            if next_ns is None or next_ns >= until_ns:
                break
            ended += self._due(history, next_ns)
            if end_ns == next_ns:
                self._leave()
            elif begin_ns == next_ns:
                ended += self._enter(history, self._changes.pop(0))
            else:
                ended += self._step(self._grips.pop(0))
        return [*ended, *self._due(history, until_ns)]

    def _step(self, change: GripChange) -> list[Bounds]:
        """Take the next change of what the clutches do."""
        before, self._grip = self._grip, change
        was_locked = before.gear_grip is Grip.LOCKED and change.t_ns - self._gear_grip_ns >= LOCKED_NS
        was_locked &= change.engine_rad_s > LOW_RAD_S
        self._gear_grip_ns = self._gear_grip_ns if change.gear_grip is before.gear_grip else change.t_ns
        is_slipping = change.grip is Grip.SLIPPING
        if self._inside is not None:
            self._was_open &= not is_slipping
            return []
        if self._tail is not None and (is_slipping or self._tail.is_slipping):
            closed_ns = None if is_slipping else self._tail.closed_ns or change.t_ns
            self._tail = replace(self._tail, is_slipping=True, closed_ns=closed_ns)
            return []
        if self._is_overdue:
            return []
        return self._slip_step(change, was_locked=was_locked)

    def _slip_step(self, change: GripChange, *, was_locked: bool) -> list[Bounds]:
        """Take a change outside of all changes of gears."""
        is_slipping = change.gear_grip is Grip.SLIPPING
        if self._slip is None:
            if is_slipping:
                kind = EventKind.SLIP if was_locked else _kind_of_slip(change)
                self._slip = _Slip(change.t_ns, kind, change.gear)
            return []
        if self._slip.kind is EventKind.CREEP and change.is_asked and is_slipping:
            ended = self._end_slip(change.t_ns, EndReason.ABANDONED)
            self._slip = _Slip(change.t_ns, EventKind.LAUNCH, change.gear)
            return ended
        if is_slipping:
            self._slip = replace(self._slip, end_ns=None, is_closed=False)
        elif self._slip.end_ns is None:
            self._slip = replace(self._slip, end_ns=change.t_ns, is_closed=change.gear_grip is Grip.LOCKED)
        return []

    def _enter(self, history: SampleHistory, bounds: Bounds) -> list[Bounds]:
        """Begin a change of gears; what was open before ends here."""
        ended = self._end_tail(history)
        if self._slip is not None and bounds.start_ns - self._slip.start_ns >= PRELUDE_NS:
            ended += self._end_slip(bounds.start_ns, self._how_ended(self._slip))
        if self._slip is not None and bounds.start_ns - self._slip.start_ns >= LEAST_PRELUDE_NS:
            bounds = replace(bounds, start_ns=self._slip.start_ns)
        self._slip = None
        self._inside, self._is_overdue = bounds, False
        self._was_open = self._grip is not _UNKNOWN and self._grip.grip is Grip.OPEN
        return ended

    def _leave(self) -> None:
        """End a change as its gears agree again."""
        if self._inside is not None:
            kind = EventKind.REGEAR if self._was_open else self._inside.kind
            is_slipping = self._grip.grip is Grip.SLIPPING and self._grip.gear >= 1
            self._tail = _Change(replace(self._inside, kind=kind), is_slipping)
            self._inside = None

    def _due(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        """Return what has ended for good by now."""
        tail, slip = self._tail, self._slip
        if tail is not None:
            end_ns = tail.bounds.end_ns
            if not tail.is_slipping or tail.closed_ns is not None:
                quiet_ns = end_ns if tail.closed_ns is None else tail.closed_ns
                return self._end_tail(history) if now_ns > quiet_ns + SETTLE_NS else []
            if now_ns > end_ns + MAX_TAIL_NS:
                self._is_overdue = True
                return self._end_tail(history)
        if self._is_overdue and self._grip.grip is not Grip.SLIPPING and now_ns > self._grip.t_ns + DWELL_NS:
            self._is_overdue = False
        if slip is not None and slip.end_ns is not None:
            is_over = now_ns > slip.end_ns + self._dwell_ns(slip)
            return self._end_slip(slip.end_ns + LOCK_NS, self._how_ended(slip)) if is_over else []
        if slip is not None and now_ns > slip.start_ns + MAX_SLIP_NS:
            self._is_overdue = True
            return self._end_slip(slip.start_ns + MAX_SLIP_NS, EndReason.TOO_LONG)
        return []

    def _dwell_ns(self, slip: _Slip) -> int:
        """Return how long a clutch must not slip until that is the end of its slip."""
        if slip.is_closed or self._grip.gear_grip is Grip.LOCKED:
            return LOCK_NS
        return LIFTED_NS if self._grip.is_asked else DWELL_NS

    def _how_ended(self, slip: _Slip) -> EndReason:
        """Return how slip ends now: a creep is over when it is, all else when the clutch is locked."""
        is_locked = slip.is_closed or self._grip.gear_grip is Grip.LOCKED
        is_over = slip.end_ns is not None and (slip.kind is EventKind.CREEP or is_locked)
        return EndReason.COMPLETE if is_over else EndReason.ABANDONED

    def _end_slip(self, end_ns: int, reason: EndReason) -> list[Bounds]:
        """End the slip, if there is any; what sticks at its end belongs to it, what is open does not."""
        slip, self._slip = self._slip, None
        if slip is None:
            return []
        if slip.end_ns is not None and not slip.is_closed and self._grip.gear_grip is not Grip.LOCKED:
            end_ns = slip.end_ns
        if (end_ns if slip.end_ns is None else slip.end_ns) - slip.start_ns < LEAST_SLIP_NS:
            return []
        is_locked = reason is EndReason.COMPLETE and self._grip.gear_grip is Grip.LOCKED
        kind = EventKind.LAUNCH if is_locked and slip.kind is EventKind.CREEP else slip.kind
        return [Bounds(slip.gear, slip.gear, slip.start_ns, end_ns, reason, kind)]

    def _end_tail(self, history: SampleHistory) -> list[Bounds]:
        """Return the change of gears that is over, to the end of its slip if that has ended."""
        tail, self._tail = self._tail, None
        if tail is None:
            return []
        end_ns = tail.bounds.end_ns if tail.closed_ns is None else tail.closed_ns
        return [self._named(history, replace(tail.bounds, end_ns=end_ns))]

    def _named(self, history: SampleHistory, bounds: Bounds) -> Bounds:
        """Return a change of gears with its kind."""
        if bounds.kind is EventKind.REGEAR:
            return bounds
        return replace(bounds, kind=kind_of_change(history, bounds))


_END_NS: Final = attrgetter("end_ns")


class SideBySide:
    """Two trackers of one stream, whose events come in the order of their ends."""

    def __init__(self, first: Tracker, second: Tracker) -> None:
        self._both = first, second

    @property
    def open_ns(self) -> int | None:
        return min((tracker.open_ns for tracker in self._both if tracker.open_ns is not None), default=None)

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        return sorted((bounds for tracker in self._both for bounds in tracker.track(history, until_ns)), key=_END_NS)

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        return sorted((bounds for tracker in self._both for bounds in tracker.interrupt(history, now_ns)), key=_END_NS)


def _kind_of_slip(change: GripChange) -> EventKind:
    """Return what begins as a clutch that was open begins to slip under load."""
    is_rolling = change.shaft_rad_s > ROLLING_RATIO * change.engine_rad_s
    if change.is_asked or (change.is_asked is None and not is_rolling):
        return EventKind.LAUNCH
    return EventKind.CLOSING if is_rolling else EventKind.CREEP


PRE_NS = NS_PER_S // 2  # history before the event: the on-coming clutch empty, the off-going one locked
REST_NS = 11 * NS_PER_S // 5  # before a launch: two seconds of the engine at idle, both clutches open
POST_NS = NS_PER_S // 10  # after it: what sensor latencies and the crank segment reach back from


class ShiftFinder(EventFinder):
    """Finds shifts; without a tracker as current and target gear tell."""

    def __init__(self, tracker: Tracker | None = None) -> None:
        super().__init__(tracker or GearPairTracker(), PRE_NS, POST_NS)


class DriveFinder(EventFinder):
    """Finds all events of a drive that the signals of a bus can tell, each with its kind.

    Parameters
    ----------
    signals, gears
        What the bus can deliver; where it tells neither slip nor load, gear changes alone are found.
    calibration
        Touch points of the clutches.
    """

    def __init__(self, signals: AbstractSet[Signal], calibration: Calibration, gears: GearRatios | None = None) -> None:
        slip = slip_signals(signals, calibration)
        tracker: Tracker = EventTracker(tracker_for(signals, gears), None if slip is None else SlipTracker(slip))
        if slip is None and gears is not None and signals >= {Signal.ENGINE_SPEED, gears.over}:
            gear = next((signal for signal in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR) if signal in signals), None)
            tracker = SideBySide(tracker, LaunchTracker(gears, gear))
        super().__init__(tracker, PRE_NS, POST_NS, REST_NS)
