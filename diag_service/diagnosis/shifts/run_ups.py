"""Free engine run-ups in neutral, what the workshop routine consists of: canonical columns in, run-up events out.

The same events for any cutting of the stream.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.frames import BEFORE_ALL_NS
from clutch_model.calibration import Calibration
from diag_service.diagnosis.columns import ColumnBatch, Signal
from diag_service.diagnosis.events import EndReason, RunUpEvent
from diag_service.diagnosis.shifts.history import History
from diag_service.diagnosis.shifts.shift_bounds import held_values

NS_PER_S: Final = 1_000_000_000
MARGIN_NS: Final = (
    NS_PER_S // 5
)  # before and after a run-up: what sensor latencies and the crank segment reach back from
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


@dataclass(frozen=True, slots=True)
class _Bounds:
    """A run-up that has begun, or whose end was seen but whose signals are not all here yet."""

    start_ns: int
    is_high: bool  # the engine has been fast in it
    end_ns: int
    end_reason: EndReason


class RunUpFinder:
    """Finds free engine run-ups in neutral in a stream of column batches with bounded memory.

    A run-up lasts from the first sample of the engine speed at or above ``LOW_RAD_S`` to the next one below, with
    current and target gear neutral all along and ``HIGH_RAD_S`` reached in between. It is reported once bus time has
    passed ``MARGIN_NS`` beyond its end, if both clutches were empty or both well above their touch points throughout.

    Parameters
    ----------
    calibration : Calibration
        Touch points of the clutches.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._touch_pa = [clutch.touch_pressure_pa for clutch in calibration.clutches]
        self._history = History()
        self._closed: list[_Bounds] = []
        self._open: _Bounds | None = None
        self._regime = _IN_GEAR
        self._gears = [_UNKNOWN, _UNKNOWN]
        self._tracked_ns = BEFORE_ALL_NS
        self._run_up_count = 0

    def feed(self, batch: ColumnBatch) -> list[RunUpEvent]:
        """Append the next columns and return the run-ups that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        self._history.append(batch)
        self._track_speed(self._history.watermark_ns)
        while self._closed and self._closed[0].end_ns + MARGIN_NS < self._history.watermark_ns:
            events += self._cut(self._closed.pop(0))
        self._forget_past()
        return events

    def flush(self) -> list[RunUpEvent]:
        """End the segment: report what is closed, and the open run-up as interrupted."""
        self._track_speed(self._history.watermark_ns + 1)
        self._close(self._history.watermark_ns, EndReason.INTERRUPTED)
        events = [event for bounds in self._closed for event in self._cut(bounds)]
        self._forget_segment()
        return events

    @property
    def buffered_sample_count(self) -> int:
        """Samples held of all signals: bounded by the longest run-up, whatever the length of the drive."""
        return self._history.sample_count

    def _track_speed(self, until_ns: int) -> None:
        """Walk the engine speed with ``t < until_ns``: at the watermark itself a sample may still be on its way."""
        speed = self._history.samples(Signal.ENGINE_SPEED, self._tracked_ns, until_ns)
        is_neutral = np.ones(len(speed.t_ns), np.bool_)
        for index, signal in enumerate(_GEARS):
            is_neutral &= self._held_gear(index, signal, speed.t_ns, until_ns) == 0
        self._tracked_ns = until_ns
        reached = np.digitize(speed.value, (LOW_RAD_S, HIGH_RAD_S))
        regimes = np.concatenate(((self._regime,), np.where(is_neutral, reached, _IN_GEAR)))
        for row in np.flatnonzero(np.diff(regimes)).tolist():
            self._step(int(speed.t_ns[row]), int(regimes[row]), int(regimes[row + 1]))
        self._regime = int(regimes[-1])
        self._close_overdue(until_ns)

    def _held_gear(self, index: int, signal: Signal, t_ns: Int64Array, until_ns: int) -> Int64Array:
        """Return the gear in force at each time, and remember the last one."""
        series = self._history.samples(signal, self._tracked_ns, until_ns)
        gears = held_values(series, t_ns, self._gears[index]).astype(np.int64)
        if len(series.value):
            self._gears[index] = int(series.value[-1])
        return gears

    def _step(self, t_ns: int, before: int, regime: int) -> None:
        self._close_overdue(t_ns)
        if self._open is None:
            if before == _LOW and regime > _LOW:
                self._open = _Bounds(t_ns, regime == _HIGH, t_ns, EndReason.INTERRUPTED)
        elif regime == _HIGH:
            self._open = replace(self._open, is_high=True)
        elif regime == _LOW:
            self._close(t_ns, EndReason.COMPLETE)
        elif regime == _IN_GEAR:
            self._close(t_ns, EndReason.ABANDONED)

    def _close(self, t_ns: int, reason: EndReason) -> None:
        if self._open is not None and self._open.is_high:
            self._closed.append(replace(self._open, end_ns=t_ns, end_reason=reason))
        self._open = None

    def _close_overdue(self, now_ns: int) -> None:
        if self._open is not None and now_ns > self._open.start_ns + MAX_RUN_UP_NS:
            self._close(self._open.start_ns + MAX_RUN_UP_NS, EndReason.TOO_LONG)

    def _cut(self, bounds: _Bounds) -> list[RunUpEvent]:
        """Return the event, or none if the clutches were neither both open nor both closed."""
        are_closed = self._are_closed(bounds)
        if are_closed is None:
            return []
        first_ns, stop_ns = bounds.start_ns - MARGIN_NS, bounds.end_ns + MARGIN_NS
        self._run_up_count += 1
        return [
            RunUpEvent(
                number=self._run_up_count,
                start_ns=bounds.start_ns,
                end_ns=bounds.end_ns,
                are_clutches_closed=are_closed,
                end_reason=bounds.end_reason,
                columns=self._history.cut(first_ns, stop_ns),
                bad_frame_count=self._history.bad_frame_count(first_ns, stop_ns),
            )
        ]

    def _are_closed(self, bounds: _Bounds) -> bool | None:
        """Return whether both clutches were closed, both open (False) or anything else (None)."""
        pressures = [self._history.samples(signal, bounds.start_ns, bounds.end_ns + 1).value for signal in _PRESSURES]
        pairs = list(zip(pressures, self._touch_pa, strict=True))
        if not all(len(pressure_pa) for pressure_pa in pressures):
            return None
        if all(pressure_pa.min() > touch_pa + CLOSED_MARGIN_PA for pressure_pa, touch_pa in pairs):
            return True
        if all(pressure_pa.max() < EMPTY_RATIO * touch_pa for pressure_pa, touch_pa in pairs):
            return False
        return None

    def _forget_past(self) -> None:
        starts = [bounds.start_ns for bounds in self._closed]
        if self._open is not None:
            starts.append(self._open.start_ns)
        self._history.drop_before(min([*starts, self._history.watermark_ns]) - MARGIN_NS)

    def _forget_segment(self) -> None:
        self._history.clear()
        self._closed.clear()
        self._open = None
        self._regime = _IN_GEAR
        self._gears = [_UNKNOWN, _UNKNOWN]
        self._tracked_ns = BEFORE_ALL_NS
