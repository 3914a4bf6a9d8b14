"""Shift detection: canonical columns in, shift events out, the same events for any cutting of the stream."""

from dataclasses import dataclass, replace

import numpy as np

from diag_service.records import ColumnBatch, E2eChange, E2eState, EndReason, Int64Array, Series, ShiftEvent, Signal

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
        self._tracks: dict[Signal, _Track] = {}
        self._bad_ns: list[Int64Array] = []
        self._e2e: dict[str, list[E2eChange]] = {}
        self._closed: list[_Bounds] = []
        self._open: _Bounds | None = None
        self._overdue = False  # the open shift was reported as too long; wait until the gears agree
        self._gears = _Gears()
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
        for change in batch.e2e_changes:
            self._e2e.setdefault(change.message, []).append(change)
        self._watermark_ns = max(self._watermark_ns, batch.watermark_ns)
        self._follow_gears(self._watermark_ns)
        while self._closed and self._closed[0].end_ns + POST_NS < self._watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        self._forget_past()
        return events

    def flush(self) -> list[ShiftEvent]:
        """End the segment: report what is closed, and the open shift as interrupted."""
        self._follow_gears(self._watermark_ns + 1)
        self._close(self._watermark_ns, EndReason.INTERRUPTED)
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
        self._e2e.clear()
        self._closed.clear()
        self._gears = _Gears()
        self._open = None
        self._overdue = False
        self._watermark_ns = -1
        self._followed_ns = -1

    def _follow_gears(self, until_ns: int) -> None:
        """Walk the gear changes with ``t < until_ns``: at the watermark itself a sample may still be on its way."""
        current = self._samples(Signal.CURRENT_GEAR, until_ns)
        target = self._samples(Signal.TARGET_GEAR, until_ns)
        self._followed_ns = until_ns
        t_ns = np.union1d(current.t_ns, target.t_ns)
        if not len(t_ns):
            self._close_overdue(until_ns)
            return
        pairs = np.column_stack((_held(current, t_ns, self._gears.current), _held(target, t_ns, self._gears.target)))
        before = np.vstack(((self._gears.current, self._gears.target), pairs[:-1]))
        for row in np.flatnonzero(np.any(pairs != before, axis=1)):
            self._close_overdue(int(t_ns[row]))
            self._step(int(t_ns[row]), _Gears(int(pairs[row, 0]), int(pairs[row, 1])))
        self._close_overdue(until_ns)

    def _samples(self, signal: Signal, until_ns: int) -> Series:
        track = self._tracks.get(signal)
        return track.joined().between(self._followed_ns, until_ns) if track else _NO_SAMPLES

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
            e2e={message: _worst(changes, first_ns, stop_ns) for message, changes in sorted(self._e2e.items())},
        )

    def _forget_past(self) -> None:
        starts = [bounds.start_ns for bounds in self._closed]
        if self._open is not None:
            starts.append(self._open.start_ns)
        keep_ns = min([*starts, self._watermark_ns]) - PRE_NS
        for track in self._tracks.values():
            track.drop_before(keep_ns)
        self._bad_ns = [times for times in self._bad_ns if times.max() >= keep_ns]
        for changes in self._e2e.values():
            while len(changes) > 1 and changes[1].t_ns <= keep_ns:
                del changes[0]


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
            return _NO_SAMPLES
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


_NO_SAMPLES = Series(t_ns=np.empty(0, np.int64), sequence=np.empty(0, np.int64), value=np.empty(0))


def _worst(changes: list[E2eChange], first_ns: int, stop_ns: int) -> E2eState:
    """Return INVALID if a message was that between two times, else its state at the later one."""
    state = E2eState.NO_DATA
    was_invalid = False
    for change in changes:
        if change.t_ns >= stop_ns:
            break
        if change.t_ns > first_ns:
            was_invalid |= state is E2eState.INVALID
        state = change.state
    return E2eState.INVALID if was_invalid else state


def _held(series: Series, t_ns: Int64Array, before: int) -> Int64Array:
    """Return the gear in force at each time: the latest sample, or the one known ``before`` the first."""
    held = np.concatenate(((before,), series.value.astype(np.int64)))
    return held[np.searchsorted(series.t_ns, t_ns, side="right")]
