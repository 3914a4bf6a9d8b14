"""Shift detection: canonical columns in, shift events out, the same events for any cutting of the stream."""

from canlog.frames import BEFORE_ALL_NS
from diag_service.diagnosis.columns import ColumnBatch
from diag_service.diagnosis.events import ShiftEvent
from diag_service.diagnosis.shifts.gear_tracking import GearPairTracker
from diag_service.diagnosis.shifts.history import Ahead, History
from diag_service.diagnosis.shifts.shift_bounds import Bounds, GearTracker

NS_PER_S = 1_000_000_000
PRE_NS = NS_PER_S // 2  # history before the shift: the on-coming clutch empty, the off-going one locked
POST_NS = NS_PER_S // 10  # after it: what sensor latencies and the crank segment reach back from


class ShiftFinder:
    """Finds shifts in a stream of column batches with bounded memory.

    Where a shift begins and ends its tracker says: without one, as current and target gear tell. It is reported once
    bus time has passed ``POST_NS`` beyond its end, cut from ``PRE_NS`` before it.
    """

    def __init__(self, tracker: GearTracker | None = None) -> None:
        self._tracker = tracker or GearPairTracker()
        self._history = History()
        self._ahead = Ahead(self._history)
        self._closed: list[Bounds] = []
        self._shift_count = 0

    def feed(self, batch: ColumnBatch) -> list[ShiftEvent]:
        """Append the next columns and return the shifts that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        self._history.append(batch)
        self._track_gears(self._history.watermark_ns)
        while (due_ns := self.due_ns) is not None and due_ns < self._history.watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        self._forget_past()
        return events

    def flush(self) -> list[ShiftEvent]:
        """End the segment: report what is closed, and the open shift as interrupted."""
        self._track_gears(self._history.watermark_ns + 1)
        self._closed += self._tracker.interrupt(self._history.watermark_ns)
        events = [self._cut(bounds) for bounds in self._closed]
        self._forget_segment()
        return events

    @property
    def is_expecting(self) -> bool:
        """Whether a shift has begun that was not reported yet."""
        return bool(self._closed) or self._tracker.open_ns is not None

    @property
    def due_ns(self) -> int | None:
        """Bus time beyond which the oldest shift that has ended will be reported, if there is one."""
        return self._closed[0].end_ns + POST_NS if self._closed else None

    @property
    def buffered_sample_count(self) -> int:
        """Samples held of all signals: bounded by the longest shift, whatever the length of the drive."""
        return self._history.sample_count

    def _forget_segment(self) -> None:
        self._history.clear()
        self._closed.clear()
        self._ahead.start_ns = BEFORE_ALL_NS

    def _track_gears(self, until_ns: int) -> None:
        """Walk the gears with ``t < until_ns``: at the watermark itself a sample may still be on its way."""
        self._closed += self._tracker.track(self._ahead, until_ns)
        self._ahead.start_ns = until_ns

    def _cut(self, bounds: Bounds) -> ShiftEvent:
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
        if self._tracker.open_ns is not None:
            starts.append(self._tracker.open_ns)
        self._history.drop_before(min([*starts, self._history.watermark_ns]) - PRE_NS)
