"""Shift detection: canonical columns in, shift events out, the same events for any cutting of the stream."""

from dataclasses import dataclass, replace

import numpy as np

from diag_service.history import History, held
from diag_service.records import ColumnBatch, EndReason, ShiftEvent, Signal

NS_PER_S = 1_000_000_000
PRE_NS = NS_PER_S // 2  # history before the shift: the on-coming clutch empty, the off-going one locked
POST_NS = NS_PER_S // 10  # after it: what sensor latencies and the crank segment reach back from
MAX_SHIFT_NS = 5 * NS_PER_S  # a production shift takes about one second


@dataclass(slots=True)
class _Gears:
    """Current and target gear as last seen; 0 while unknown."""

    current: int = 0
    target: int = 0


@dataclass(frozen=True, slots=True)
class _Bounds:
    """A shift whose end was seen but whose signals are not all here yet."""

    from_gear: int
    to_gear: int
    start_ns: int
    end_ns: int
    end_reason: EndReason


class ShiftFinder:
    """Finds shifts in a stream of column batches with bounded memory.

    A shift lasts from the first sample whose target gear differs from the current gear to the first at which they
    agree again. It is reported once bus time has passed ``POST_NS`` beyond its end, cut from ``PRE_NS`` before it.
    """

    def __init__(self) -> None:
        self._history = History()
        self._closed: list[_Bounds] = []
        self._open: _Bounds | None = None
        self._overdue = False  # the open shift was reported as too long; wait until the gears agree
        self._gears = _Gears()
        self._followed_ns = -1
        self._shift_count = 0

    def feed(self, batch: ColumnBatch) -> list[ShiftEvent]:
        """Take the next columns and return the shifts that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        self._history.append(batch)
        self._follow_gears(self._history.watermark_ns)
        while self._closed and self._closed[0].end_ns + POST_NS < self._history.watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        self._forget_past()
        return events

    def flush(self) -> list[ShiftEvent]:
        """End the segment: report what is closed, and the open shift as interrupted."""
        self._follow_gears(self._history.watermark_ns + 1)
        self._close(self._history.watermark_ns, EndReason.INTERRUPTED)
        events = [self._cut(bounds) for bounds in self._closed]
        self._forget_segment()
        return events

    @property
    def buffered_sample_count(self) -> int:
        """Samples held of all signals: bounded by the longest shift, whatever the length of the drive."""
        return self._history.sample_count

    def _forget_segment(self) -> None:
        self._history.clear()
        self._closed.clear()
        self._gears = _Gears()
        self._open = None
        self._overdue = False
        self._followed_ns = -1

    def _follow_gears(self, until_ns: int) -> None:
        """Walk the gear changes with ``t < until_ns``: at the watermark itself a sample may still be on its way."""
        current, target = (
            self._history.samples(signal, self._followed_ns, until_ns)
            for signal in (Signal.CURRENT_GEAR, Signal.TARGET_GEAR)
        )
        self._followed_ns = until_ns
        is_one_message = np.array_equal(current.t_ns, target.t_ns)  # as a rule; a union costs much more
        t_ns = current.t_ns if is_one_message else np.union1d(current.t_ns, target.t_ns)
        if not len(t_ns):
            self._close_overdue(until_ns)
            return
        pairs = np.column_stack((held(current, t_ns, self._gears.current), held(target, t_ns, self._gears.target)))
        before = np.vstack(((self._gears.current, self._gears.target), pairs[:-1]))
        for row in np.flatnonzero(np.any(pairs != before, axis=1)):
            self._close_overdue(int(t_ns[row]))
            self._step(int(t_ns[row]), _Gears(int(pairs[row, 0]), int(pairs[row, 1])))
        self._close_overdue(until_ns)

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
            self._open = _Bounds(gears.current, gears.target, t_ns, t_ns, EndReason.INTERRUPTED)

    def _close(self, t_ns: int, reason: EndReason) -> None:
        if self._open is not None:
            self._closed.append(replace(self._open, end_ns=t_ns, end_reason=reason))
            self._open = None

    def _close_overdue(self, now_ns: int) -> None:
        if self._open is not None and now_ns > self._open.start_ns + MAX_SHIFT_NS:
            self._close(self._open.start_ns + MAX_SHIFT_NS, EndReason.TOO_LONG)
            self._overdue = True

    def _cut(self, bounds: _Bounds) -> ShiftEvent:
        first_ns, stop_ns = bounds.start_ns - PRE_NS, bounds.end_ns + POST_NS
        self._shift_count += 1
        return ShiftEvent(
            number=self._shift_count,
            from_gear=bounds.from_gear,
            to_gear=bounds.to_gear,
            start_ns=bounds.start_ns,
            end_ns=bounds.end_ns,
            end_reason=bounds.end_reason,
            columns=self._history.cut(first_ns, stop_ns),
            bad_frame_count=self._history.bad_frame_count(first_ns, stop_ns),
            e2e=self._history.e2e_states(first_ns, stop_ns),
        )

    def _forget_past(self) -> None:
        starts = [bounds.start_ns for bounds in self._closed]
        if self._open is not None:
            starts.append(self._open.start_ns)
        self._history.drop_before(min([*starts, self._history.watermark_ns]) - PRE_NS)
