"""Free engine run-ups in neutral, what the workshop routine consists of: canonical columns in, run-up events out."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from clutch_model.calibration import Calibration, both_clutches
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.shifts.tracking import NS_PER_S, Bounds, EventFinder, SampleHistory, held_values

MARGIN_NS: Final = NS_PER_S // 5  # around a run-up: what sensor latencies and the crank segment reach back from
MAX_RUN_UP_NS: Final = 10 * NS_PER_S
LOW_RAD_S: Final = 130.0  # 1240 rpm: above any warm idle
HIGH_RAD_S: Final = 250.0  # 2390 rpm: a blip of the pedal stays below
CLOSED_MARGIN_PA: Final = 5.0e4  # above the touch point: the clutch carries what turns its input shaft
EMPTY_RATIO: Final = 0.5  # of the touch point: the piston is back, whatever the sensor's zero
_UNKNOWN: Final = -1

# What the engine does at a sample: in gear, or in neutral with the number of bounds (low, high) that its speed reaches.
_IN_GEAR: Final = -1
_LOW: Final = 0
_HIGH: Final = 2

_GEARS: Final = (Signal.CURRENT_GEAR, Signal.TARGET_GEAR)
_PRESSURES: Final = (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)


class RunUpFinder(EventFinder):
    """Finds free engine run-ups in neutral.

    A run-up lasts from the first sample of the engine speed at or above ``LOW_RAD_S`` to the next one below, with
    current and target gear neutral all along and ``HIGH_RAD_S`` reached in between. It counts if both clutches were
    empty or both well above their touch points throughout.

    Parameters
    ----------
    calibration : Calibration
        Touch points of the clutches.
    """

    def __init__(self, calibration: Calibration) -> None:
        touch_pa = both_clutches(clutch.touch_pressure_pa for clutch in calibration.clutches)
        super().__init__(RunUpTracker(touch_pa), MARGIN_NS, MARGIN_NS)


@dataclass(frozen=True, slots=True)
class _Open:
    """A run-up that has begun."""

    start_ns: int
    is_high: bool  # the engine has been fast in it


class RunUpTracker:
    """Walks the engine speed while both gears are neutral; knows the touch pressures of both clutches [Pa]."""

    def __init__(self, touch_pa: tuple[float, float]) -> None:
        self._touch_pa = touch_pa
        self._forget()

    def _forget(self) -> None:
        self._open: _Open | None = None
        self._regime = _IN_GEAR
        self._gears = dict.fromkeys(_GEARS, _UNKNOWN)

    @property
    def open_ns(self) -> int | None:
        return None if self._open is None else self._open.start_ns

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        speed = history.ahead(Signal.ENGINE_SPEED, until_ns)
        is_neutral = np.ones(len(speed.t_ns), np.bool_)
        for signal in _GEARS:
            is_neutral &= self._held_gear(signal, speed.t_ns, history, until_ns) == 0
        reached = np.digitize(speed.value, (LOW_RAD_S, HIGH_RAD_S))
        regimes = np.concatenate(((self._regime,), np.where(is_neutral, reached, _IN_GEAR)))
        ended: list[Bounds] = []
        for row in np.flatnonzero(np.diff(regimes)).tolist():
            ended += self._step(history, int(speed.t_ns[row]), int(regimes[row]), int(regimes[row + 1]))
        self._regime = int(regimes[-1])
        return [*ended, *self._end_overdue(history, until_ns)]

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        ended = self._end(history, now_ns, EndReason.INTERRUPTED)
        self._forget()
        return ended

    def _held_gear(self, signal: Signal, t_ns: Int64Array, history: SampleHistory, until_ns: int) -> Int64Array:
        """Return the gear in force at each time, and remember the last one."""
        series = history.ahead(signal, until_ns)
        gears = held_values(series, t_ns, self._gears[signal]).astype(np.int64)
        if len(series.value):
            self._gears[signal] = int(series.value[-1])
        return gears

    def _step(self, history: SampleHistory, t_ns: int, before: int, regime: int) -> list[Bounds]:
        ended = self._end_overdue(history, t_ns)
        if self._open is None:
            if before == _LOW and regime > _LOW:
                self._open = _Open(t_ns, regime == _HIGH)
        elif regime == _HIGH:
            self._open = replace(self._open, is_high=True)
        elif regime == _LOW:
            ended += self._end(history, t_ns, EndReason.COMPLETE)
        elif regime == _IN_GEAR:
            ended += self._end(history, t_ns, EndReason.ABANDONED)
        return ended

    def _end_overdue(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        if self._open is None or now_ns <= self._open.start_ns + MAX_RUN_UP_NS:
            return []
        return self._end(history, self._open.start_ns + MAX_RUN_UP_NS, EndReason.TOO_LONG)

    def _end(self, history: SampleHistory, end_ns: int, reason: EndReason) -> list[Bounds]:
        """End the open run-up; return it if the engine was fast and the clutches both open or both closed."""
        ended, self._open = self._open, None
        if ended is None or not ended.is_high:
            return []
        kind = self._kind(history, ended.start_ns, end_ns)
        return [] if kind is None else [Bounds(0, 0, ended.start_ns, end_ns, reason, kind)]

    def _kind(self, history: SampleHistory, start_ns: int, end_ns: int) -> EventKind | None:
        pressures = [history.samples(signal, start_ns, end_ns + 1).value for signal in _PRESSURES]
        if not all(len(pressure_pa) for pressure_pa in pressures):
            return None
        pairs = list(zip(pressures, self._touch_pa, strict=True))
        if all(pressure_pa.min() > touch_pa + CLOSED_MARGIN_PA for pressure_pa, touch_pa in pairs):
            return EventKind.RUN_UP_CLOSED
        if all(pressure_pa.max() < EMPTY_RATIO * touch_pa for pressure_pa, touch_pa in pairs):
            return EventKind.RUN_UP_OPEN
        return None
