"""How events are found: a tracker walks along the samples and says when they begin and end, a finder cuts them out."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Final, Protocol, Self

import numpy as np

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.alive_counter import came_in_bursts, own_period_ns
from canlog.e2e.e2e_state import E2eChange, E2eState
from canlog.frames import BEFORE_ALL_NS
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import NO_SAMPLES, ColumnBatch, Columns, Signal
from diag_service.diagnosis.events import Event

FIRST_CAPACITY: Final = 256  # samples of a signal; grows by doubling


class _Ring:
    """The samples of one signal: they grow at their end, and what is forgotten makes room at their beginning."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.changed_ns = BEFORE_ALL_NS  # when a sample last differed from the one before it, as the first one does
        self.first = self.stop = 0
        self._last = np.nan
        self.t_ns, self._sequence = np.empty((2, FIRST_CAPACITY), np.int64)
        self._value = np.empty(FIRST_CAPACITY)

    def append(self, series: Series) -> None:
        count = len(series.t_ns)
        if self.stop + count > len(self.t_ns):
            self._make_room(count)
        self.t_ns[self.stop : self.stop + count] = series.t_ns
        self._sequence[self.stop : self.stop + count] = series.sequence
        self._value[self.stop : self.stop + count] = series.value
        self.stop += count
        changes = np.flatnonzero(series.value != np.append(self._last, series.value[:-1]))
        if len(changes):
            self.changed_ns = int(series.t_ns[changes[-1]])
        self._last = series.value[-1]

    def between(self, start_ns: int, stop_ns: int) -> Series:
        low, high = self.first + self.t_ns[self.first : self.stop].searchsorted((start_ns, stop_ns))
        return Series(
            t_ns=self.t_ns[low:high],
            sequence=self._sequence[low:high],
            value=self._value[low:high],
            period_ns=self.period_ns,
        )

    def _make_room(self, count: int) -> None:
        held, capacity = slice(self.first, self.stop), len(self.t_ns)
        self.first, self.stop = 0, self.stop - self.first
        while 2 * (self.stop + count) > capacity:  # moving a few samples again and again would be the dearest way
            capacity *= 2
        for name in ("t_ns", "_sequence", "_value"):
            old = getattr(self, name)
            setattr(self, name, np.empty(capacity, old.dtype))
            getattr(self, name)[: self.stop] = old[held]


class SampleHistory:
    """The recent samples of all signals, the times of bad frames and the states of messages, until they are dropped.

    Samples that it returns are valid until more are appended; who keeps them copies them.
    """

    def __init__(self) -> None:
        self._rings: dict[Signal, _Ring] = {}
        self._bad_ns: list[Int64Array] = []
        self._e2e: dict[str, list[E2eChange]] = {}
        self.watermark_ns = BEFORE_ALL_NS  # all that happened before it has been received
        self.walked_ns = BEFORE_ALL_NS  # up to where a tracker has looked at the samples

    def append(self, batch: ColumnBatch) -> None:
        for signal, series in batch.columns.items():
            if len(series.t_ns):
                if signal not in self._rings:
                    self._rings[signal] = _Ring(series.period_ns)
                self._rings[signal].append(series)
        if len(batch.bad_frame_ns):
            self._bad_ns.append(batch.bad_frame_ns)
        for change in batch.e2e_changes:
            changes = self._e2e.setdefault(change.message, [])
            if changes and changes[-1].t_ns == change.t_ns:  # taken back
                changes.pop()
            changes.append(change)
        self.watermark_ns = max(self.watermark_ns, batch.watermark_ns)

    def samples(self, signal: Signal, start_ns: int, stop_ns: int) -> Series:
        """Return the samples of one signal with ``start_ns <= t_ns < stop_ns``; none if there is no such signal."""
        ring = self._rings.get(signal)
        return NO_SAMPLES if ring is None else ring.between(start_ns, stop_ns)

    def ahead(self, signal: Signal, until_ns: int) -> Series:
        """Return the samples of a signal that the tracker has not walked yet."""
        return self.samples(signal, self.walked_ns, until_ns)

    def has_change_ahead(self, signal: Signal) -> bool:
        """Return whether a sample that the tracker has not walked yet differs from the one before it."""
        ring = self._rings.get(signal)
        return (BEFORE_ALL_NS if ring is None else ring.changed_ns) >= self.walked_ns

    def cut(self, start_ns: int, stop_ns: int) -> Columns:
        """Return copies of all signals with ``start_ns <= t_ns < stop_ns``, each with the cycle that it keeps."""
        columns, cycles_ns = {}, dict[tuple[bytes, bytes, int], int]()
        for signal in sorted(self._rings):
            series = self._rings[signal].between(start_ns, stop_ns)
            message = series.t_ns.tobytes(), series.sequence.tobytes(), series.period_ns
            if message not in cycles_ns:
                cycles_ns[message] = own_period_ns(series)
            columns[signal] = Series(
                t_ns=series.t_ns.copy(),
                sequence=series.sequence.copy(),
                value=series.value.copy(),
                period_ns=cycles_ns[message],
            )
        return columns

    def bad_frame_count(self, start_ns: int, stop_ns: int) -> int:
        """Return how many frames were rejected or missing in ``start_ns <= t_ns < stop_ns``."""
        return sum(int(np.count_nonzero((times >= start_ns) & (times < stop_ns))) for times in self._bad_ns)

    def e2e_states(self, start_ns: int, stop_ns: int) -> Mapping[str, E2eState]:
        """Return, by message, INVALID if it was that in ``start_ns <= t_ns < stop_ns``, else its last state there."""
        return {message: _worst(changes, start_ns, stop_ns) for message, changes in sorted(self._e2e.items())}

    def drop_before(self, keep_ns: int) -> None:
        """Forget what lies before ``keep_ns``, times of bad frames and states a little late."""
        for ring in self._rings.values():
            ring.first += int(ring.t_ns[ring.first : ring.stop].searchsorted(keep_ns))
        if self._bad_ns:
            self._bad_ns = [times for times in self._bad_ns if times.max() >= keep_ns]
        for changes in self._e2e.values():
            while len(changes) > 1 and changes[1].t_ns <= keep_ns:
                del changes[0]

    def clear(self) -> None:
        """Forget everything: another segment of bus time begins."""
        self._rings.clear()
        self._bad_ns.clear()
        self._e2e.clear()
        self.watermark_ns = self.walked_ns = BEFORE_ALL_NS


def _worst(changes: list[E2eChange], start_ns: int, stop_ns: int) -> E2eState:
    state = E2eState.NO_DATA
    was_invalid = False
    for change in changes:
        if change.t_ns >= stop_ns:
            break
        if change.t_ns > start_ns:
            was_invalid |= state is E2eState.INVALID
        state = change.state
    return E2eState.INVALID if was_invalid else state


NS_PER_S = 1_000_000_000
_NEVER: Final = np.empty(0, np.int64)
_AFTER_A_REST = frozenset({EventKind.LAUNCH, EventKind.CREEP})


@dataclass(frozen=True, slots=True)
class Bounds:
    """When an event began and ended, and between which gears; 0 is neutral."""

    from_gear: int
    to_gear: int
    start_ns: int
    end_ns: int
    end_reason: EndReason
    kind: EventKind = EventKind.SHIFT


class Tracker(Protocol):
    """Finds where events begin and end, in steps of any size."""

    def track(self, history: SampleHistory, until_ns: int) -> list[Bounds]:
        """Walk the samples ahead with ``t < until_ns``; return the events that ended."""

    def interrupt(self, history: SampleHistory, now_ns: int) -> list[Bounds]:
        """End the stretch: return the event that is open, as interrupted, and forget everything."""

    @property
    def open_ns(self) -> int | None:
        """When the open event began, if there is one."""


class EventFinder:
    """Finds events in a stream of column batches with bounded memory, the same ones for any cutting of the stream.

    Where an event begins and ends its tracker says. It is reported once bus time has passed ``after_ns`` beyond its
    end, cut from ``before_ns`` before it; a launch or creep from ``rest_ns`` before it, but no further than to the end
    of the event before: so long the car may have rested, with both clutches open.
    """

    def __init__(self, tracker: Tracker, before_ns: int, after_ns: int, rest_ns: int = 0) -> None:
        self._tracker = tracker
        self._before_ns = before_ns
        self._rest_ns = max(rest_ns, before_ns)
        self._end_ns = BEFORE_ALL_NS  # of the event before
        self._after_ns = after_ns
        self._history = SampleHistory()
        self._closed: list[Bounds] = []
        self._event_count = 0

    def feed(self, batch: ColumnBatch) -> list[Event]:
        """Append the next columns and return the events that are now known in full, oldest first."""
        events = self.flush() if batch.breaks_before else []
        self._history.append(batch)
        self._track(self._history.watermark_ns)
        while (due_ns := self.due_ns) is not None and due_ns < self._history.watermark_ns:
            events.append(self._cut(self._closed.pop(0)))
        starts = [bounds.start_ns for bounds in self._closed]
        if self._tracker.open_ns is not None:
            starts.append(self._tracker.open_ns)
        self._history.drop_before(min([*starts, self._history.watermark_ns]) - self._rest_ns)
        return events

    def flush(self) -> list[Event]:
        """End the segment: report what is closed, and the open event as interrupted."""
        self._track(self._history.watermark_ns + 1)
        self._closed += self._tracker.interrupt(self._history, self._history.watermark_ns)
        events = [self._cut(bounds) for bounds in self._closed]
        self._history.clear()
        self._closed.clear()
        self._end_ns = BEFORE_ALL_NS
        return events

    def continuing(self, before: "EventFinder") -> Self:
        """Return this finder, which numbers its events after those of the one before."""
        self._event_count = before.event_count
        return self

    @property
    def event_count(self) -> int:
        """How many events were reported."""
        return self._event_count

    @property
    def is_expecting(self) -> bool:
        """Whether an event has begun that was not reported yet."""
        return bool(self._closed) or self._tracker.open_ns is not None

    @property
    def due_ns(self) -> int | None:
        """Bus time beyond which the oldest event that has ended will be reported, if there is one."""
        return self._closed[0].end_ns + self._after_ns if self._closed else None

    def _track(self, until_ns: int) -> None:
        """Walk the samples with ``t < until_ns``: at the watermark itself one may still be on its way."""
        self._closed += self._tracker.track(self._history, until_ns)
        self._history.walked_ns = until_ns

    def _cut(self, bounds: Bounds) -> Event:
        first_ns, stop_ns = bounds.start_ns - self._before_ns, bounds.end_ns + self._after_ns
        if bounds.kind in _AFTER_A_REST:
            first_ns = min(first_ns, max(bounds.start_ns - self._rest_ns, self._end_ns))
        self._end_ns = bounds.end_ns
        self._event_count += 1
        columns = self._history.cut(first_ns, stop_ns)
        return Event(
            kind=bounds.kind,
            number=self._event_count,
            from_gear=bounds.from_gear,
            to_gear=bounds.to_gear,
            start_ns=bounds.start_ns,
            end_ns=max(bounds.end_ns, bounds.start_ns + 1),
            end_reason=bounds.end_reason,
            columns=columns,
            bad_frame_count=self._history.bad_frame_count(first_ns, stop_ns),
            e2e=self._history.e2e_states(first_ns, stop_ns),
            came_late=came_in_bursts(columns.values()),
        )


class HeldSignals:
    """Some signals at all times at which one of them has a sample, each at its latest value; NaN before its first."""

    def __init__(self, signals: tuple[Signal, ...]) -> None:
        self._last = dict.fromkeys(signals, np.nan)

    def ahead(self, history: SampleHistory, until_ns: int) -> tuple[Int64Array, Mapping[Signal, FloatArray]]:
        """Return times and values of what has not been walked yet, shape (n,) each."""
        series = {signal: history.ahead(signal, until_ns) for signal in self._last}
        t_ns = reduce(np.union1d, (samples.t_ns for samples in series.values()), _NEVER)
        values = {signal: held_values(samples, t_ns, self._last[signal]) for signal, samples in series.items()}
        if len(t_ns):
            self._last = {signal: float(value[-1]) for signal, value in values.items()}
        return t_ns, values

    def forget(self) -> None:
        self._last = dict.fromkeys(self._last, np.nan)


def held_values(series: Series, t_ns: Int64Array, before: float) -> FloatArray:
    """Return the value in force at each time: the latest sample, or the one known ``before`` the first."""
    samples = series.t_ns.searchsorted(t_ns, "right")
    return np.concatenate([[before], series.value])[samples]
