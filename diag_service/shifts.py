"""Shift detection: canonical columns in, shift events out, the same events for any cutting of the stream."""

from dataclasses import replace

import numpy as np

from diag_service.gear_tracking import NO_SAMPLES, Bounds, GearPairTracker, GearTracker
from diag_service.records import ColumnBatch, Int64Array, Series, ShiftEvent, Signal

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
        self._tracks: dict[Signal, _Track] = {}
        self._bad_ns: list[Int64Array] = []
        self._closed: list[Bounds] = []
        self._watermark_ns = -1
        self._followed_ns = -1
        self._shift_count = 0

    def feed(self, batch: ColumnBatch) -> list[ShiftEvent]:
        """Take the next columns and return the shifts that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        for signal, series in batch.columns.items():
            self._tracks.setdefault(signal, _Track()).append(series)
        if len(batch.bad_frame_ns):
            self._bad_ns.append(batch.bad_frame_ns)
        self._watermark_ns = max(self._watermark_ns, batch.watermark_ns)
        self._follow_gears(self._watermark_ns)
        while self._closed and self._closed[0].end_ns + POST_NS < self._watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        self._forget_past()
        return events

    def flush(self) -> list[ShiftEvent]:
        """End the segment: report what is closed, and the open shift as interrupted."""
        self._follow_gears(self._watermark_ns + 1)
        self._closed += self._tracker.interrupt(self._watermark_ns)
        events = [self._cut(bounds) for bounds in self._closed]
        self._forget_segment()
        return events

    @property
    def buffered_sample_count(self) -> int:
        """Samples held of all signals: bounded by the longest shift, whatever the length of the drive."""
        return sum(track.sample_count for track in self._tracks.values())

    def _forget_segment(self) -> None:
        self._tracks.clear()
        self._bad_ns.clear()
        self._closed.clear()
        self._watermark_ns = -1
        self._followed_ns = -1

    def _follow_gears(self, until_ns: int) -> None:
        """Walk the gears with ``t < until_ns``: at the watermark itself a sample may still be on its way."""
        self._closed += self._tracker.follow(self._samples, until_ns)
        self._followed_ns = until_ns

    def _samples(self, signal: Signal, until_ns: int) -> Series:
        track = self._tracks.get(signal)
        return track.joined().between(self._followed_ns, until_ns) if track else NO_SAMPLES

    def _cut(self, bounds: Bounds) -> ShiftEvent:
        first_ns, stop_ns = bounds.start_ns - PRE_NS, bounds.end_ns + POST_NS
        bad_ns = np.concatenate(self._bad_ns) if self._bad_ns else np.empty(0, np.int64)
        self._shift_count += 1
        return ShiftEvent(
            number=self._shift_count,
            from_gear=bounds.from_gear,
            to_gear=bounds.to_gear,
            start_ns=bounds.start_ns,
            end_ns=bounds.end_ns,
            end_reason=bounds.end_reason,
            columns={
                signal: track.joined().between(first_ns, stop_ns) for signal, track in sorted(self._tracks.items())
            },
            bad_frame_count=int(np.count_nonzero((bad_ns >= first_ns) & (bad_ns < stop_ns))),
        )

    def _forget_past(self) -> None:
        starts = [bounds.start_ns for bounds in self._closed]
        if self._tracker.open_ns is not None:
            starts.append(self._tracker.open_ns)
        keep_ns = min([*starts, self._watermark_ns]) - PRE_NS
        for track in self._tracks.values():
            track.drop_before(keep_ns)
        self._bad_ns = [times for times in self._bad_ns if times.max() >= keep_ns]


class _Track:
    """The recent samples of one signal, in the pieces in which they came."""

    def __init__(self) -> None:
        self._pieces: list[Series] = []

    def append(self, series: Series) -> None:
        if len(series.t_ns):
            self._pieces.append(series)

    @property
    def sample_count(self) -> int:
        return sum(len(piece.t_ns) for piece in self._pieces)

    def joined(self) -> Series:
        if not self._pieces:
            return NO_SAMPLES
        if len(self._pieces) > 1:
            self._pieces = [
                Series(
                    t_ns=np.concatenate([piece.t_ns for piece in self._pieces]),
                    sequence=np.concatenate([piece.sequence for piece in self._pieces]),
                    value=np.concatenate([piece.value for piece in self._pieces]),
                    period_ns=self._pieces[-1].period_ns,
                )
            ]
        return self._pieces[0]

    def drop_before(self, keep_ns: int) -> None:
        """Forget pieces that lie wholly before ``keep_ns``, and cut a piece most of which does."""
        self._pieces = [piece for piece in self._pieces if piece.t_ns[-1] >= keep_ns]
        if self._pieces:
            oldest = self._pieces[0]
            stale = int(np.searchsorted(oldest.t_ns, keep_ns))
            if 2 * stale > len(oldest.t_ns):
                kept = oldest.between(keep_ns, int(oldest.t_ns[-1]) + 1)
                self._pieces[0] = replace(
                    kept, t_ns=kept.t_ns.copy(), sequence=kept.sequence.copy(), value=kept.value.copy()
                )
